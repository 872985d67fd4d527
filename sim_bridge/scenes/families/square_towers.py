"""Towers on a square: lattice masts with antennas, clock towers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.facades import Mass, Windows, band, opening, raise_mass
from sim_bridge.scenes.families.roofs import hip_roof
from sim_bridge.scenes.families.shapes import bar, drum, footing, raised, rectangle_ring, rod, vessel
from sim_bridge.scenes.families.wires import lattice

SIDES = (-1.0, 1.0)


@dataclass(frozen=True)
class LatticeMast(Family):
    """A free-standing lattice tower with platforms, dishes and antennas."""

    height_m: float = between(26.0, 40.0)
    foot_m: float = between(2.2, 3.6)
    """Half the side at the ground."""
    waist: float = between(0.5, 0.75)
    """Share of the height at which it stops tapering."""
    head_m: float = between(0.5, 0.9)
    platforms: int = whole(1, 3)
    dishes: int = whole(3, 7)
    cabin: bool = one_of(True, False)

    def build(self, rng: np.random.Generator) -> Body:
        """The mast, with a cabin to the east if any."""
        body = Body()
        waist_z = self.waist * self.height_m
        foot, waist, head = (rectangle_ring((0.0, 0.0), (h, h), z) for h, z in
                             ((self.foot_m, 0.4), (self.head_m * 1.1, waist_z), (self.head_m, self.height_m - 3.0)))
        body.add_all("red", lattice(foot, waist, 7, 0.18, 0.09))
        body.add_all("white", lattice(waist, head, 8, 0.14, 0.07))
        for corner in foot:
            body.add("concrete", footing(corner[0], corner[1], 0.7, 0.5))
        for k in range(self.platforms):
            z = self.height_m - 3.2 - k * 0.16 * self.height_m
            half = self.head_m + 1.0
            body.blocks.add("zinc", (-half, -half, z - 0.1), (half, half, z))
            self._rails(body, half - 0.05, z)
        body.add("white", rod((0.0, 0.0, self.height_m - 3.3), (0.0, 0.0, self.height_m), [0.12, 0.04], 12))
        for _ in range(self.dishes):
            self._dish(body, rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.55, 0.9) * self.height_m,
                       rng.uniform(0.5, 1.1))
        if self.cabin:
            hut = Mass(self.foot_m + 1.0, -1.6, self.foot_m + 5.0, 1.6, 0.0, 2.9)
            raise_mass(body, hut, "concrete")
            opening(body, hut, "-y", (1.4, 0.1, 2.4, 2.2), Windows(1, 1, 1, 1))
            body.blocks.add("zinc", (hut.x0 - 0.2, -1.8, 2.9), (hut.x1 + 0.2, 1.8, 3.05))
        return body

    def _rails(self, body: Body, half: float, z: float) -> None:
        corners = rectangle_ring((0.0, 0.0), (half, half), 0.0)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            for height in (0.55, 1.1):
                body.add("zinc", rod(raised(a, z + height), raised(b, z + height), 0.025, 6))
            for t in (0.0, 0.33, 0.67):
                post = a + t * (b - a)
                body.add("zinc", rod(raised(post, z - 0.05), raised(post, z + 1.1), 0.025, 6))

    def _dish(self, body: Body, angle: float, z: float, radius: float) -> None:
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        t = np.clip((z - 0.4) / (self.waist * self.height_m), 0.0, 1.0)
        start = out * (self.foot_m + (self.head_m * 1.1 - self.foot_m) * t)
        middle = raised(start + out * 0.9, z)
        body.add("zinc", rod(raised(start * 0.7, z), middle, 0.05, 8))
        body.add("white", vessel(middle, middle + 0.25 * radius * out, radius, 24))


@dataclass(frozen=True)
class ClockTower(Family):
    """A square masonry tower with a belfry, clock faces and a pointed or crenellated top."""

    height_m: float = between(20.0, 34.0)
    """Of the walls."""
    side_m: float = between(5.0, 7.5)
    wall: str = one_of("stone", "brick", "plaster")
    top: str = one_of("pyramid", "crenels", "dome")
    storeys: int = whole(3, 5)
    buttress_m: float = between(0.0, 1.0)
    belfry: int = whole(1, 3)
    """Openings on each side."""

    def build(self, rng: np.random.Generator) -> Body:
        """The tower, its door to the south."""
        body, half = Body(), self.side_m / 2
        tower = Mass(-half, -half, half, half, 0.0, self.height_m)
        raise_mass(body, tower, self.wall)
        if self.buttress_m > 0.3:
            for sx in SIDES:
                for sy in SIDES:
                    for out, top in ((self.buttress_m, 0.35), (0.6 * self.buttress_m, 0.7)):
                        body.blocks.add(self.wall, (sx * (half - 0.8), sy * (half - 0.8), 0.0),
                                        (sx * (half + out), sy * (half + out), top * self.height_m))
        belfry = 0.78 * self.height_m
        for k in range(1, self.storeys + 1):
            band(body, tower, "stone", belfry * k / self.storeys, belfry * k / self.storeys + 0.35, 0.2)
        self._openings(body, tower, belfry)
        band(body, tower, "stone", self.height_m - 0.5, self.height_m, 0.35)
        if self.top == "pyramid":
            hip_roof(body, tower, 1.2 * self.side_m, "tiles", 0.3)
        elif self.top == "dome":
            t = np.linspace(0.0, 1.5, 10)
            dome = [(half * np.cos(a), half * np.sin(a) - 0.05) for a in t]
            body.add("copper", drum(dome, (0.0, 0.0, self.height_m), 40),
                     rod((0.0, 0.0, self.height_m + half - 0.1), (0.0, 0.0, self.height_m + half + 2.5), [0.15, 0.03]))
        else:
            for k in range(5):
                at = -half - 0.35 + k * (self.side_m + 0.7 - 0.8) / 4
                for s in SIDES:
                    y0, y1 = sorted((s * (half + 0.35), s * (half - 0.05)))
                    body.blocks.add(self.wall, (at, y0, self.height_m), (at + 0.8, y1, self.height_m + 1.1))
                    body.blocks.add(self.wall, (y0, at, self.height_m), (y1, at + 0.8, self.height_m + 1.1))
        return body

    def _openings(self, body: Body, tower: Mass, belfry: float) -> None:
        plain = Windows(1, 1, 1, 1)
        opening(body, tower, "-y", (self.side_m / 2 - 0.8, 0.05, self.side_m / 2 + 0.8, 3.2),
                Windows(1, 1, 1, 1, frame="timber"))
        for side in ("-x", "+x", "-y", "+y"):
            for k in range(1, self.storeys):
                z = belfry * k / self.storeys + 1.2
                opening(body, tower, side, (self.side_m / 2 - 0.4, z, self.side_m / 2 + 0.4, z + 1.9), plain)
            for i in range(self.belfry):
                middle = self.side_m * (0.18 + 0.64 * (i + 0.5) / self.belfry)
                wide = 0.26 * self.side_m / self.belfry
                opening(body, tower, side, (middle - wide, belfry + 0.7, middle + wide, self.height_m - 0.9), plain)
        half = self.side_m / 2
        for turn in range(4):
            along = np.array([np.cos(turn * np.pi / 2), np.sin(turn * np.pi / 2), 0.0])
            face = raised(along * (half - 0.1), belfry - 0.17 * self.side_m - 0.4)
            body.add("white", rod(face, face + 0.22 * along, 0.16 * self.side_m, 40))
            for rise, aside in ((0.11, 0.04), (0.02, 0.1)):
                tip = face + 0.24 * along + self.side_m * (np.array([-along[1], along[0], 0.0]) * aside + (0, 0, rise))
                body.add("trim", bar(face + 0.24 * along, tip, 0.12, 0.06))
