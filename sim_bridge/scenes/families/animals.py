"""Statues of animals, and of a rider."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of
from sim_bridge.scenes.families.likeness import Shape, plinth
from sim_bridge.scenes.families.people import Person
from sim_bridge.scenes.implicit import Limb, round_cone

SIDES = (-1.0, 1.0)
Point = tuple[float, float, float]


class Beast:
    """Limbs of a four-legged animal in units of its height at the withers, facing +x, above the middle of its feet."""

    def __init__(self, size_m: float, base: Point, pitch: float = 0.0) -> None:
        self.size_m, self._base, self._pitch = size_m, np.array(base), pitch
        self.limbs: list[Limb] = []

    def limb(self, *points: Point, radii: tuple[float, ...], flat: float = 1.0) -> None:
        """A chain of limbs through points, with a radius at each, thinner across the animal by flat."""
        placed = [self._placed(p) for p in points]
        for k in range(len(points) - 1):
            self.limbs.append(round_cone(placed[k], placed[k + 1], (self.size_m * radii[k], self.size_m * radii[k + 1]),
                                         flat))

    def _placed(self, point: Point) -> Point:
        """A point raised by the pitch about the hind feet's hips."""
        x, y, z = point
        c, s, hip = np.cos(self._pitch), np.sin(self._pitch), np.array((-0.42, 0.8))
        fore = np.clip((x + 0.42) / 0.2, 0.0, 1.0)
        turned = hip + (np.array([(c, -s), (s, c)]) @ (np.array((x, z)) - hip))
        x, z = np.array((x, z)) + fore * (turned - (x, z))
        east, north, up = (float(c) for c in self._base + self.size_m * np.array((x, y, z)))
        return east, north, up

    def leg(self, x: float, side: float, lift: float, thick: float, *, hind: bool) -> None:
        """A leg from shoulder or hip to the hoof, lifted by a share of its length."""
        y, knee = 0.13 * side, (0.06 if not hind else 0.08)
        bend = lift * 0.28
        hock = (x + (knee if not hind else -knee) + (bend if not hind else 0.6 * bend), y, 0.4 + 0.5 * bend)
        foot = (x + 0.02 + (0.4 if not hind else 0.9) * bend, 0.95 * y, 0.05 + bend)
        self.limb((x, 0.9 * y, 0.78), hock, foot, radii=(1.5 * thick, 0.85 * thick, 0.62 * thick))
        self.limb(foot, (foot[0] + 0.045, foot[1], foot[2] - 0.03), radii=(0.66 * thick, 0.75 * thick))


def horse(beast: Beast, lift: tuple[float, float, float, float], nod: float) -> None:
    """Add a horse: lift is how far its legs are raised (left and right fore, left and right hind)."""
    beast.limb((-0.45, 0.0, 0.8), (0.0, 0.0, 0.76), (0.4, 0.0, 0.8), radii=(0.21, 0.2, 0.2))
    beast.limb((-0.5, 0.0, 0.86), (-0.38, 0.0, 0.88), radii=(0.16, 0.15))
    for k, side in enumerate(SIDES):
        beast.leg(0.4, side, lift[k], 0.075, hind=False)
        beast.leg(-0.48, side, lift[2 + k], 0.085, hind=True)
    poll = (0.78, 0.0, 1.38 - 0.3 * nod)
    beast.limb((0.42, 0.0, 0.92), (0.62, 0.0, 1.14 - 0.1 * nod), poll, radii=(0.18, 0.125, 0.085), flat=1.25)
    muzzle = (1.02 - 0.14 * nod, 0.0, 1.08 - 0.42 * nod)
    beast.limb(poll, muzzle, radii=(0.09, 0.052), flat=1.2)
    for side in SIDES:
        beast.limb((0.77, 0.045 * side, poll[2] + 0.06), (0.79, 0.05 * side, poll[2] + 0.15), radii=(0.025, 0.012))
    for t in np.linspace(0.0, 1.0, 8):
        x, z = 0.38 + 0.38 * t, 1.06 + (poll[2] - 0.96) * t
        beast.limb((x, 0.0, z), (x - 0.07, 0.02, z - 0.06), radii=(0.04, 0.03))
    beast.limb((-0.64, 0.0, 0.9), (-0.8, 0.0, 0.78), (-0.84, 0.0, 0.35), radii=(0.05, 0.075, 0.03))


@dataclass(frozen=True)
class Quadruped(Family):
    """A standing lion, bull, horse or elephant on a plinth."""

    animal: str = one_of("lion", "bull", "horse", "elephant")
    size_m: float = between(5.0, 9.0)
    """Height at the withers."""
    stride: float = between(0.0, 0.14)
    nod: float = between(0.0, 1.0)
    """How low the head is held."""
    stout: float = between(0.9, 1.2)
    tail: float = between(-1.0, 1.0)
    metal: str = one_of("bronze", "marble", "copper")
    plinth: str = one_of("block", "steps")
    plinth_m: float = between(1.5, 4.0)

    def build(self, rng: np.random.Generator) -> Body:
        """The animal facing east."""
        body, h = Body(), self.size_m
        beast = Beast(h, (0.0, 0.0, self.plinth_m - 0.012 * h))
        if self.animal == "horse":
            horse(beast, (0.4 * self.stride / 0.14, 0.0, 0.0, 0.2 * self.stride), self.nod)
        else:
            self._trunk(beast)
            {"lion": self._lion, "bull": self._bull, "elephant": self._elephant}[self.animal](beast)
        shape = Shape(h / 70.0, 0.045 * h)
        shape.add(*beast.limbs)
        body.add(self.metal, shape.solid())
        plinth(body, self.plinth, (0.85 * h, 0.34 * h), self.plinth_m)
        return body

    def _trunk(self, beast: Beast) -> None:
        wide = self.stout * {"lion": 0.85, "bull": 1.1, "elephant": 1.35}[self.animal]
        leg = {"lion": 0.085, "bull": 0.085, "elephant": 0.125}[self.animal]
        beast.limb((-0.48, 0.0, 0.78), (0.0, 0.0, 0.74), (0.42, 0.0, 0.8), radii=(0.2 * wide, 0.22 * wide, 0.23 * wide))
        for side in SIDES:
            beast.leg(0.42 + self.stride * side, side, 0.0, leg, hind=False)
            beast.leg(-0.5 - self.stride * side, side, 0.0, leg, hind=True)
        tip = (-0.85, 0.1 * self.tail, 0.45 + 0.25 * self.tail)
        beast.limb((-0.68, 0.0, 0.88), (-0.82, 0.04 * self.tail, 0.68), tip, radii=(0.045, 0.035, 0.05))

    def _lion(self, beast: Beast) -> None:
        z = 1.08 - 0.2 * self.nod
        beast.limb((0.45, 0.0, 0.92), (0.62, 0.0, z), radii=(0.26, 0.26))
        for k in range(14):
            a = 2.0 * np.pi * k / 14
            y, up = float(np.cos(a)), float(np.sin(a))
            beast.limb((0.56, 0.2 * y, z + 0.2 * up), (0.5, 0.29 * y, z - 0.03 + 0.29 * up), radii=(0.07, 0.04))
        beast.limb((0.72, 0.0, z + 0.02), (0.9, 0.0, z - 0.06), radii=(0.17, 0.1))
        for side in SIDES:
            beast.limb((0.7, 0.12 * side, z + 0.16), (0.7, 0.15 * side, z + 0.21), radii=(0.05, 0.035))

    def _bull(self, beast: Beast) -> None:
        z = 0.98 - 0.25 * self.nod
        beast.limb((0.3, 0.0, 0.98), (0.5, 0.0, 0.98), (0.72, 0.0, z), radii=(0.2, 0.22, 0.16))
        beast.limb((0.72, 0.0, z), (0.95, 0.0, z - 0.16), radii=(0.15, 0.09))
        for side in SIDES:
            beast.limb((0.74, 0.1 * side, z + 0.1), (0.8, 0.3 * side, z + 0.14), (0.95, 0.34 * side, z + 0.3),
                       radii=(0.05, 0.045, 0.015))
            beast.limb((0.7, 0.13 * side, z + 0.03), (0.68, 0.24 * side, z), radii=(0.04, 0.05))

    def _elephant(self, beast: Beast) -> None:
        z = 1.0 - 0.12 * self.nod
        beast.limb((0.5, 0.0, 0.9), (0.72, 0.0, z), radii=(0.24, 0.23))
        curl = 0.4 * (1.0 - self.nod)
        beast.limb((0.85, 0.0, z - 0.04), (1.05, 0.0, 0.65), (1.08 + curl, 0.0, 0.35 + 0.5 * curl),
                   (1.0 + 2.2 * curl, 0.0, 0.15 + 1.8 * curl), radii=(0.14, 0.09, 0.06, 0.04))
        for side in SIDES:
            beast.limb((0.62, 0.2 * side, z + 0.1), (0.55, 0.42 * side, z - 0.12), radii=(0.06, 0.15), flat=1.0)
            beast.limb((0.9, 0.12 * side, z - 0.14), (1.18, 0.16 * side, z - 0.26), (1.32, 0.15 * side, z - 0.18),
                       radii=(0.045, 0.035, 0.012))


@dataclass(frozen=True)
class EquestrianStatue(Family):
    """A rider on a walking or rearing horse, on a high plinth."""

    size_m: float = between(4.5, 7.5)
    """Height of the horse at its withers."""
    gait: str = one_of("walk", "rear")
    rear_deg: float = between(12.0, 26.0)
    nod: float = between(0.0, 0.7)
    hand: str = one_of("raised", "reins", "lance")
    cloak: bool = one_of(True, False)
    hat: bool = one_of(True, False)
    metal: str = one_of("bronze", "copper")
    plinth: str = one_of("block", "steps")
    plinth_m: float = between(2.5, 6.0)

    def build(self, rng: np.random.Generator) -> Body:
        """The statue facing east."""
        body, h = Body(), self.size_m
        rearing = self.gait == "rear"
        pitch = float(np.radians(self.rear_deg)) if rearing else 0.0
        beast = Beast(h, (0.0, 0.0, self.plinth_m - 0.015 * h), pitch)
        horse(beast, (0.9, 0.7, 0.0, 0.0) if rearing else (0.7, 0.0, 0.0, 0.25), self.nod)
        if rearing:
            beast.limb((-0.84, 0.0, 0.4), (-0.84, 0.0, 0.0), radii=(0.05, 0.06))
        shape = Shape(h / 75.0, 0.03 * h)
        shape.add(*beast.limbs)
        self._rider(shape, h, pitch)
        body.add(self.metal, shape.solid())
        plinth(body, self.plinth, (0.95 * h, 0.36 * h), self.plinth_m)
        return body

    def _rider(self, shape: Shape, h: float, pitch: float) -> None:
        size = 1.18 * h
        seat = (-0.06 * h, 0.0, self.plinth_m + (0.94 + 0.36 * np.sin(pitch)) * h - 0.3 * size)
        rider = Person(size, seat, facing_east=True)
        rider.torso(0.31, -0.4 * pitch)
        for side in SIDES:
            rider.leg(side, 0.3, (0.155, -0.13, 0.22), (0.175, -0.05, 0.02))
        reins = ((0.15, -0.05, 0.45), (0.06, -0.2, 0.42))
        rider.arm(1.0, 0.595, *reins, lean=-0.4 * pitch)
        right = {"raised": ((0.2, -0.1, 0.66), (0.2, -0.17, 0.84)), "reins": reins,
                 "lance": ((0.19, -0.03, 0.46), (0.2, -0.16, 0.5))}[self.hand]
        rider.arm(-1.0, 0.595, *right, lean=-0.4 * pitch)
        if self.hand == "lance":
            rider.limb((-0.2, -0.1, 0.2), (-0.2, -0.3, 1.1), radii=(0.014, 0.012))
        if self.cloak:
            for x in (-0.09, -0.03, 0.03, 0.09):
                rider.limb((x, 0.06, 0.6), (1.5 * x, 0.2, 0.3), (1.8 * x, 0.3, 0.26), radii=(0.03, 0.045, 0.04))
        if self.hat:
            rider.limb((-0.07, 0.0, 0.765), (0.07, 0.0, 0.765), radii=(0.03, 0.03))
            rider.limb((0.0, 0.0, 0.77), (0.0, 0.01, 0.8), radii=(0.055, 0.04))
        shape.add(*rider.limbs, melt_m=0.016 * size)
