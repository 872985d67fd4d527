"""Bridges that hang on cables: cable-stayed and suspension."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.decks import SIDES, Deck, abutment, edges, lay_deck, plate_girders, railings
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.shapes import bar, frustum, loft, rectangle_ring, rod
from sim_bridge.scenes.solids import Solid, tube

Array = NDArray[np.float64]
Point = tuple[float, float, float]


@dataclass(frozen=True)
class CableStayedBridge(Family):
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


@dataclass(frozen=True)
class SuspensionBridge(Family):
    """Parabolic cables over two towers, with hangers to the deck and anchor blocks at the ends."""

    length_m: float = between(54.0, 68.0)
    width_m: float = between(5.0, 8.5)
    soffit_m: float = between(6.0, 9.5)
    main_span: float = between(0.5, 0.62)
    """Share of the length between the towers."""
    tower_m: float = between(8.0, 13.0)
    """Height of the towers above the deck."""
    tower: str = one_of("masonry", "concrete", "steel")
    hanger_m: float = between(1.6, 2.6)
    girder_m: float = between(0.7, 1.3)

    def build(self, rng: np.random.Generator) -> Body:
        """The bridge along x."""
        body, deck = Body(), Deck(self.length_m, self.width_m, self.soffit_m)
        lay_deck(body, deck)
        railings(body, deck)
        plate_girders(body, deck, 2, self.girder_m, deck.length / 2 - 1.3)
        for side in SIDES:
            abutment(body, deck, side, 3.2, self.girder_m)
            self._tower(body, deck, side * self._tower_x())
            for s in SIDES:
                x, y = side * (deck.length / 2 - 0.7), s * self._cable_y()
                body.blocks.add("stone", (x - 0.7, y - 0.6, 0.0), (x + 0.7, y + 0.6, deck.kerb_top + 0.5))
        self._cables(body, deck)
        return body

    def _tower_x(self) -> float:
        return self.main_span * self.length_m / 2

    def _cable_y(self) -> float:
        return self.width_m / 2 + 0.55

    def _height(self, deck: Deck, x: Array) -> Array:
        """Height of the cables over x."""
        reach, tower, end = np.abs(x), self._tower_x(), deck.length / 2 - 0.7
        low, top, anchor = deck.kerb_top + 1.3, deck.road + self.tower_m, deck.kerb_top + 0.4
        t = (reach - tower) / (end - tower)
        side = top + (anchor - top) * t - 1.6 * t * (1.0 - t)
        return np.asarray(np.where(reach <= tower, low + (top - low) * (reach / tower) ** 2, side))

    def _cables(self, body: Body, deck: Deck) -> None:
        end, tower = deck.length / 2 - 0.7, self._tower_x()
        for s in SIDES:
            y = s * self._cable_y()
            for x0, x1 in ((-end, -tower), (-tower, tower), (tower, end)):
                xs = np.linspace(x0, x1, 41)
                path = np.stack([xs, np.full_like(xs, y), self._height(deck, xs)], axis=1)
                body.add("cable", tube(path, 0.13, 12, capped=True))
            for x in np.arange(-end + 2.5, end - 2.4, self.hanger_m):
                if abs(abs(x) - tower) > 1.0:
                    z = float(self._height(deck, np.array(x)))
                    body.add("cable", rod((x, y, deck.soffit - 0.1), (x, y, z), 0.035, 6))
                    body.add("paint", bar((x, s * (deck.width / 2 - 0.3), deck.soffit - 0.22),
                                          (x, s * (self._cable_y() + 0.15), deck.soffit - 0.22), 0.2, 0.26))

    def _tower(self, body: Body, deck: Deck, x: float) -> None:
        top, y = deck.road + self.tower_m, self._cable_y()
        body.blocks.add("stone", (x - 1.6, -y - 1.3, 0.0), (x + 1.6, y + 1.3, 1.2))
        beams = [deck.soffit - self.girder_m - 0.5, top - 1.2, deck.road + 0.55 * self.tower_m]
        if self.tower == "steel":
            feet, heads = ([(x + e * h, s * y, z) for s in SIDES for e in SIDES] for h, z in ((1.1, 1.1), (0.5, top)))
            for foot, head in zip(feet, heads, strict=True):
                body.add("paint", bar(foot, head, 0.4))
            for i in (0, 2):
                body.add_all("paint", _laced((feet[i], heads[i]), (feet[i + 1], heads[i + 1]), 5))
            for i in (0, 1):
                body.add_all("paint", _laced((feet[i], heads[i]), (feet[i + 2], heads[i + 2]), 1, 0.0, 0.32))
        material = {"masonry": "stone", "concrete": "concrete", "steel": "paint"}[self.tower]
        for s in SIDES if self.tower != "steel" else ():
            body.add(material, frustum((x, s * y), (1.1, 0.8), (0.75, 0.55), 1.1, top + 0.2))
            body.add(material, frustum((x, s * y), (1.0, 0.8), (1.0, 0.8), top - 0.1, top + 0.5))
        for z in beams:
            body.add(material, frustum((x, 0.0), (0.5, y + 0.1), (0.5, y + 0.1), z - 0.5, z + 0.5))


def _laced(left: tuple[Point, Point], right: tuple[Point, Point], panels: int, low: float = 0.0,
           high: float = 1.0) -> Iterator[Solid]:
    """Struts and crossed diagonals between two legs, given by their ends, from one share of their height to another."""
    steps = np.linspace(low, high, panels + 1)
    a, b = (np.outer(1.0 - steps, leg[0]) + np.outer(steps, leg[1]) for leg in (left, right))
    for k in range(panels):
        yield bar(a[k], b[k + 1], 0.12)
        yield bar(b[k], a[k + 1], 0.12)
        yield bar(a[k + 1], b[k + 1], 0.2)
