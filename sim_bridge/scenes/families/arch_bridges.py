"""Arch bridges: the deck on an arch, or hung from one."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.decks import SIDES, Deck, abutment, edges, lay_deck, parapets, plate_girders
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.shapes import bar, frustum, ribbon, rod

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ArchBridge(Family):
    """The road on top of the arches: concrete ribs with columns, or a row of masonry arches with filled spandrels."""

    kind: str = one_of("ribs", "masonry")
    length_m: float = between(46.0, 64.0)
    width_m: float = between(6.0, 9.5)
    soffit_m: float = between(9.0, 14.0)
    arches: int = whole(3, 5)
    """Of a masonry bridge; ribs cross in one span."""
    columns: int = whole(8, 12)
    """Over each rib."""
    rise: float = between(0.6, 0.85)
    """Of the arches, as a share of what is possible."""
    edge: str = one_of("railing", "parapet")

    def build(self, rng: np.random.Generator) -> Body:
        """The bridge along x."""
        body, deck = Body(), Deck(self.length_m, self.width_m, self.soffit_m)
        lay_deck(body, deck)
        if self.kind == "masonry":
            parapets(body, deck)
            self._masonry(body, deck)
        else:
            edges(body, deck, self.edge)
            self._ribs(body, deck)
        return body

    def _ribs(self, body: Body, deck: Deck) -> None:
        for side in SIDES:
            abutment(body, deck, side, 3.0, 0.0)
        half, low, crown = deck.length / 2 - 2.9, 1.2, deck.soffit - 0.9
        low = crown - self.rise * (crown - low)
        xs = np.linspace(-half, half, 61)
        middle = crown - (crown - low) * (xs / half) ** 2
        thick = 0.45 + 0.35 * (xs / half) ** 2
        lines = [np.stack([xs, middle + sign * thick], axis=1) for sign in (-1.0, 1.0)]
        ys = [s * (deck.width / 2 - 1.4) for s in SIDES]
        for y in ys:
            body.add("concrete", ribbon(lines[0], lines[1], y - 0.6, y + 0.6))
            body.add("concrete", ribbon([(-half - 1.0, deck.soffit - 0.6), (half + 1.0, deck.soffit - 0.6)],
                                        [(-half - 1.0, deck.soffit + 0.02), (half + 1.0, deck.soffit + 0.02)],
                                        y - 0.3, y + 0.3))
            for side in SIDES:
                x = side * (half + 0.1)
                body.blocks.add("stone", (x - 1.2, y - 1.2, 0.0), (x + 1.2, y + 1.2, max(0.6, low - 0.2)))
        for x in np.linspace(-half, half, self.columns + 2)[1:-1]:
            z = crown - (crown - low) * (x / half) ** 2
            for y in ys:
                if z < deck.soffit - 1.2:
                    body.add("concrete", frustum((x, y), (0.3, 0.45), (0.3, 0.45), z, deck.soffit - 0.5))
            body.add("concrete", frustum((x, 0.0), (0.25, abs(ys[0])), (0.25, abs(ys[0])), z - 0.3, z + 0.2))

    def _masonry(self, body: Body, deck: Deck) -> None:
        """One body with all its arches cut out, on piers with cutwaters, and a string course."""
        pitch = (deck.length - 4.0) / self.arches
        pier = 0.17 * pitch
        radius = (pitch - pier) / 2
        spring = deck.soffit - 0.8 - self.rise * min(radius, deck.soffit - 2.3)
        height = deck.soffit - 0.8 - spring
        line: list[tuple[float, float]] = [(-deck.length / 2, 0.5)]
        for k in range(self.arches):
            middle = (k - (self.arches - 1) / 2) * pitch
            t = np.linspace(np.pi, 0.0, 25)
            line += [(middle + radius * float(np.cos(a)), spring + height * float(np.sin(a))) for a in t]
        line.append((deck.length / 2, 0.5))
        lower = np.array(line)
        lower[0, 1] = lower[-1, 1] = spring
        upper = np.stack([lower[:, 0], np.full(len(lower), deck.soffit + 0.02)], axis=1)
        y = deck.width / 2 - 0.15
        body.add("stone", ribbon(lower, upper, -y, y))
        for k in range(self.arches + 1):
            x = (k - self.arches / 2) * pitch
            half, end = pier / 2, np.sign(x)
            inner, outer = x - half, x + half
            if k in (0, self.arches):
                inner, outer = sorted((end * deck.length / 2, x - end * half))
            body.blocks.add("stone", (inner, -y - 0.02, 0.0), (outer, y + 0.02, spring + 0.02))
            body.blocks.add("stone", (inner - 0.2, -y - 0.25, spring - 0.3), (outer + 0.2, y + 0.25, spring))
            if 0 < k < self.arches:
                for s in SIDES:
                    body.add("stone", frustum((x, s * y), (half, 1.0), (0.4 * half, 0.1), 0.0, 0.7 * spring))


@dataclass(frozen=True)
class TiedArchBridge(Family):
    """Two steel arches over the road, tied by the deck, with upright or crossing hangers."""

    length_m: float = between(46.0, 62.0)
    width_m: float = between(6.5, 9.5)
    soffit_m: float = between(5.5, 9.0)
    rise_m: float = between(8.0, 12.0)
    hangers: int = whole(9, 15)
    crossing: bool = one_of(True, False)
    lean: float = between(0.0, 0.3)
    """How far the arches lean towards each other, as a share of the half width."""
    bracing: str = one_of("struts", "crosses")
    rib_m: float = between(0.7, 1.1)

    def build(self, rng: np.random.Generator) -> Body:
        """The bridge along x."""
        body, deck = Body(), Deck(self.length_m, self.width_m, self.soffit_m)
        lay_deck(body, deck)
        edges(body, deck, "railing")
        plate_girders(body, deck, 2, 0.8, deck.length / 2 - 1.3)
        for side in SIDES:
            abutment(body, deck, side, 3.2, 0.8)
        t = np.linspace(-1.0, 1.0, 33)
        ribs = [self._rib(body, deck, t, s) for s in SIDES]
        for s, rib in zip(SIDES, ribs, strict=True):
            self._hang(body, deck, t, rib, s)
        step = 4
        for i in range(8, 25, step):
            body.add("paint", bar(ribs[0][i], ribs[1][i], 0.3, 0.35))
            if self.bracing == "crosses" and i + step < 25:
                body.add("paint", bar(ribs[0][i], ribs[1][i + step], 0.15), bar(ribs[1][i], ribs[0][i + step], 0.15))
        return body

    def _rib(self, body: Body, deck: Deck, t: Array, side: float) -> Array:
        """Build one arch; returns the points (n, 3) of its axis at t from -1 to 1."""
        rise = 1.0 - t * t
        y = side * (deck.width / 2 + 0.35) * (1.0 - self.lean * rise)
        axis = np.stack([t * (deck.length / 2 - 1.6), y, deck.soffit - 0.2 + self.rise_m * rise], axis=1)
        for a, b in pairwise(axis):
            reach = 0.08 * (b - a)
            body.add("paint", bar(a - reach, b + reach, 0.6, self.rib_m))
        x = deck.length / 2 - 1.0
        body.add("paint", bar((-x, axis[0, 1], deck.soffit - 0.25), (x, axis[0, 1], deck.soffit - 0.25), 0.5, 0.8))
        return axis

    def _hang(self, body: Body, deck: Deck, t: Array, rib: Array, side: float) -> None:
        for share in np.linspace(-0.82, 0.82, self.hangers):
            slants = (-0.12, 0.12) if self.crossing else (0.0,)
            foot = np.array([share * (deck.length / 2 - 1.6), side * (deck.width / 2 + 0.35), deck.soffit - 0.2])
            for slant in slants:
                at = float(np.clip(share + slant, -0.9, 0.9))
                head = np.array([np.interp(at, t, rib[:, k]) for k in range(3)])
                body.add("cable", rod(foot, head, 0.05, 8))
