"""Which photographs may show the same, before anything is known of how they were taken.

The few features of each picture that describe the largest patches are matched with those of all others (preemptive
matching, Wu 2013, "Towards linear-time incremental structure from motion"): that takes a thousandth of the time.
Positions, where photographs have them, and the order in which they were taken add pairs of their own.
"""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from missions.frames import Array
from perception.reconstruct.features import Features
from perception.reconstruct.matching import nearest_anywhere

PREVIEW = 250
LEAST_ALIKE = 4
PARTNERS_ALIKE, PARTNERS_NEAR, PARTNERS_NEXT = 24, 10, 3
FEW = 20
"""Up to so many pictures, all pairs are tried."""


def candidate_pairs(seen: list[Features], position_enu_m: Array, pool: Executor) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, in order. seen and positions (n, 3), NaN where unknown, in the order of taking."""
    n = len(seen)
    if n <= FEW:
        return [(i, j) for i in range(n) for j in range(i + 1, n)]
    pairs = {(i, j) for i in range(n) for j in range(i + 1, min(i + 1 + PARTNERS_NEXT, n))}
    known = np.flatnonzero(np.all(np.isfinite(position_enu_m), axis=1))
    if len(known) > 1:
        _, near = cKDTree(position_enu_m[known]).query(position_enu_m[known], min(PARTNERS_NEAR + 1, len(known)))
        pairs |= {_ordered(int(known[a]), int(known[b])) for a, row in enumerate(near) for b in row if a != b}
    alike = _alike([f.largest(PREVIEW) for f in seen], pool)
    best = np.argsort(-alike, axis=1, kind="stable")[:, :PARTNERS_ALIKE]
    pairs |= {_ordered(i, int(j)) for i, row in enumerate(best) for j in row if alike[i, j] >= LEAST_ALIKE}
    return sorted(pairs)


def _alike(previews: list[Features], pool: Executor) -> NDArray[np.int64]:
    """(n, n) how many of their largest features match."""
    n = len(previews)
    matches = np.zeros((n, n), np.int64)

    def row(i: int) -> list[int]:
        return [len(nearest_anywhere(previews[i], previews[j])) for j in range(i + 1, n)]

    for i, found in enumerate(pool.map(row, range(n))):
        matches[i, i + 1:] = matches[i + 1:, i] = found
    return matches


def _ordered(i: int, j: int) -> tuple[int, int]:
    return (min(i, j), max(i, j))
