"""The colours of the live page. Vehicles differ in hue; coverage goes from warm, seen once, to green, seen often."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array

Rgb = tuple[int, int, int]
VEHICLES: tuple[Rgb, ...] = ((66, 165, 245), (255, 167, 38), (171, 110, 240), (38, 198, 178), (240, 98, 146),
                             (212, 225, 87), (141, 155, 175), (255, 112, 67))
COVERAGE: tuple[Rgb, ...] = ((122, 128, 140), (205, 72, 62), (233, 130, 58), (242, 190, 72), (160, 196, 92),
                             (78, 172, 110), (34, 139, 116))
"""By the number of pictures that show a place: fewer than the first of `PICTURES`, at least that, ..."""
PICTURES = {"pictures": (1, 2, 4, 8, 16, 32), "survey pictures": (1, 2, 3, 4, 5, 6)}
"""From so many pictures on a place gets the next colour. Exploration takes many from nearly one place."""
IMPORTANT, FORBIDDEN, FENCE, BOX = (255, 193, 7), (239, 68, 68), (88, 110, 140), (120, 140, 165)


def of_vehicle(vehicle_id: int) -> Rgb:
    """The colour of a vehicle, of its trail and of its tour."""
    return VEHICLES[(vehicle_id - 1) % len(VEHICLES)]


def by_pictures(count: NDArray[np.int64], which: str) -> NDArray[np.uint8]:
    """(n, 3) colours of places that so many pictures show. which: a key of PICTURES."""
    return np.array(COVERAGE, dtype=np.uint8)[np.searchsorted(PICTURES[which], count, side="right")]


def by_height(height_m: Array) -> NDArray[np.uint8]:
    """(n, 3) colours from the lowest, blue, to the highest, sand."""
    low, high = np.array((58, 92, 140)), np.array((238, 214, 160))
    span = float(np.ptp(height_m)) if len(height_m) else 0.0
    share = (height_m - height_m.min()) / span if span else np.zeros(len(height_m))
    return np.asarray(low + share[:, None] * (high - low)).astype(np.uint8)


def css(colour: Rgb) -> str:
    """As a browser reads it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
