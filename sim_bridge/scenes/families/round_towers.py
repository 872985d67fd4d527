"""Round shells of masonry, concrete and steel: chimneys, water towers, cooling towers."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.galleries import gallery, ladder
from sim_bridge.scenes.families.shapes import ball, bar, collar, drum, rod, turned_profile


@dataclass(frozen=True)
class Chimney(Family):
    """A tapering stack with bands, ladder and working platforms, on a base with a flue."""

    height_m: float = between(26.0, 42.0)
    foot_m: float = between(2.0, 3.2)
    """Radius at the foot."""
    taper: float = between(0.45, 0.75)
    """Radius at the top over that at the foot."""
    wall: str = one_of("brick", "concrete", "red")
    base: str = one_of("square", "drum")
    bands: int = whole(2, 5)
    platforms: int = whole(1, 3)

    def build(self, rng: np.random.Generator) -> Body:
        """The stack with its flue towards +x."""
        body = Body()
        plinth = 0.1 * self.height_m
        if self.base == "square":
            half = self.foot_m * 1.25
            body.blocks.add("stone", (-half, -half, 0.0), (half, half, plinth))
            body.blocks.add("stone", (-half - 0.2, -half - 0.2, plinth), (half + 0.2, half + 0.2, plinth + 0.5))
        else:
            body.add("stone", drum([(1.3 * self.foot_m, 0.0), (1.2 * self.foot_m, plinth + 0.5)], sides=40))
        self._shaft(body, plinth + 0.45)
        body.blocks.add("concrete", (0.5, -1.1, 0.0), (self.foot_m * 1.3 + 7.0, 1.1, 2.6))
        for k in range(self.platforms):
            gallery(body, self._radius(z := self.height_m * (0.93 - 0.27 * k)), z)
        for band in range(self.bands):
            z = self.height_m * (0.3 + 0.62 * band / self.bands)
            body.add("trim", collar(self._radius(z) - 0.2, self._radius(z) + 0.06, z, z + 0.3, 48))
        body.add_all("trim", ladder(self._radius, -np.pi / 2, plinth + 1.5, self.height_m - 0.5))
        return body

    def _radius(self, z: float) -> float:
        return self.foot_m * (1.0 + (self.taper - 1.0) * float(np.power(z / self.height_m, 0.8)))

    def _shaft(self, body: Body, foot: float) -> None:
        heights = np.linspace(foot, self.height_m - 1.2, 12)
        crown = self._radius(self.height_m)
        outside = [(self._radius(z), z) for z in heights]
        rim = [(crown + 0.22, self.height_m - 0.9), (crown + 0.22, self.height_m), (crown - 0.3, self.height_m),
               (crown - 0.3, self.height_m - 4.0)]
        body.add(self.wall, drum([*outside, *rim], sides=48))


@dataclass(frozen=True)
class WaterTower(Family):
    """A tank on braced legs around a riser, or on one concrete shaft."""

    height_m: float = between(22.0, 36.0)
    tank_m: float = between(4.0, 6.5)
    """Radius of the tank."""
    tank: str = one_of("sphere", "conical", "cylinder")
    support: str = one_of("legs", "legs", "shaft")
    legs: int = whole(4, 8)
    tiers: int = whole(3, 4)
    splay: float = between(1.05, 1.35)

    def build(self, rng: np.random.Generator) -> Body:
        """The tower."""
        body = Body()
        bottom = self._tank(body)
        widest = {"sphere": 0.85, "conical": 0.78, "cylinder": 0.33}[self.tank]
        gallery(body, self.tank_m - 0.02, bottom + widest * self.tank_m)
        if self.support == "shaft":
            body.add("concrete", drum([(2.6, 0.0), (1.5, 3.0), (1.4, bottom + 0.8), (2.0, bottom + 1.4)], sides=40))
        else:
            self._legs(body, bottom + 0.9)
            body.add("paint", drum([(0.6, 0.0), (0.6, bottom + 0.8)], sides=20))
        return body

    def _tank(self, body: Body) -> float:
        """Add the tank under the full height; returns the height of its lowest point."""
        r, roof = self.tank_m, self.height_m - 0.8
        if self.tank == "sphere":
            body.add("white", ball((0.0, 0.0, roof - 0.85 * r), r, 48, 0.85))
            bottom = roof - 1.7 * r
        else:
            tall = 1.1 * r if self.tank == "cylinder" else 0.7 * r
            low = roof - 0.3 * r - tall
            cone = [(0.3 * r, low - 0.75 * r)] if self.tank == "conical" else [(0.6 * r, low - 0.3 * r)]
            body.add("white", drum([*cone, (r, low), (r, low + tall), (r + 0.15, low + tall), (0.3, roof)], sides=56))
            bottom = cone[0][1]
        vent = [(0.35, roof - 0.3), (0.35, roof + 0.5), (0.55, roof + 0.55), (0.1, self.height_m)]
        body.add("trim", drum(vent, sides=16))
        return bottom

    def _legs(self, body: Body, top: float) -> None:
        corners = np.arange(self.legs) * 2.0 * np.pi / self.legs
        ring = np.stack([np.cos(corners), np.sin(corners), np.zeros_like(corners)], axis=1)
        heights = np.linspace(0.3, top, self.tiers + 1)
        radii = [self.tank_m * (0.72 + (self.splay - 0.72) * (1.0 - z / top)) for z in heights]
        levels = [r * ring + (0.0, 0.0, z) for r, z in zip(radii, heights, strict=True)]
        for i in range(self.legs):
            j = (i + 1) % self.legs
            body.add("paint", rod(levels[0][i], levels[-1][i], 0.2, 14))
            body.blocks.add("concrete", levels[0][i] - (0.6, 0.6, 0.3), levels[0][i] + (0.6, 0.6, 0.1))
            for low, high in pairwise(levels):
                body.add("paint", rod(low[i], high[j], 0.03, 6), rod(low[j], high[i], 0.03, 6))
                body.add("paint", bar(high[i], high[j], 0.18))


@dataclass(frozen=True)
class CoolingTower(Family):
    """A hyperboloid shell of concrete on crossed columns."""

    height_m: float = between(26.0, 38.0)
    foot_m: float = between(10.0, 14.0)
    waist: float = between(0.55, 0.68)
    """Radius at the waist over that at the foot."""
    waist_z: float = between(0.65, 0.8)
    """Height of the waist over the height."""
    columns: int = whole(14, 24)
    inlet_m: float = between(2.5, 4.0)
    ribs: int = one_of(0, 24, 36)

    def build(self, rng: np.random.Generator) -> Body:
        """The tower with its basin."""
        body = Body()
        zs = np.linspace(self.inlet_m, self.height_m, 30)
        outside = [(self._radius(z), z) for z in zs]
        inside = [(self._radius(z) - 0.35, z) for z in zs[::-1]]
        body.add("concrete", turned_profile([*outside, *inside], 96))
        body.add("concrete", collar(self._radius(self.height_m) - 0.4, self._radius(self.height_m) + 0.35,
                                    self.height_m - 0.7, self.height_m + 0.15, 96))
        foot = self._radius(0.0)
        body.add("concrete", collar(foot - 0.9, foot + 0.9, 0.0, 0.7, 72))
        for k in range(self.columns):
            a, b = (2.0 * np.pi * (k + e) / self.columns for e in (0.0, 0.5))
            low = np.array([foot * np.cos(b), foot * np.sin(b), 0.5])
            for c in (a, a + 2.0 * np.pi / self.columns):
                r = self._radius(self.inlet_m) - 0.15
                body.add("concrete", rod(low, (r * np.cos(c), r * np.sin(c), self.inlet_m + 0.3), 0.28, 12))
        for k in range(self.ribs):
            a = 2.0 * np.pi * k / self.ribs
            line = [((self._radius(z) - 0.05) * np.cos(a), (self._radius(z) - 0.05) * np.sin(a), z) for z in zs[::2]]
            for p, q in pairwise(line):
                body.add("concrete", bar(p, q, 0.16, 0.3, (np.cos(a), np.sin(a), 0.0)))
        return body

    def _radius(self, z: float) -> float:
        waist = self.waist * self.foot_m
        bulge = (self.foot_m / waist) ** 2 - 1.0
        u = (z / self.height_m - self.waist_z) / self.waist_z
        return waist * float(np.sqrt(1.0 + bulge * u * u))
