"""Buildings with flat roofs: office blocks, and blocks around a courtyard."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.facades import Mass, Windows, band, glaze, parapet, raise_mass
from sim_bridge.scenes.families.shapes import drum


@dataclass(frozen=True)
class OfficeBlock(Family):
    """A slab of offices with a flat roof, plant on it, and an entrance canopy."""

    length_m: float = between(26.0, 44.0)
    width_m: float = between(10.0, 16.0)
    storeys: int = whole(3, 6)
    storey_m: float = between(3.2, 3.8)
    bay_m: float = between(2.6, 4.0)
    glazing: str = one_of("punched", "ribbon", "tall")
    wall: str = one_of("concrete", "brick", "plaster")
    rooftop: int = whole(2, 5)
    """Boxes of plant on the roof."""

    def build(self, rng: np.random.Generator) -> Body:
        """The building, its long sides facing south and north."""
        body = Body()
        x, y = self.length_m / 2, self.width_m / 2
        mass = Mass(-x, -y, x, y, 0.0, 0.6 + self.storeys * self.storey_m)
        raise_mass(body, mass, self.wall)
        floors = Mass(-x, -y, x, y, 0.4, mass.z1)
        glaze(body, floors, self.storey_m, self._windows())
        band(body, Mass(-x, -y, x, y, 0.0, 0.0), "stone", 0.0, 0.5, 0.08)
        parapet(body, mass, self.wall)
        self._roof(body, mass, rng)
        body.blocks.add("concrete", (-3.0, -y - 2.6, 3.0), (3.0, -y, 3.25))
        for s in (-1.0, 1.0):
            body.add("trim", drum([(0.12, 0.0), (0.12, 3.05)], (s * 2.6, -y - 2.3, 0.0), 16))
        return body

    def _windows(self) -> Windows:
        wide = {"punched": 0.55, "ribbon": 0.93, "tall": 0.45}[self.glazing] * self.bay_m
        tall = self.storey_m - (1.0 if self.glazing == "tall" else 1.7)
        sill = 0.4 if self.glazing == "tall" else 0.95
        return Windows(self.bay_m, wide, tall, sill, panes=3 if self.glazing == "ribbon" else 2,
                       surround="stone" if self.glazing == "punched" else "")

    def _roof(self, body: Body, mass: Mass, rng: np.random.Generator) -> None:
        for slot in range(self.rooftop):
            wide = (mass.x1 - mass.x0 - 3.0) / self.rooftop
            x = mass.x0 + 1.5 + (slot + 0.5) * wide
            a, b = rng.uniform(0.25, 0.42) * wide, rng.uniform(0.15, 0.3) * self.width_m
            y = rng.uniform(-0.12, 0.12) * self.width_m
            high = rng.uniform(1.4, 3.2)
            if slot % 3 == 2:
                body.add("zinc", drum([(0.8, mass.z1 - 0.02), (0.8, mass.z1 + high), (0.55, mass.z1 + high + 0.3)],
                                      (x, y, 0.0)))
            else:
                body.blocks.add("zinc", (x - a, y - b, mass.z1), (x + a, y + b, mass.z1 + high))


@dataclass(frozen=True)
class CourtyardBuilding(Family):
    """Four wings around a courtyard, with a gateway through the southern one."""

    length_m: float = between(28.0, 40.0)
    width_m: float = between(24.0, 32.0)
    wing_m: float = between(6.0, 8.5)
    storeys: int = whole(2, 4)
    storey_m: float = between(3.3, 4.2)
    wall: str = one_of("plaster", "brick", "stone")
    gate_m: float = between(3.5, 6.0)
    corner_m: float = between(0.0, 3.5)
    """How much higher the corners are than the wings."""

    def build(self, rng: np.random.Generator) -> Body:
        """The building, its gateway to the south."""
        body = Body()
        x, y, w = self.length_m / 2, self.width_m / 2, self.wing_m
        top = 0.5 + self.storeys * self.storey_m
        outer = Mass(-x, -y, x, y, 0.0, top)
        yard = Mass(-x + w, -y + w, x - w, y - w, 0.0, top)
        raise_mass(body, outer, self.wall)
        body.blocks.cut((yard.x0, yard.y0, 0.0), (yard.x1, yard.y1, top))
        style = Windows(3.1, 1.25, self.storey_m - 1.7, 1.0, panes=1, surround="stone")
        glaze(body, outer, self.storey_m, style)
        self._yard_windows(body, yard, style)
        band(body, outer, "stone", top, top + 0.35, 0.35)
        body.blocks.cut((yard.x0 + 0.3, yard.y0 + 0.3, top), (yard.x1 - 0.3, yard.y1 - 0.3, top + 0.35))
        g, high = self.gate_m / 2, min(self.gate_m, self.storey_m + 1.0)
        body.blocks.add("stone", (-g - 0.5, -y - 0.2, 0.0), (g + 0.5, -y + 0.4, high + 0.6))
        body.blocks.cut((-g, -y - 0.2, 0.0), (g, yard.y0, high))
        body.next_blocks()
        self._corners(body, top + 0.33)
        body.add("copper", drum([(1.6, 0.0), (1.6, 0.6), (0.3, 0.7), (0.3, 2.0), (0.9, 2.2), (0.9, 2.35)], sides=32))
        return body

    def _yard_windows(self, body: Body, yard: Mass, style: Windows) -> None:
        """Windows that look into the courtyard: those of four thin masses behind its walls."""
        d, w = 1.0, self.wing_m
        for side, mass in (("+y", Mass(yard.x0, -self.width_m / 2 + w - d, yard.x1, yard.y0, 0.0, yard.z1)),
                           ("-y", Mass(yard.x0, yard.y1, yard.x1, yard.y1 + d, 0.0, yard.z1)),
                           ("+x", Mass(yard.x0 - d, yard.y0, yard.x0, yard.y1, 0.0, yard.z1)),
                           ("-x", Mass(yard.x1, yard.y0, yard.x1 + d, yard.y1, 0.0, yard.z1))):
            glaze(body, mass, self.storey_m, style, side)

    def _corners(self, body: Body, z: float) -> None:
        for sx in (-1.0, 1.0):
            for sy in (-1.0, 1.0):
                x, y, w = sx * self.length_m / 2, sy * self.width_m / 2, self.wing_m
                x0, x1 = sorted((x, x - sx * w))
                y0, y1 = sorted((y, y - sy * w))
                tower = Mass(x0, y0, x1, y1, z, z + self.corner_m)
                raise_mass(body, tower, self.wall)
                if self.corner_m > 2.2:
                    glaze(body, tower, self.corner_m, Windows(3.1, 1.2, self.corner_m - 1.4, 0.6))
                parapet(body, tower, "stone", 0.6)
