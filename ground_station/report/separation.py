"""How near to each other the vehicles came, moment by moment, from their recorded tracks."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ground_station.report.activity import airborne
from ground_station.report.run_data import Track
from missions.frames import Array


@dataclass(frozen=True)
class Nearest:
    """At times t_s (n,): the least distance (n,) between two vehicles of which one flies, and the two's ids (n, 2)."""

    t_s: Array
    distance_m: Array
    pair: NDArray[np.int64]


def nearest_pairs(tracks: list[Track], rate_hz: int = 10) -> Nearest:
    """Over the moments of the 10 Hz grid at which at least two vehicles are known and one of them flies."""
    kept = [t for t in tracks if len(t.t_s)]
    size = max((round(float(t.t_s[-1]) * rate_hz) + 1 for t in kept), default=0)
    least, pair = np.full(size, np.inf), np.zeros((size, 2), dtype=np.int64)
    for a, b in combinations(kept, 2):
        at_a, at_b = (np.rint(t.t_s * rate_hz).astype(np.int64) for t in (a, b))
        both, i, j = np.intersect1d(at_a, at_b, assume_unique=True, return_indices=True)
        gap = np.linalg.norm(a.position_enu_m[i] - b.position_enu_m[j], axis=1)
        gap[~(airborne(a)[i] | airborne(b)[j])] = np.inf
        nearer = gap < least[both]
        least[both[nearer]], pair[both[nearer]] = gap[nearer], (a.vehicle_id, b.vehicle_id)
    known = np.flatnonzero(np.isfinite(least))
    return Nearest(known / rate_hz, least[known], pair[known])
