"""Bridges whose deck carries itself: girders on piers or trestles, and trusses."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.decks import SIDES, Deck, abutment, edges, lay_deck, pier, plate_girders, railings
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.shapes import bar, raised

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GirderBridge(Family):
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


@dataclass(frozen=True)
class TrussBridge(Family):
    """Two steel trusses with the road between them, braced overhead, in one or two spans."""

    spans: int = whole(1, 2)
    span_m: float = between(28.0, 34.0)
    """Of each span where there are two; a single one is 1.5 times as long."""
    width_m: float = between(5.5, 8.0)
    soffit_m: float = between(5.5, 9.0)
    height_m: float = between(5.5, 7.5)
    """Of the trusses, between the middles of the chords."""
    pattern: str = one_of("warren", "pratt", "howe", "cross")
    chord: str = one_of("flat", "bowed")
    panel_m: float = between(3.2, 4.5)

    def build(self, rng: np.random.Generator) -> Body:
        """The bridge along x."""
        body = Body()
        span = self.span_m * (1.5 if self.spans == 1 else 1.0)
        deck = Deck(self.spans * span + 5.0, self.width_m, self.soffit_m)
        lay_deck(body, deck, walkway=0.6)
        railings(body, deck)
        for side in SIDES:
            abutment(body, deck, side, 4.0, 0.9)
        if self.spans == 2:
            pier(body, 0.0, Deck(deck.length, self.width_m + 1.6, deck.soffit), deck.soffit - 0.9, "wall")
        for k in range(self.spans):
            self._span(body, deck, (k - (self.spans - 1) / 2) * span, span - 0.3)
        return body

    def _span(self, body: Body, deck: Deck, middle: float, length: float) -> None:
        panels = 2 * round(length / self.panel_m / 2)
        xs = middle + np.linspace(-length / 2, length / 2, panels + 1)
        low = np.full(panels + 1, deck.soffit - 0.35)
        bow = 1.0 - 0.45 * (2.0 * (xs - middle) / length) ** 2 if self.chord == "bowed" else np.ones(panels + 1)
        high = low + self.height_m * bow
        for s in SIDES:
            y = s * (deck.width / 2 + 0.35)
            bottom, top = (np.stack([xs, np.full_like(xs, y), z], axis=1) for z in (low, high))
            self._plane(body, bottom, top)
        for x in xs:
            y = deck.width / 2 + 0.35
            body.add("paint", bar((x, -y, deck.soffit - 0.45), (x, y, deck.soffit - 0.45), 0.3, 0.6))
        y = deck.width / 2 + 0.35
        for i in range(1, panels):
            body.add("paint", bar((xs[i], -y, high[i]), (xs[i], y, high[i]), 0.2, 0.3))
            if i + 1 < panels:
                body.add("paint", bar((xs[i], -y, high[i]), (xs[i + 1], y, high[i + 1]), 0.12),
                         bar((xs[i], y, high[i]), (xs[i + 1], -y, high[i + 1]), 0.12))
        for i in (1, panels - 1):
            body.add("paint", bar((xs[i], -y, high[i] - 0.8), (xs[i], y, high[i] - 0.8), 0.15, 0.25))

    def _plane(self, body: Body, bottom: Array, top: Array) -> None:
        """Chords, posts and diagonals of one truss through its panel points (n, 3)."""
        n = len(bottom) - 1
        body.add("paint", bar(bottom[0], bottom[n], 0.32, 0.42))
        if self.chord == "flat":
            body.add("paint", bar(top[1], top[n - 1], 0.32, 0.36))
        else:
            body.add_all("paint", (bar(a, b, 0.32, 0.36) for a, b in pairwise(top[1:-1])))
        body.add("paint", bar(bottom[0], top[1], 0.32, 0.36), bar(bottom[n], top[n - 1], 0.32, 0.36))
        across = (0.0, 1.0, 0.0)
        for i in range(1, n):
            if self.pattern != "warren" or i % 2:
                body.add("paint", bar(bottom[i], top[i], 0.22, 0.26, across))
        for i in range(1, n - 1):
            inward = i < n / 2
            falling = {"warren": i % 2 == 1, "pratt": inward, "howe": not inward, "cross": True}[self.pattern]
            if falling:
                body.add("paint", bar(top[i], bottom[i + 1], 0.2, 0.24, across))
            if not falling or self.pattern == "cross":
                body.add("paint", bar(bottom[i], top[i + 1], 0.2, 0.24, across))


@dataclass(frozen=True)
class TrestleViaduct(Family):
    """A railway on plate girders over tapering steel bents."""

    length_m: float = between(46.0, 62.0)
    soffit_m: float = between(12.0, 18.0)
    bents: int = whole(3, 5)
    width_m: float = between(4.2, 5.4)
    batter: float = between(0.1, 0.2)
    """How far a leg leans outwards per metre."""
    tiers: int = whole(2, 4)
    towers: bool = one_of(True, False)
    """Whether each bent is a tower of two frames."""
    girder_m: float = between(1.1, 1.7)

    def build(self, rng: np.random.Generator) -> Body:
        """The viaduct along x."""
        body, deck = Body(), Deck(self.length_m, self.width_m, self.soffit_m)
        lay_deck(body, deck, walkway=0.5)
        railings(body, deck)
        plate_girders(body, deck, 2, self.girder_m, deck.length / 2 - 1.3)
        for side in SIDES:
            abutment(body, deck, side, 3.5, self.girder_m)
            body.blocks.add("zinc", (-deck.length / 2, side * 0.75, deck.road),
                            (deck.length / 2, side * 0.83, deck.road + 0.16))
        for x in np.arange(-deck.length / 2 + 0.3, deck.length / 2, 0.9):
            body.blocks.add("timber", (x, -1.25, deck.road), (x + 0.24, 1.25, deck.road + 0.08))
        for x in np.linspace(-deck.length / 2 + 2.0, deck.length / 2 - 2.0, self.bents + 2)[1:-1]:
            self._bent(body, deck, float(x))
        return body

    def _bent(self, body: Body, deck: Deck, x: float) -> None:
        top = deck.soffit - self.girder_m
        zs = np.linspace(0.5, top, self.tiers + 1)
        ys = deck.width / 2 - 1.1 + self.batter * (top - zs)
        offsets = (-1.3, 1.3) if self.towers else (0.0,)
        for dx in offsets:
            legs = [np.stack([np.full_like(zs, x + dx), s * ys, zs], axis=1) for s in SIDES]
            for s, leg in zip(SIDES, legs, strict=True):
                body.add("paint", bar(leg[0], raised(leg[-1], 0.02), 0.34, 0.34, (1.0, 0.0, 0.0)))
                body.blocks.add("stone", (x + dx - 0.7, s * ys[0] - 0.7, 0.0), (x + dx + 0.7, s * ys[0] + 0.7, 0.7))
            self._bracing(body, *legs)
            body.add("paint", bar((x + dx, -ys[-1] - 0.4, top - 0.25), (x + dx, ys[-1] + 0.4, top - 0.25), 0.35, 0.5))
        for s in SIDES if self.towers else ():
            near, far = (np.stack([np.full_like(zs, x + dx), s * ys, zs], axis=1) for dx in offsets)
            self._bracing(body, near, far)

    def _bracing(self, body: Body, left: Array, right: Array) -> None:
        """Struts and crossed diagonals between two legs (n, 3)."""
        for k in range(self.tiers):
            body.add("paint", bar(left[k + 1], right[k + 1], 0.16, 0.2), bar(left[k], right[k + 1], 0.13),
                     bar(right[k], left[k + 1], 0.13))
