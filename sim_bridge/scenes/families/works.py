"""Industrial plants with buildings: pipe racks with vessels, boiler houses with stacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.facades import Mass, Windows, band, glaze, opening, parapet, raise_mass
from sim_bridge.scenes.families.galleries import gallery, ladder
from sim_bridge.scenes.families.racks import Rack, raise_rack
from sim_bridge.scenes.families.roofs import gable_roof
from sim_bridge.scenes.families.shapes import bar, collar, drum, pipe, rod, vessel


@dataclass(frozen=True)
class PipeRack(Family):
    """A long pipe rack with fans on top, horizontal vessels and pumps on one side, and upright drums on the other."""

    length_m: float = between(36.0, 56.0)
    width_m: float = between(4.5, 7.0)
    tiers: int = whole(2, 3)
    tier_m: float = between(2.6, 3.6)
    vessels: int = whole(2, 4)
    drums: int = whole(2, 4)
    coolers: int = whole(2, 6)
    """Fan bays on the top."""
    branches: int = whole(3, 6)

    def build(self, rng: np.random.Generator) -> Body:
        """The rack along x."""
        body = Body()
        rack = Rack(self.length_m, self.width_m, self.tiers, self.tier_m)
        raise_rack(body, rack, (0.0, 0.0), rng)
        top = rack.height(self.tiers - 1)
        self._coolers(body, top)
        south, north = -self.width_m / 2 - 4.0, self.width_m / 2 + 3.2
        for k in range(self.vessels):
            x = (k - (self.vessels - 1) / 2) * self.length_m / self.vessels
            self._vessel(body, x, south, rng.uniform(0.8, 1.3), rng.uniform(1.8, 3.0), rack.height(0))
        for k in range(self.drums):
            x = (k - (self.drums - 1) / 2) * self.length_m / self.drums + 1.5
            r, h = rng.uniform(0.8, 1.4), rng.uniform(4.5, 9.0)
            t = np.linspace(0.0, 1.5, 6)
            dome = [(r * np.cos(a), h + 0.4 * r * np.sin(a)) for a in t]
            body.add("white" if k % 2 else "zinc", drum([(r, 0.4), *dome], (x, north, 0.0), 36))
            body.add("concrete", drum([(r + 0.4, 0.0), (r + 0.4, 0.45)], (x, north, 0.0), 24))
            body.add("zinc", pipe([(x, north, h), (x, north, h + 1.0 + 0.4 * r), (x, 0.4, h + 1.0 + 0.4 * r),
                                   (x, 0.4, top - 0.1)], 0.14))
        for k in range(self.branches):
            x = (k + 0.5 - self.branches / 2) * self.length_m / self.branches
            z = rack.height(k % self.tiers) - 0.6
            body.add("paint", pipe([(x, -0.4, z), (x, south + 1.6, z), (x, south + 1.6, 0.5)], 0.11))
            body.blocks.add("concrete", (x - 0.5, south + 1.0, 0.0), (x + 0.5, south + 2.2, 0.35))
            body.add("red", rod((x - 0.4, south + 1.6, 0.6), (x + 0.5, south + 1.6, 0.6), 0.28, 20))
        return body

    def _coolers(self, body: Body, top: float) -> None:
        wide = min(5.0, self.length_m / max(self.coolers, 1) - 0.4)
        for k in range(self.coolers):
            x = (k - (self.coolers - 1) / 2) * (wide + 0.3)
            z = top + 2.0
            half = self.width_m / 2
            for sx in (-1.0, 1.0):
                for sy in (-1.0, 1.0):
                    post = (x + sx * (wide / 2 - 0.15), sy * half)
                    body.add("paint", bar((*post, top), (*post, z + 0.1), 0.16))
            body.blocks.add("zinc", (x - wide / 2, -half - 0.3, z), (x + wide / 2, half + 0.3, z + 0.7))
            for s in (-1.0, 1.0):
                body.add("zinc", collar(0.9, 1.05, z + 0.65, z + 1.2, 32, (x, s * half * 0.5, 0.0)))
                y = s * half * 0.5
                body.add("trim", bar((x - 0.92, y, z + 1.0), (x + 0.92, y, z + 1.0), 0.16, 0.05),
                         bar((x, y - 0.92, z + 1.03), (x, y + 0.92, z + 1.03), 0.16, 0.05))

    def _vessel(self, body: Body, x: float, y: float, r: float, half: float, tier: float) -> None:
        z = r + 1.5
        body.add("white", vessel((x - half, y, z), (x + half, y, z), r, 36))
        for s in (-0.6, 0.6):
            at = x + s * half
            body.blocks.add("concrete", (at - 0.25, y - 0.8 * r, 0.0), (at + 0.25, y + 0.8 * r, z - 0.5 * r))
        over, walk = z + r + 0.9, z + r + 0.05
        body.add("zinc", pipe([(x, y, z + r - 0.1), (x, y, over), (x, -0.6, over), (x, -0.6, tier)], 0.15))
        body.add("trim", bar((x - half, y, walk), (x + half, y, walk), 0.9, 0.08))


@dataclass(frozen=True)
class BoilerHouse(Family):
    """A boiler hall with steel stacks, flue ducts, a fuel silo and a side building."""

    length_m: float = between(20.0, 32.0)
    width_m: float = between(11.0, 16.0)
    height_m: float = between(11.0, 17.0)
    roof: str = one_of("flat", "gable", "teeth")
    stacks: int = whole(1, 4)
    stack_m: float = between(8.0, 18.0)
    """Height of the stacks above the hall."""
    wall: str = one_of("brick", "zinc", "concrete")
    annex_m: float = between(4.0, 8.0)
    silo: bool = one_of(True, False)

    def build(self, rng: np.random.Generator) -> Body:
        """The hall along x, stacks to the north."""
        body = Body()
        x, y = self.length_m / 2, self.width_m / 2
        hall = Mass(-x, -y, x, y, 0.0, self.height_m)
        raise_mass(body, hall, self.wall)
        band(body, hall, "concrete", 0.0, 0.8, 0.08)
        tall = Windows(4.2, 2.0, 0.62 * self.height_m, 0.2 * self.height_m, panes=4)
        glaze(body, hall, self.height_m, tall, "-y +y -x")
        opening(body, hall, "+x", (y - 2.0, 0.05, y + 2.0, 4.5), Windows(1, 1, 1, 1, panes=4, frame="paint"))
        self._roof(body, hall)
        annex = Mass(-x + 2.0, -y - self.annex_m, x - 5.0, -y, 0.0, 0.42 * self.height_m)
        raise_mass(body, annex, "brick")
        glaze(body, annex, annex.z1, Windows(2.6, 1.3, 0.45 * annex.z1, 0.3 * annex.z1, surround="stone"), "-y -x +x")
        parapet(body, annex, "brick", 0.6)
        for k in range(self.stacks):
            self._stack(body, (k - (self.stacks - 1) / 2) * self.length_m / (self.stacks + 0.5), y)
        if self.silo:
            self._silo(body, x + 3.4)
        return body

    def _roof(self, body: Body, hall: Mass) -> None:
        if self.roof == "flat":
            parapet(body, hall, self.wall, 0.9)
            for k in range(3):
                at = (k - 1) * self.length_m / 3.5
                body.blocks.add("zinc", (at - 1.2, -1.2, hall.z1), (at + 1.2, 1.2, hall.z1 + 1.6))
        elif self.roof == "gable":
            gable_roof(body, hall, 0.24 * self.width_m, wall=self.wall, cover="zinc")
            body.blocks.add("zinc", (-0.35 * self.length_m, -1.0, hall.z1 + 0.1 * self.width_m),
                            (0.35 * self.length_m, 1.0, hall.z1 + 0.24 * self.width_m + 1.4))
        else:
            teeth = round(self.length_m / 5.0)
            for k in range(teeth):
                wide = self.length_m / teeth
                tooth = Mass(hall.x0 + k * wide, hall.y0, hall.x0 + (k + 1) * wide - 0.02, hall.y1, 0.0, hall.z1)
                gable_roof(body, tooth, 0.35 * wide, along="y", wall=self.wall, cover="zinc", overhang=0.02)

    def _stack(self, body: Body, x: float, wall_y: float) -> None:
        r, y, top = 0.75, wall_y + 3.6, self.height_m + self.stack_m
        body.add("concrete", drum([(r + 0.8, 0.0), (r + 0.8, 0.8)], (x, y, 0.0), 32))
        body.add("zinc", drum([(r, 0.7), (r, top - 0.2), (r + 0.1, top - 0.2), (r + 0.1, top), (r - 0.1, top),
                               (r - 0.1, top - 2.5)], (x, y, 0.0), 36))
        for k in range(1, 4):
            z = top * k / 4.0
            body.add("red", collar(r - 0.1, r + 0.05, z, z + 1.0, 36, (x, y, 0.0)))
        duct = 0.45 * self.height_m
        body.blocks.add("zinc", (x - 0.8, wall_y, duct), (x + 0.8, y, duct + 1.8))
        gallery(body, r, top - 2.5, middle=(x, y))
        body.add_all("trim", ladder(lambda _: r, np.pi / 2, 1.5, top - 2.4, (x, y)))

    def _silo(self, body: Body, x: float) -> None:
        r, h = 2.2, 0.85 * self.height_m
        body.add("zinc", drum([(0.4, 2.2), (r, 4.6), (r, h), (0.4, h + 1.2)], (x, 0.0, 0.0), 44))
        for a in np.arange(4) * np.pi / 2 + np.pi / 4:
            foot = (x + (r - 0.1) * np.cos(a), (r - 0.1) * np.sin(a), 0.0)
            body.add("paint", bar(foot, (*foot[:2], 5.0), 0.3))
        body.add("paint", bar((x, 0.0, h + 1.0), (self.length_m / 2 - 0.5, 0.0, self.height_m - 0.8), 1.0, 1.2))
