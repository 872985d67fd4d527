"""What bridges have in common: the deck with its road and railings, girders, piers and abutments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.shapes import drum, frustum, rod
from sim_bridge.scenes.solids import box

SIDES = (-1.0, 1.0)
SLAB_M, ASPHALT_M, KERB_M = 0.35, 0.06, 0.18


@dataclass(frozen=True)
class Deck:
    """A straight, level deck along x, centred: its length and width, and the height of its soffit."""

    length: float
    width: float
    soffit: float

    @property
    def road(self) -> float:
        """Height of the road's surface."""
        return self.soffit + SLAB_M + ASPHALT_M

    @property
    def kerb_top(self) -> float:
        """Height of the walkways beside the road."""
        return self.road + KERB_M


def lay_deck(body: Body, deck: Deck, walkway: float = 0.9) -> None:
    """The slab with edge beams, the road's surface and the kerbs."""
    x, y, z = deck.length / 2, deck.width / 2, deck.soffit
    body.blocks.add("concrete", (-x, -y, z), (x, y, z + SLAB_M))
    body.blocks.add("asphalt", (-x, -y + walkway, z + SLAB_M), (x, y - walkway, deck.road))
    for s in SIDES:
        body.blocks.add("concrete", (-x, s * y, z + SLAB_M), (x, s * (y - walkway), deck.kerb_top))
        body.blocks.add("concrete", (-x, s * y, z - 0.12), (x, s * (y - 0.3), z))


def railings(body: Body, deck: Deck, material: str = "trim", inset: float = 0.15) -> None:
    """Posts with three rails along both edges."""
    x = deck.length / 2
    for s in SIDES:
        y, foot = s * (deck.width / 2 - inset), deck.kerb_top
        for post in np.linspace(-x + 0.15, x - 0.15, max(2, round(deck.length / 1.6))):
            body.add(material, box((post - 0.035, y - 0.035, foot - 0.02), (post + 0.035, y + 0.035, foot + 1.05)))
        for height, radius in ((0.35, 0.02), (0.7, 0.02), (1.05, 0.04)):
            body.add(material, rod((-x, y, foot + height), (x, y, foot + height), radius, 6))


def parapets(body: Body, deck: Deck) -> None:
    """Solid walls along both edges."""
    x, y = deck.length / 2, deck.width / 2
    for s in SIDES:
        body.blocks.add("concrete", (-x, s * y, deck.kerb_top), (x, s * (y - 0.22), deck.kerb_top + 0.95))


def edges(body: Body, deck: Deck, kind: str) -> None:
    """Railings or parapets."""
    if kind == "parapet":
        parapets(body, deck)
    else:
        railings(body, deck)


def plate_girders(body: Body, deck: Deck, count: int, depth: float, ends: float) -> None:
    """Welded I-girders under the slab with stiffeners, side by side, from -ends to ends; cross frames between them."""
    reach = deck.width / 2 - 1.1
    top = deck.soffit
    lines = np.linspace(-reach, reach, count)
    for y in lines:
        body.blocks.add("paint", (-ends, y - 0.22, top - depth), (ends, y + 0.22, top - depth + 0.05))
        body.blocks.add("paint", (-ends, y - 0.015, top - depth + 0.05), (ends, y + 0.015, top))
        for x in np.arange(-ends + 0.5, ends, 2.0):
            body.blocks.add("paint", (x - 0.01, y - 0.18, top - depth + 0.05), (x + 0.01, y + 0.18, top))
    for x in np.arange(-ends + 2.5, ends - 2.0, 6.0):
        body.blocks.add("paint", (x - 0.1, lines[0], top - 0.75 * depth), (x + 0.1, lines[-1], top - 0.45 * depth))


def abutment(body: Body, deck: Deck, side: float, depth: float, girder_m: float) -> None:
    """The bank's wall under one end of the deck, depth m long: up to the girders' seat, behind them up to the deck."""
    end, y = side * deck.length / 2, deck.width / 2
    front = side * (deck.length / 2 - depth)
    seat = deck.soffit - girder_m
    body.blocks.add("stone", (end, -y - 0.4, 0.0), (front, y + 0.4, seat))
    back = side * (deck.length / 2 - 0.4 * depth)
    body.blocks.add("stone", (end, -y - 0.4, 0.0), (back, y + 0.4, deck.soffit))


def pier(body: Body, x: float, deck: Deck, top: float, kind: str) -> None:
    """A pier up to a height: a wall, two columns under a cross-head, or a hammerhead."""
    y = deck.width / 2
    body.blocks.add("concrete", (x - 1.3, -y * 0.8, 0.0), (x + 1.3, y * 0.8, 0.5))
    if kind == "wall":
        body.add("concrete", frustum((x, 0.0), (0.75, y * 0.72), (0.5, y * 0.72), 0.45, top))
        return
    body.blocks.add("concrete", (x - 0.75, -y + 0.5, top - 0.9), (x + 0.75, y - 0.5, top))
    if kind == "columns":
        for s in SIDES:
            body.add("concrete", drum([(0.55, 0.45), (0.55, top - 0.85)], (x, s * y * 0.55, 0.0), 28))
    else:
        body.add("concrete", frustum((x, 0.0), (0.7, 1.3), (0.6, 1.0), 0.45, top - 2.2),
                 frustum((x, 0.0), (0.6, 1.0), (0.7, y * 0.82), top - 2.25, top - 0.85))
