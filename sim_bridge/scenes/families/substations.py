"""Outdoor switchgear: gantries, busbars, breakers and a transformer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.shapes import bar, drum, footing, rectangle_ring, rod, vessel
from sim_bridge.scenes.families.wires import insulator, lattice, string_wires
from sim_bridge.scenes.solids import Solid

PHASES = (-1.0, 0.0, 1.0)


@dataclass(frozen=True)
class SubstationGantry(Family):
    """Gantries with strung conductors over rows of breakers, isolators and busbars, and a transformer at the end."""

    bays: int = whole(2, 3)
    """Between the gantries."""
    bay_m: float = between(13.0, 18.0)
    height_m: float = between(10.0, 15.0)
    span_m: float = between(10.0, 14.0)
    """Between a gantry's columns."""
    phase_m: float = between(2.4, 3.2)
    column: str = one_of("lattice", "A-frame")
    peak_m: float = between(1.5, 4.0)
    """Of the lightning rods above the beams."""
    breakers: str = one_of("tank", "pillar")
    busbar_m: float = between(4.0, 5.5)

    def build(self, rng: np.random.Generator) -> Body:
        """The yard along x."""
        body = Body()
        stations = (np.arange(self.bays + 1) - self.bays / 2) * self.bay_m
        for x in stations:
            self._gantry(body, float(x))
        places = [(p * self.phase_m, self.height_m - 0.75) for p in PHASES]
        string_wires(body, stations.tolist(), places, 14.0)
        for x in stations:
            for y, _ in places:
                body.add("ceramic", insulator((float(x), y, self.height_m - 0.08), 0.7, 5))
        for k in range(self.bays):
            middle = float(stations[k] + stations[k + 1]) / 2
            for p in PHASES:
                self._bay(body, middle, p * self.phase_m)
        self._busbars(body, float(stations[0]), float(stations[-1]))
        self._transformer(body, float(stations[-1]) + 6.0)
        return body

    def _gantry(self, body: Body, x: float) -> None:
        h, half = self.height_m, self.span_m / 2
        for s in (-1.0, 1.0):
            y = s * half
            if self.column == "lattice":
                foot = rectangle_ring((x, y), (0.7, 0.7), 0.25)
                body.add_all("zinc", lattice(foot, rectangle_ring((x, y), (0.35, 0.35), h + 0.7), 7, 0.11, 0.06))
                corners = foot[:, :2]
            else:
                for e in (-1.0, 1.0):
                    body.add("zinc", rod((x + e * 1.6, y, 0.2), (x, y, h + 0.6), 0.16, 14))
                for z in (0.3 * h, 0.65 * h):
                    w = 1.6 * (1.0 - z / (h + 0.6)) + 0.05
                    body.add("zinc", bar((x - w, y, z), (x + w, y, z), 0.14))
                corners = np.array([(x - 1.6, y), (x + 1.6, y)])
            for cx, cy in corners:
                body.add("concrete", footing(float(cx), float(cy), 0.45, 0.35))
            body.add("zinc", rod((x, y, h + 0.5), (x, y, h + 0.7 + self.peak_m), [0.08, 0.02], 8))
        near, far = (np.array([(x - 0.35, y, h - 0.1), (x + 0.35, y, h - 0.1), (x + 0.35, y, h + 0.6),
                               (x - 0.35, y, h + 0.6)]) for y in (-half, half))
        body.add_all("zinc", lattice(near, far, 12, 0.09, 0.055))

    def _bay(self, body: Body, x: float, y: float) -> None:
        """Breaker and isolator of one phase."""
        self._post(body, x + 3.4, y, 2.4, 1.7)
        self._post(body, x + 5.0, y, 2.4, 1.7)
        body.add("zinc", rod((x + 3.3, y, 4.1), (x + 5.1, y, 4.1), 0.05, 10))
        if self.breakers == "tank":
            body.add("paint", vessel((x - 1.1, y, 1.7), (x + 1.1, y, 1.7), 0.42, 24))
            for e in (-0.8, 0.8):
                body.add("concrete", footing(x + e, y, 0.25, 1.4))
                body.add("ceramic", _bushing(x + e, y, 2.0, 1.9))
        else:
            body.add("paint", bar((x, y, 0.9), (x, y, 2.2), 0.5))
            body.add("concrete", footing(x, y, 0.4, 1.0))
            body.add("ceramic", _bushing(x, y, 2.1, 2.2))
        body.add("cable", rod((x + 0.8 if self.breakers == "tank" else x, y, 3.85), (x + 3.4, y, 4.1), 0.025, 8))

    def _post(self, body: Body, x: float, y: float, stand: float, length: float) -> None:
        """A support insulator on a stand."""
        body.add("zinc", bar((x, y, 0.15), (x, y, stand + 0.02), 0.18))
        body.add("concrete", footing(x, y, 0.35, 0.25))
        body.add("ceramic", _bushing(x, y, stand, length))

    def _busbars(self, body: Body, x0: float, x1: float) -> None:
        for p in PHASES:
            y = -self.span_m / 2 - 3.4 + 1.2 * p
            body.add("zinc", rod((x0, y, self.busbar_m), (x1, y, self.busbar_m), 0.06, 12))
            for x in np.linspace(x0 + 0.5, x1 - 0.5, 2 * self.bays + 1):
                self._post(body, float(x), y, self.busbar_m - 1.7, 1.72)

    def _transformer(self, body: Body, x: float) -> None:
        body.blocks.add("concrete", (x - 3.2, -3.0, 0.0), (x + 3.2, 3.0, 0.35))
        body.blocks.add("paint", (x - 1.7, -1.4, 0.35), (x + 1.7, 1.4, 3.3))
        body.blocks.add("paint", (x - 1.85, -1.55, 3.1), (x + 1.85, 1.55, 3.25))
        for s in (-1.0, 1.0):
            for k in range(14):
                at = x - 1.5 + 0.23 * k
                body.blocks.add("paint", (at, s * 1.4, 0.7), (at + 0.05, s * 2.3, 2.9))
        for p in PHASES:
            body.add("ceramic", _bushing(x - 0.6, p * 1.0, 3.2, 2.0))
        body.add("paint", vessel((x + 1.1, -1.2, 4.1), (x + 1.1, 1.2, 4.1), 0.4),
                 rod((x + 1.1, 0.0, 3.2), (x + 1.1, 0.0, 3.8), 0.1))


def _bushing(x: float, y: float, z: float, length: float) -> Solid:
    """A ribbed insulator that stands on z."""
    profile = [(0.1, -0.02), (0.1, 0.1)]
    for rib in np.arange(0.15, length - 0.15, 0.13):
        profile += [(0.16, float(rib)), (0.09, float(rib) + 0.06)]
    return drum([*profile, (0.05, length - 0.05), (0.05, length)], (x, y, z), 14)
