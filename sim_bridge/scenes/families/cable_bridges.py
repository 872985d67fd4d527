"""Bridges that hang on cables: cable-stayed and suspension."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.decks import SIDES, Deck, abutment, edges, lay_deck, plate_girders
from sim_bridge.scenes.families.draw import Drawn, between, one_of, whole
from sim_bridge.scenes.families.shapes import bar, frustum, loft, rectangle_ring, rod


@dataclass(frozen=True)
class CableStayedBridge(Drawn):
    """Straight stays from one or two pylons to the deck's edges."""

    length_m: float = between(52.0, 68.0)
    width_m: float = between(6.5, 9.5)
    soffit_m: float = between(6.0, 9.0)
    pylons: int = whole(1, 2)
    pylon: str = one_of("portal", "A", "diamond")
    pylon_m: float = between(15.0, 21.0)
    """Height of the pylon above the deck."""
    stays: int = whole(4, 7)
    """On each side of a pylon, in each plane."""
    layout: str = one_of("fan", "harp")
    edge: str = one_of("railing", "parapet")

    def build(self, rng: np.random.Generator) -> Body:
        """The bridge along x."""
        body, deck = Body(), Deck(self.length_m, self.width_m, self.soffit_m)
        lay_deck(body, deck)
        edges(body, deck, self.edge)
        plate_girders(body, deck, 2, 0.9, deck.length / 2 - 1.3)
        for side in SIDES:
            abutment(body, deck, side, 3.0, 0.9)
        pylons = [0.08 * self.length_m] if self.pylons == 1 else [-0.25 * self.length_m, 0.25 * self.length_m]
        for x in pylons:
            self._pylon(body, deck, x)
            reach = (0.47 * self.length_m - abs(x), 0.5 * self.length_m if self.pylons == 1 else abs(x))
            for side in SIDES:
                outward = self.pylons == 1 or side * x > 0
                self._stays(body, deck, x, side, (0.47 * self.length_m - side * x) if outward else 0.94 * reach[1])
        return body

    def _top(self, deck: Deck) -> float:
        return deck.road + self.pylon_m

    def _half_gap(self, deck: Deck, z: float) -> float:
        """Distance of a pylon's legs from the middle at a height."""
        wide = deck.width / 2 + 0.75
        t = (z - deck.soffit) / (self._top(deck) - deck.soffit)
        if self.pylon == "portal":
            return wide
        if t < 0.0:
            return wide * (1.0 + 0.5 * t) if self.pylon == "diamond" else wide * (1.0 - 0.25 * t)
        return wide * (1.0 - t) + 0.45 * t

    def _pylon(self, body: Body, deck: Deck, x: float) -> None:
        top = self._top(deck)
        heights = [0.8, deck.soffit, top]
        for s in SIDES:
            rings = [rectangle_ring((x, s * self._half_gap(deck, z)), (1.0 - 0.35 * z / top, 0.55), z)
                     for z in heights]
            body.add("concrete", loft(rings))
            body.blocks.add("concrete", (x - 1.8, s * self._half_gap(deck, 0.0) - 1.5, 0.0),
                            (x + 1.8, s * self._half_gap(deck, 0.0) + 1.5, 0.9))
        for z in [deck.soffit - 1.5] + ([top - 1.6, deck.road + 6.5] if self.pylon == "portal" else [top - 1.2]):
            y = self._half_gap(deck, z) + 0.2
            body.add("concrete", frustum((x, 0.0), (0.55, y), (0.55, y), z - 0.55, z + 0.55))

    def _stays(self, body: Body, deck: Deck, x: float, side: float, reach: float) -> None:
        """The stays of a pylon to one side in both planes, with their anchor boxes."""
        top = self._top(deck)
        for i, out in enumerate(np.linspace(reach, 0.28 * reach, self.stays)):
            down = 1.2 + 0.55 * i if self.layout == "fan" else 1.2 + 0.72 * self.pylon_m * i / self.stays
            for s in SIDES:
                y = s * (deck.width / 2 - 0.35)
                foot = np.array([x + side * out, y, deck.kerb_top])
                head = np.array([x + side * 0.1, s * self._half_gap(deck, top - down), top - down])
                toward = (head - foot) / np.linalg.norm(head - foot)
                body.add("cable", rod(foot - 0.3 * toward, head, 0.07, 8))
                body.add("trim", bar(foot - 0.1 * toward, foot + 0.9 * toward, 0.26))
