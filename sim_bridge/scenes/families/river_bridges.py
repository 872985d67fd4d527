"""A bridge over water: haunched girders on piers that stand in a river."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.decks import SIDES, Deck, abutment, edges, lay_deck
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.shapes import drum, frustum, ribbon
from sim_bridge.scenes.river import BED_M, river
from sim_bridge.scenes.scene import Part
from sim_bridge.scenes.solids import box

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RiverBridge(Family):
    """Steel girders, deeper over the piers, between two banks."""

    spans: int = whole(3, 4)
    length_m: float = between(46.0, 62.0)
    width_m: float = between(6.0, 9.0)
    soffit_m: float = between(6.0, 9.0)
    girder_m: float = between(0.8, 1.2)
    """Depth of the girders in the middle of a span ..."""
    haunch_m: float = between(0.5, 1.4)
    """... and how much more over a pier."""
    girders: int = whole(2, 3)
    pier: str = one_of("cutwater", "columns")
    edge: str = one_of("railing", "parapet")
    draught_m: float = between(0.5, 1.1)
    """How far the water stands below the banks."""

    def build(self, rng: np.random.Generator) -> Body:
        """The bridge along x."""
        body, deck = Body(), Deck(self.length_m, self.width_m, self.soffit_m)
        lay_deck(body, deck)
        edges(body, deck, self.edge)
        for side in SIDES:
            abutment(body, deck, side, 3.0, self.girder_m)
        xs = np.linspace(-deck.length / 2 + 1.4, deck.length / 2 - 1.4, 97)
        apart = np.abs(xs[:, None] - self._piers()).min(axis=1)
        reach = 0.3 * self._span()
        depth = self.girder_m + self.haunch_m * np.clip(1.0 - apart / reach, 0.0, 1.0) ** 2
        line = [np.stack([xs, deck.soffit - d], axis=1) for d in (depth, np.full_like(xs, -0.02))]
        for y in np.linspace(-deck.width / 2 + 1.2, deck.width / 2 - 1.2, self.girders):
            body.add("paint", ribbon(line[0], line[1], float(y) - 0.2, float(y) + 0.2))
        for x in self._piers():
            self._pier(body, float(x), deck)
        return body

    def surroundings(self, rng: np.random.Generator, lo: Array, hi: Array) -> list[Part]:
        """The river with the piers' footings."""
        y = self.width_m / 2
        footings = [box((x - 1.5, -y - 0.6, BED_M), (x + 1.5, y + 0.6, 0.0)) for x in self._piers()]
        return river(rng, lo, hi, self.length_m / 2 - 4.0, -self.draught_m, footings)

    def _span(self) -> float:
        return (self.length_m - 6.0) / self.spans

    def _piers(self) -> Array:
        return np.asarray((np.arange(1, self.spans) - self.spans / 2) * self._span(), np.float64)

    def _pier(self, body: Body, x: float, deck: Deck) -> None:
        y, top = deck.width / 2, deck.soffit - self.girder_m - self.haunch_m
        body.blocks.add("concrete", (x - 0.7, -y + 0.4, top - 0.8), (x + 0.7, y - 0.4, top + 0.02))
        if self.pier == "columns":
            for s in SIDES:
                body.add("concrete", drum([(0.6, 0.0), (0.5, top - 0.75)], (x, s * y * 0.55, 0.0), 28))
            return
        body.add("stone", frustum((x, 0.0), (0.7, y * 0.75), (0.55, y * 0.7), 0.0, top - 0.75))
        for s in SIDES:
            body.add("stone", frustum((x, s * y * 0.75), (0.65, 0.9), (0.3, 0.12), 0.0, 0.5 * top))
