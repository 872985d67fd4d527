"""True clearance of straight flight, to a millimetre."""

from __future__ import annotations

import numpy as np

from missions.frames import Array
from sim_bridge.truth import BEFORE_FLIGHT_NS, Mask, Truth

RESOLUTION_M = 1e-3


def distances(truth: Truth, points_enu_m: Array) -> Array:
    """(n,) distance of points (n, 3) to the nearest surface of the scene."""
    return truth.distance(points_enu_m, np.full(len(points_enu_m), BEFORE_FLIGHT_NS))


def segments_clear(truth: Truth, starts_enu_m: Array, ends_enu_m: Array, radius_m: float) -> Mask:
    """(n,) whether all of each segment (n, 3) keeps radius_m from every surface.

    The distance to a surface changes by no more than one moves, so that the distance at the middle of a piece decides
    for all of it unless it is near radius_m; such pieces are halved.
    """
    clear = np.ones(len(starts_enu_m), dtype=np.bool_)
    start, end, owner = np.asarray(starts_enu_m), np.asarray(ends_enu_m), np.arange(len(clear))
    while len(owner):
        middle, half = 0.5 * (start + end), 0.5 * np.linalg.norm(end - start, axis=1)
        room = distances(truth, middle) - radius_m
        clear[owner[room < 0.0]] = False
        split = clear[owner] & (room < half) & (half > RESOLUTION_M)
        owner = np.repeat(owner[split], 2)
        middle = middle[split]
        start, end = (np.stack(pair, axis=1).reshape(-1, 3) for pair in ((start[split], middle), (middle, end[split])))
    return clear
