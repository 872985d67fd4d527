"""High buildings: blocks of flats with balconies, and towers that step back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.facades import Mass, Windows, band, glaze, parapet, raise_mass
from sim_bridge.scenes.families.shapes import bar, drum, rod

SIDES = (-1.0, 1.0)


@dataclass(frozen=True)
class TowerBlock(Family):
    """A block of flats with columns of balconies, a stair core and a lift house."""

    length_m: float = between(15.0, 22.0)
    width_m: float = between(11.0, 15.0)
    storeys: int = whole(9, 13)
    storey_m: float = between(2.75, 3.0)
    wall: str = one_of("concrete", "brick", "plaster")
    balconies: int = whole(1, 3)
    """Columns of them on each long side."""
    balcony: str = one_of("solid", "rails")
    core: str = one_of("end", "side")
    bay_m: float = between(2.6, 3.6)

    def build(self, rng: np.random.Generator) -> Body:
        """The block, its long sides facing south and north."""
        body = Body()
        x, y = self.length_m / 2, self.width_m / 2
        mass = Mass(-x, -y, x, y, 0.0, 0.8 + self.storeys * self.storey_m)
        raise_mass(body, mass, self.wall)
        floors = Mass(-x, -y, x, y, 0.8, mass.z1)
        glaze(body, floors, self.storey_m, Windows(self.bay_m, 1.5, 1.35, 0.9))
        band(body, mass, "stone", 0.0, 0.7, 0.06)
        parapet(body, mass, self.wall, 0.9)
        for k in range(self.balconies):
            middle = (k - (self.balconies - 1) / 2) * self.length_m / self.balconies
            for s in SIDES:
                for storey in range(1, self.storeys):
                    self._balcony(body, middle, s * y, s, 0.8 + storey * self.storey_m)
        self._core(body, mass)
        body.blocks.add(self.wall, (-2.5, -2.0, mass.z1), (2.5, 2.0, mass.z1 + 2.8))
        body.add("trim", rod((1.5, 0.0, mass.z1 + 2.7), (1.5, 0.0, mass.z1 + 6.5), 0.06))
        for s in SIDES:
            vent = (s * 0.35 * self.length_m, 0.0, mass.z1)
            body.add("zinc", drum([(0.5, -0.1), (0.5, 1.2)], vent, 20))
        return body

    def _balcony(self, body: Body, x: float, y: float, side: float, z: float) -> None:
        half, out = 1.9, y + side * 1.3
        body.blocks.add("concrete", (x - half, y, z - 0.16), (x + half, out, z))
        if self.balcony == "solid":
            body.blocks.add("plaster", (x - half, out - side * 0.1, z), (x + half, out, z + 1.0))
            for s in SIDES:
                body.blocks.add("plaster", (x + s * half, y, z), (x + s * (half - 0.1), out, z + 1.0))
            return
        rail = out - side * 0.06
        for post in np.arange(x - half + 0.06, x + half, 0.31):
            body.add("trim", bar((post, rail, z - 0.03), (post, rail, z + 1.01), 0.035))
        body.add("trim", bar((x - half, rail, z + 1.03), (x + half, rail, z + 1.03), 0.06))
        for s in SIDES:
            end = x + s * (half - 0.04)
            body.add("trim", bar((end, y - side * 0.05, z + 1.03), (end, out, z + 1.03), 0.05))

    def _core(self, body: Body, mass: Mass) -> None:
        top = mass.z1 + 2.2
        if self.core == "end":
            core = Mass(mass.x1 - 0.5, -2.4, mass.x1 + 3.4, 2.4, 0.0, top)
            raise_mass(body, core, "concrete")
            glaze(body, core, self.storey_m, Windows(4.8, 0.9, 1.7, 0.8), "+x")
        else:
            core = Mass(-2.4, mass.y1 - 0.5, 2.4, mass.y1 + 2.8, 0.0, top)
            raise_mass(body, core, "concrete")
            glaze(body, core, self.storey_m, Windows(4.8, 0.9, 1.7, 0.8), "+y")


@dataclass(frozen=True)
class SetbackTower(Family):
    """A tower of tiers that step back, with piers between tall windows and a crown."""

    base_m: float = between(17.0, 24.0)
    oblong: float = between(0.65, 1.0)
    tiers: int = whole(3, 5)
    shrink: float = between(0.72, 0.86)
    """Side of a tier over that of the one below."""
    storeys: int = whole(10, 13)
    storey_m: float = between(3.0, 3.4)
    piers: bool = one_of(True, False)
    off_centre: float = between(0.0, 0.6)
    crown: str = one_of("mast", "drum", "lantern")
    wall: str = one_of("stone", "brick", "concrete")

    def build(self, rng: np.random.Generator) -> Body:
        """The tower."""
        body = Body()
        shares = np.array([0.42, 0.25, 0.15, 0.1, 0.08])[: self.tiers]
        floors = np.maximum(1, np.round(shares / shares.sum() * self.storeys)).astype(int)
        half, z = np.array([self.base_m, self.base_m * self.oblong]) / 2, 0.0
        middle = np.zeros(2)
        for k, count in enumerate(floors):
            top = z + count * self.storey_m + 0.7
            mass = Mass(middle[0] - half[0], middle[1] - half[1], middle[0] + half[0], middle[1] + half[1], z, top)
            self._tier(body, mass)
            body.next_blocks()
            z = top - 0.02
            if k + 1 < self.tiers:
                middle = middle + half * (1.0 - self.shrink) * self.off_centre * rng.choice([-1.0, 1.0], 2)
                half = half * self.shrink
        self._crown(body, middle, float(half.min()), z)
        return body

    def _tier(self, body: Body, mass: Mass) -> None:
        raise_mass(body, mass, self.wall)
        glaze(body, mass, self.storey_m, Windows(2.6, 1.35, self.storey_m - 1.0, 0.7))
        if self.piers:
            for length, place in ((mass.x1 - mass.x0, "x"), (mass.y1 - mass.y0, "y")):
                bays = max(1, round(length / 2.6))
                for i in range(bays + 1):
                    at = -0.3 + i * (length + 0.6 - 0.5) / bays
                    for out in (-0.2, 0.0):
                        if place == "x":
                            y = mass.y0 + out if out else mass.y1
                            body.blocks.add("stone", (mass.x0 + at, y, mass.z0), (mass.x0 + at + 0.5, y + 0.2, mass.z1))
                        else:
                            x = mass.x0 + out if out else mass.x1
                            body.blocks.add("stone", (x, mass.y0 + at, mass.z0), (x + 0.2, mass.y0 + at + 0.5, mass.z1))
        band(body, mass, "stone", mass.z1 - 0.35, mass.z1 - 0.02, 0.25)
        parapet(body, mass, self.wall, 0.9)

    def _crown(self, body: Body, middle: np.ndarray, half: float, z: float) -> None:
        x, y = (float(c) for c in middle)
        if self.crown == "mast":
            a = 0.5 * half
            body.blocks.add("zinc", (x - a, y - a, z - 0.1), (x + a, y + a, z + 2.0))
            body.add("trim", rod((x, y, z + 1.9), (x, y, z + 9.0), [0.25, 0.05], 12))
        elif self.crown == "drum":
            r = 0.62 * half
            body.add("copper", drum([(r, z - 0.1), (r, z + 2.5), (r + 0.2, z + 2.6), (r + 0.2, z + 2.9),
                                     (0.7 * r, z + 2.9 + 0.6 * r), (0.1, z + 2.9 + 0.9 * r)], (x, y, 0.0), 40))
        else:
            lantern = Mass(x - 0.55 * half, y - 0.55 * half, x + 0.55 * half, y + 0.55 * half, z - 0.1, z + 3.4)
            raise_mass(body, lantern, "stone")
            glaze(body, lantern, 3.4, Windows(1.6, 0.9, 2.4, 0.5))
            body.add("copper", drum([(0.78 * half, z + 3.35), (0.78 * half, z + 3.5), (0.05, z + 3.5 + 1.4 * half)],
                                    (x, y, 0.0), 4))
