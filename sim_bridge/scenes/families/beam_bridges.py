"""Bridges whose deck carries itself: girders on piers, and trusses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.decks import Deck, abutment, edges, lay_deck, pier, plate_girders
from sim_bridge.scenes.families.draw import Drawn, between, one_of, whole


@dataclass(frozen=True)
class GirderBridge(Drawn):
    """Steel plate girders under a concrete deck, on concrete piers."""

    spans: int = whole(2, 4)
    length_m: float = between(42.0, 64.0)
    width_m: float = between(6.5, 11.0)
    soffit_m: float = between(6.5, 11.0)
    girders: int = whole(2, 4)
    girder_m: float = between(1.0, 1.9)
    pier: str = one_of("wall", "columns", "hammerhead")
    edge: str = one_of("railing", "parapet")

    def build(self, rng: np.random.Generator) -> Body:
        """The bridge along x."""
        body, deck = Body(), Deck(self.length_m, self.width_m, self.soffit_m)
        lay_deck(body, deck)
        edges(body, deck, self.edge)
        for side in (-1.0, 1.0):
            abutment(body, deck, side, 3.0, self.girder_m)
        for x in np.linspace(-deck.length / 2 + 2.0, deck.length / 2 - 2.0, self.spans + 1)[1:-1]:
            pier(body, float(x), deck, deck.soffit - self.girder_m, self.pier)
        plate_girders(body, deck, self.girders, self.girder_m, deck.length / 2 - 1.3)
        return body
