"""Statues of people, proportioned by height: standing, seated."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of
from sim_bridge.scenes.families.likeness import Shape, plinth
from sim_bridge.scenes.implicit import Limb, round_cone

Array = NDArray[np.float64]


HANDS = {
    "down": ((0.155, 0.015, 0.63), (0.16, -0.03, 0.48)), "akimbo": ((0.225, 0.05, 0.62), (0.1, -0.03, 0.55)),
    "raised": ((0.2, -0.02, 0.86), (0.21, -0.05, 1.02)), "book": ((0.15, 0.0, 0.64), (0.09, -0.12, 0.66)),
    "outstretched": ((0.17, -0.12, 0.74), (0.19, -0.29, 0.77)), "staff": ((0.19, -0.03, 0.64), (0.21, -0.15, 0.68)),
    "sword": ((0.18, 0.02, 0.64), (0.18, -0.13, 0.58)),
}
"""Elbow and hand of somebody standing, x counted outwards."""


class Person:
    """A body of eight heads, in units of its standing height, facing -y; its origin is on the ground below the hips."""

    def __init__(self, size_m: float, base: tuple[float, float, float], *, facing_east: bool = False) -> None:
        self.size_m, self._base = size_m, np.array(base)
        self._axes = np.array([(0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)]) if facing_east else np.eye(3)
        self.limbs: list[Limb] = []

    def at(self, point: tuple[float, float, float]) -> Array:
        """Where a point of the body lies."""
        return np.asarray(self._base + self.size_m * (np.array(point) @ self._axes))

    def limb(self, *points: tuple[float, float, float], radii: tuple[float, ...], flat: float = 1.0) -> None:
        """A chain of limbs through points, with a radius at each, thinner along y by flat."""
        for (a, b), (r, s) in zip(pairwise(points), pairwise(radii), strict=True):
            self.limbs.append(round_cone(self.at(a), self.at(b), (self.size_m * r, self.size_m * s), flat))

    def torso(self, hips: float, lean: float = 0.0, turn: float = 0.0) -> None:
        """Hips at a height, chest, shoulders, neck and head above them."""
        y = -lean
        self.limb((-0.045, 0.0, hips), (0.045, 0.0, hips), radii=(0.068, 0.068))
        self.limb((0.0, 0.0, hips + 0.03), (0.0, y * 0.5, hips + 0.14), (0.0, y, hips + 0.25),
                  radii=(0.075, 0.068, 0.088), flat=1.15)
        self.limb((-0.085, y, hips + 0.285), (0.085, y, hips + 0.285), radii=(0.046, 0.046))
        self.limb((0.0, y, hips + 0.29), (0.0, y - 0.008, hips + 0.36), radii=(0.036, 0.033))
        self.limb((0.004 * turn, y - 0.018, hips + 0.385), (0.0, y - 0.008, hips + 0.425), radii=(0.04, 0.052))
        self.limb((0.02 * turn, y - 0.058, hips + 0.405), (0.02 * turn, y - 0.066, hips + 0.392), radii=(0.009, 0.011))

    def arm(self, side: float, shoulder_z: float, elbow: tuple[float, float, float],
            hand: tuple[float, float, float], lean: float = 0.0) -> None:
        """From the shoulder over the elbow to the hand, with x counted outwards."""
        a = (side * 0.105, -lean, shoulder_z)
        e, h = ((side * p[0], p[1], p[2]) for p in (elbow, hand))
        reach = np.array(h) - np.array(e)
        tip = tuple(np.array(h) + 0.045 * reach / np.linalg.norm(reach))
        self.limb(a, e, h, tip, radii=(0.04, 0.031, 0.022, 0.026))

    def leg(self, side: float, hip_z: float, knee: tuple[float, float, float],
            ankle: tuple[float, float, float]) -> None:
        """From the hip over the knee to the foot, with x counted outwards."""
        k, n = ((side * p[0], p[1], p[2]) for p in (knee, ankle))
        self.limb((side * 0.048, 0.0, hip_z), k, n, radii=(0.062, 0.043, 0.028))
        self.limb((n[0], n[1] + 0.012, n[2] - 0.012), (n[0] * 1.1, n[1] - 0.085, n[2] - 0.018), radii=(0.028, 0.022))


@dataclass(frozen=True)
class StandingFigure(Family):
    """A standing person in a robe, a coat or bare, with an arm raised, outstretched, akimbo or holding something."""

    size_m: float = between(8.0, 16.0)
    dress: str = one_of("robe", "coat", "none")
    left_hand: str = one_of("down", "akimbo", "raised", "book")
    right_hand: str = one_of("down", "outstretched", "staff", "sword")
    stride: float = between(0.0, 0.12)
    turn: float = between(-1.5, 1.5)
    """Of the head."""
    hat: str = one_of("none", "brim", "crown")
    metal: str = one_of("bronze", "marble", "copper")
    plinth: str = one_of("steps", "block", "drum")
    plinth_m: float = between(2.0, 6.0)

    def build(self, rng: np.random.Generator) -> Body:
        """The statue facing south."""
        body, h = Body(), self.size_m
        person = Person(h, (0.0, 0.0, self.plinth_m))
        person.torso(0.5, 0.005, self.turn)
        for side, step in ((1.0, -self.stride), (-1.0, 0.6 * self.stride)):
            person.leg(side, 0.49, (0.056, 0.55 * step - 0.015, 0.275), (0.062, step, 0.035))
        person.arm(1.0, 0.785, *HANDS[self.left_hand])
        person.arm(-1.0, 0.785, *HANDS[self.right_hand])
        self._dress(person)
        self._hold(person)
        shape = Shape(h / 120.0, 0.02 * h)
        shape.add(*person.limbs)
        body.add(self.metal, shape.solid())
        plinth(body, self.plinth, (0.2 * h, 0.18 * h), self.plinth_m)
        return body

    def _dress(self, person: Person) -> None:
        if self.dress == "robe":
            person.limb((0.0, 0.0, 0.52), (0.0, -0.01, 0.1), radii=(0.085, 0.125), flat=1.2)
            for k in range(9):
                a = 2.0 * np.pi * k / 9
                x, y = float(np.cos(a)), float(np.sin(a))
                person.limb((0.06 * x, 0.05 * y, 0.45), (0.125 * x, 0.105 * y - 0.01, 0.02), radii=(0.02, 0.034))
        elif self.dress == "coat":
            for x in (-0.1, -0.035, 0.035, 0.1):
                person.limb((0.85 * x, 0.06, 0.78), (1.25 * x, 0.13, 0.2), radii=(0.035, 0.05), flat=1.4)
        if self.hat == "brim":
            person.limb((0.0, -0.012, 0.945), (0.0, -0.01, 0.95), radii=(0.085, 0.08))
            person.limb((0.0, -0.01, 0.96), (0.0, -0.008, 0.99), radii=(0.055, 0.05))
        elif self.hat == "crown":
            for k in range(7):
                a = 2.0 * np.pi * k / 7
                x, y = 0.05 * float(np.cos(a)), 0.05 * float(np.sin(a)) - 0.01
                person.limb((x, y, 0.95), (1.3 * x, 1.3 * y, 1.01), radii=(0.014, 0.008))

    def _hold(self, person: Person) -> None:
        if self.right_hand == "staff":
            person.limb((-0.215, -0.175, 0.0), (-0.215, -0.175, 1.02), radii=(0.013, 0.013))
            person.limb((-0.215, -0.175, 1.02), (-0.215, -0.175, 1.04), radii=(0.032, 0.03))
        elif self.right_hand == "sword":
            person.limb((-0.18, -0.16, 0.56), (-0.18, -0.2, 0.01), radii=(0.018, 0.01))
            person.limb((-0.235, -0.163, 0.54), (-0.125, -0.163, 0.54), radii=(0.012, 0.012))
            person.limb((-0.18, -0.16, 0.56), (-0.18, -0.155, 0.64), radii=(0.014, 0.018))
        if self.left_hand == "book":
            person.limb((0.05, -0.15, 0.6), (0.06, -0.16, 0.72), radii=(0.045, 0.045), flat=2.4)
        elif self.left_hand == "raised":
            person.limb((0.21, -0.06, 1.03), (0.21, -0.065, 1.14), radii=(0.02, 0.035))
            person.limb((0.21, -0.065, 1.15), (0.215, -0.06, 1.2), radii=(0.045, 0.012))


@dataclass(frozen=True)
class SeatedFigure(Family):
    """A seated person on a throne or a block, robed or bare-legged, on a plinth."""

    size_m: float = between(9.0, 16.0)
    """Standing height."""
    seat: str = one_of("throne", "block", "rock")
    left_hand: str = one_of("knee", "chin", "raised")
    right_hand: str = one_of("knee", "staff")
    robe: str = one_of("robe", "none")
    lean: float = between(0.0, 0.05)
    metal: str = one_of("bronze", "marble", "copper")
    plinth: str = one_of("steps", "block")
    plinth_m: float = between(2.0, 4.5)

    def build(self, rng: np.random.Generator) -> Body:
        """The statue facing south."""
        body, h = Body(), self.size_m
        person = Person(h, (0.0, 0.06 * h, self.plinth_m - 0.01 * h))
        person.torso(0.3, self.lean)
        for side in (-1.0, 1.0):
            person.leg(side, 0.29, (0.085, -0.235, 0.3), (0.075, -0.225, 0.05))
        shoulder = 0.3 + 0.285
        hands = {"knee": ((0.145, -0.05, 0.41), (0.09, -0.2, 0.35)), "chin": ((0.11, -0.17, 0.36), (0.03, -0.1, 0.6)),
                 "raised": ((0.2, -0.06, 0.62), (0.2, -0.1, 0.78)), "staff": ((0.19, -0.1, 0.45), (0.2, -0.24, 0.5))}
        person.arm(1.0, shoulder, *hands[self.left_hand], lean=self.lean)
        person.arm(-1.0, shoulder, *hands[self.right_hand], lean=self.lean)
        if self.right_hand == "staff":
            person.limb((-0.2, -0.25, 0.01), (-0.2, -0.25, 0.85), radii=(0.012, 0.012))
            person.limb((-0.2, -0.25, 0.85), (-0.2, -0.25, 0.86), radii=(0.03, 0.03))
        if self.robe == "robe":
            person.limb((-0.04, -0.2, 0.28), (-0.05, -0.2, 0.03), radii=(0.07, 0.1))
            person.limb((0.04, -0.2, 0.28), (0.05, -0.2, 0.03), radii=(0.07, 0.1))
            person.limb((0.0, -0.02, 0.3), (0.0, -0.2, 0.3), radii=(0.09, 0.08))
        shape = Shape(h / 130.0, 0.022 * h)
        shape.add(*person.limbs)
        self._seat(body, shape, h)
        body.add(self.metal, shape.solid())
        plinth(body, self.plinth, (0.24 * h, 0.34 * h), self.plinth_m)
        return body

    def _seat(self, body: Body, shape: Shape, h: float) -> None:
        z, y = self.plinth_m, 0.06 * h
        if self.seat == "rock":
            for k, (dx, dy) in enumerate(((-0.08, 0.0), (0.07, 0.03), (0.0, 0.1), (0.1, -0.06), (-0.1, 0.1))):
                foot = (dx * h, y + dy * h, z + 0.03 * h)
                shape.add(round_cone(foot, (0.8 * dx * h, y + 0.8 * dy * h, z + (0.15 + 0.012 * k) * h),
                                     (0.11 * h, 0.08 * h)))
            return
        high = 0.24 * h
        body.blocks.add("stone", (-0.16 * h, y - 0.12 * h, z), (0.16 * h, y + 0.16 * h, z + high))
        if self.seat == "throne":
            body.blocks.add("stone", (-0.17 * h, y + 0.1 * h, z), (0.17 * h, y + 0.17 * h, z + 0.66 * h))
            for s in (-1.0, 1.0):
                body.blocks.add("stone", (s * 0.14 * h, y - 0.14 * h, z), (s * 0.19 * h, y + 0.16 * h, z + 0.36 * h))
