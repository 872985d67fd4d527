"""Buildings with pitched roofs: houses, rows of houses, churches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.facades import Mass, Windows, band, glaze, opening, raise_mass
from sim_bridge.scenes.families.roofs import gable_roof, hip_roof
from sim_bridge.scenes.families.shapes import drum, loft, rectangle_ring

SIDES = (-1.0, 1.0)


@dataclass(frozen=True)
class GabledHouse(Family):
    """A house or hall under a gable or hip roof, with chimneys, dormers and perhaps a cross wing."""

    length_m: float = between(15.0, 28.0)
    width_m: float = between(8.0, 11.0)
    storeys: int = whole(2, 3)
    storey_m: float = between(2.9, 3.6)
    roof: str = one_of("gable", "gable", "hip")
    pitch: float = between(0.6, 1.1)
    """Rise of the roof over half its width."""
    wall: str = one_of("brick", "plaster", "stone")
    wing_m: float = one_of(0.0, 3.5, 5.0, 6.5)
    """How far a cross wing reaches to the south."""
    chimneys: int = whole(1, 3)
    dormers: int = whole(0, 4)
    """On each side."""

    def build(self, rng: np.random.Generator) -> Body:
        """The house, its ridge along x."""
        body = Body()
        x, y = self.length_m / 2, self.width_m / 2
        mass = Mass(-x, -y, x, y, 0.0, 0.4 + self.storeys * self.storey_m)
        wing = Mass(-0.55 * x, -y - self.wing_m, -0.55 * x + 0.75 * self.width_m, 0.0, 0.0, mass.z1)
        style = Windows(2.8, 1.2, self.storey_m - 1.7, 1.2, surround="stone")
        raise_mass(body, mass, self.wall)
        glaze(body, mass, self.storey_m, style)
        if self.wing_m:
            raise_mass(body, wing, self.wall)
            band(body, wing, "stone", 0.0, 0.45, 0.08)
            glaze(body, wing, self.storey_m, style, "-y")
            gable_roof(body, wing, self.pitch * 0.375 * self.width_m, along="y", wall=self.wall)
        band(body, mass, "stone", 0.0, 0.45, 0.08)
        rise = self.pitch * y
        if self.roof == "hip":
            hip_roof(body, mass, rise)
        else:
            gable_roof(body, mass, rise, wall=self.wall)
        opening(body, mass, "-y", (1.6 * x, 0.05, 1.6 * x + 1.2, 2.5), style)
        self._on_the_roof(body, mass, rise)
        return body

    def _on_the_roof(self, body: Body, mass: Mass, rise: float) -> None:
        x, y = 0.62 * self.length_m / 2, self.width_m / 2
        for at in np.linspace(-x, x, self.chimneys) if self.chimneys > 1 else [0.3 * x]:
            top = mass.z1 + rise + 1.3
            body.blocks.add("brick", (at - 0.45, 0.3, mass.z1), (at + 0.45, 1.1, top))
            body.blocks.add("stone", (at - 0.53, 0.22, top), (at + 0.53, 1.18, top + 0.15))
        for k in range(self.dormers if rise > 3.0 else 0):
            at = (k - (self.dormers - 1) / 2) * 1.7 * x / max(self.dormers, 2) + 1.2
            for s in SIDES:
                outer, inner = sorted((s * 0.72 * y, s * 0.15 * y))
                dormer = Mass(at - 0.75, outer, at + 0.75, inner, mass.z1 - 0.1, mass.z1 + 0.28 * rise + 1.55)
                raise_mass(body, dormer, self.wall)
                low = mass.z1 + 0.28 * rise + 0.3
                opening(body, dormer, "-y" if s < 0 else "+y", (0.25, low, 1.25, low + 1.05), Windows(1, 1, 1, 1))
                body.blocks.add("zinc", (at - 0.9, outer - 0.12, dormer.z1), (at + 0.9, inner + 0.12, dormer.z1 + 0.12))


@dataclass(frozen=True)
class TerracedRow(Family):
    """A row of narrow houses of differing widths, heights, walls and gables."""

    houses: int = whole(5, 8)
    width_m: float = between(4.8, 6.2)
    depth_m: float = between(9.0, 12.0)
    storeys: int = whole(2, 4)
    storey_m: float = between(3.0, 3.6)
    unrest: float = between(0.3, 1.0)
    """How much the houses differ in width and height."""
    gable: str = one_of("steps", "plain", "mixed")

    def build(self, rng: np.random.Generator) -> Body:
        """The row along x, fronts to the south."""
        body = Body()
        widths = self.width_m * (1.0 + 0.25 * self.unrest * rng.uniform(-1.0, 1.0, self.houses))
        edges = np.concatenate([[0.0], np.cumsum(widths)])
        for k in range(self.houses):
            top = 0.3 + self.storeys * self.storey_m + 1.6 * self.unrest * rng.uniform(-0.5, 1.0)
            front = -self.depth_m / 2 - 0.5 * self.unrest * rng.random()
            mass = Mass(edges[k], front, edges[k + 1] - 0.02, self.depth_m / 2, 0.0, round(float(top), 2))
            body.next_blocks()
            self._house(body, mass, ("brick", "plaster", "stone")[int(rng.integers(3))], int(rng.integers(3)))
        return body

    def _house(self, body: Body, mass: Mass, wall: str, kind: int) -> None:
        raise_mass(body, mass, wall)
        storey = (mass.z1 - 0.3) / self.storeys
        style = Windows(1.9, 1.05, storey - 1.35, 0.75, surround="stone")
        glaze(body, Mass(mass.x0, mass.y0, mass.x1, mass.y1, 0.3, mass.z1), storey, style, "-y +y", first=1)
        wide = mass.x1 - mass.x0
        opening(body, mass, "-y", (0.5, 0.05, 1.5, 2.4), style)
        opening(body, mass, "-y", (2.1, 0.9, wide - 0.5, 2.4), style)
        rise = 0.45 * wide + 0.4 * kind
        stepped = self.gable == "steps" or (self.gable == "mixed" and kind != 1)
        if kind == 2 and self.gable == "mixed":
            band(body, mass, "stone", mass.z1, mass.z1 + 0.3, 0.0)
            hip_roof(body, mass, 0.6 * rise, overhang=0.0)
        else:
            gable_roof(body, mass, rise, along="y", wall=wall, overhang=0.0 if stepped else 0.03)
        if stepped and not (kind == 2 and self.gable == "mixed"):
            self._steps(body, mass, wall, rise)
        x = mass.x0 + 0.12
        body.blocks.add("brick", (x, 0.5, mass.z1 - 0.5), (x + 0.8, 1.4, mass.z1 + rise + 0.4))

    def _steps(self, body: Body, mass: Mass, wall: str, rise: float) -> None:
        """A stepped gable in front of the roof."""
        half, middle = (mass.x1 - mass.x0) / 2, (mass.x0 + mass.x1) / 2
        for k in range(5):
            out = half * (1.0 - k / 5)
            low, high = mass.z1 + rise * k / 5, mass.z1 + rise * (k + 1) / 5 + 0.35
            body.blocks.add(wall, (middle - out, mass.y0, low), (middle + out, mass.y0 + 0.4, high))
            body.blocks.add("stone", (middle - out, mass.y0 - 0.06, high), (middle + out, mass.y0 + 0.46, high + 0.1))


@dataclass(frozen=True)
class Church(Family):
    """A nave with buttresses and tall windows, an apse, and a tower with a spire."""

    nave_m: float = between(18.0, 28.0)
    width_m: float = between(8.0, 11.0)
    eaves_m: float = between(7.0, 10.0)
    pitch: float = between(0.9, 1.4)
    aisles: bool = one_of(True, False)
    tower_m: float = between(16.0, 22.0)
    spire_m: float = between(6.0, 16.0)
    spire: str = one_of("pyramid", "octagon", "dome")
    bays: int = whole(4, 6)
    wall: str = one_of("stone", "brick", "plaster")

    def build(self, rng: np.random.Generator) -> Body:
        """The church, its tower to the west."""
        body = Body()
        x, y = self.nave_m / 2, self.width_m / 2
        nave = Mass(-x, -y, x, y, 0.0, self.eaves_m)
        raise_mass(body, nave, self.wall)
        if self.aisles:
            self._aisles(body, nave)
        outer = y + (3.0 if self.aisles else 0.0)
        low = 0.62 * self.eaves_m if self.aisles else 1.8
        for k in range(self.bays):
            middle = (k + 0.5) * self.nave_m / self.bays
            for side in ("-y", "+y"):
                opening(body, nave, side, (middle - 0.65, low, middle + 0.65, self.eaves_m - 0.9), Windows(1, 1, 1, 1))
        for k in range(self.bays + 1):
            at = -x + (self.nave_m - 0.7) * k / self.bays
            for s in SIDES:
                body.blocks.add(self.wall, (at, s * outer, 0.0), (at + 0.7, s * (outer + 0.9), 0.75 * low + 1.6))
                body.blocks.add("stone", (at - 0.05, s * outer, 0.75 * low + 1.6),
                                (at + 0.75, s * (outer + 0.5), 0.75 * low + 2.2))
        gable_roof(body, nave, self.pitch * y, wall=self.wall)
        self._apse(body, x, y)
        self._tower(body, -x)
        return body

    def _aisles(self, body: Body, nave: Mass) -> None:
        top = 0.5 * self.eaves_m
        for s in SIDES:
            y0, y1 = sorted((s * nave.y1, s * (nave.y1 + 3.0)))
            aisle = Mass(nave.x0, y0, nave.x1, y1, 0.0, top)
            raise_mass(body, aisle, self.wall)
            for k in range(self.bays):
                middle = (k + 0.5) * self.nave_m / self.bays
                opening(body, aisle, "-y" if s < 0 else "+y", (middle - 0.55, 1.3, middle + 0.55, top - 0.7),
                        Windows(1, 1, 1, 1))
            body.blocks.add("zinc", (nave.x0 - 0.2, y0 - 0.25, top), (nave.x1 + 0.2, y1 + 0.25, top + 0.18))

    def _apse(self, body: Body, x: float, y: float) -> None:
        r, top = 0.8 * y, 0.85 * self.eaves_m
        body.add(self.wall, drum([(r, 0.0), (r, top)], (x - 0.2, 0.0, 0.0), 28))
        cone = [(r + 0.3, top - 0.05), (r + 0.3, top + 0.1), (0.05, top + 0.75 * r)]
        body.add("tiles", drum(cone, (x - 0.2, 0.0, 0.0), 28))

    def _tower(self, body: Body, x: float) -> None:
        half = 0.42 * self.width_m / 2 + 1.0
        tower = Mass(x - 1.6 * half, -half, x + 0.4 * half, half, 0.0, self.tower_m)
        raise_mass(body, tower, self.wall)
        for z in (0.36 * self.tower_m, 0.68 * self.tower_m, self.tower_m - 0.3):
            band(body, tower, "stone", z, z + 0.3, 0.15)
        for side in ("-x", "+x", "-y", "+y"):
            for shift in (-0.45, 0.45):
                middle = half + shift * half
                opening(body, tower, side, (middle - 0.3 * half, 0.74 * self.tower_m, middle + 0.3 * half,
                                            self.tower_m - 0.9), Windows(1, 1, 1, 1, frame="timber"))
        opening(body, tower, "-x", (half - 0.8, 0.05, half + 0.8, 3.0), Windows(1, 1, 1, 1, frame="timber"))
        axis = (x - 0.6 * half, 0.0)
        if self.spire == "pyramid":
            hip_roof(body, tower, self.spire_m, "copper", 0.25)
        elif self.spire == "octagon":
            needle = [(half * 1.05, -0.05), (0.55 * half, 0.3 * self.spire_m), (0.06, self.spire_m)]
            body.add("copper", drum(needle, (*axis, self.tower_m), 8))
        else:
            t = np.linspace(0.0, 1.45, 10)
            dome = [(half * np.cos(a), half * 1.1 * np.sin(a) - 0.05) for a in t]
            needle = [*dome, (0.25 * half, 1.9 * half), (0.05, 3.0 * half)]
            body.add("copper", drum(needle, (*axis, self.tower_m), 32))
        body.add("stone", loft([rectangle_ring(axis, (half + 0.2, half + 0.2), self.tower_m - 0.02),
                                rectangle_ring(axis, (half + 0.2, half + 0.2), self.tower_m + 0.12)]))
