"""From how near each place was seen, so that what was seen of it from far away can be left out.

The error of depth grows with the square of the distance. A place that one picture shows from 6 m is not told better by
another one from 20 m, which only lays a haze of its own around it. A place that is seen from afar alone is kept, where
that is not far from usual.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from perception.reconstruct.settings import Region

CELL_M = 0.25
MOST_CELLS = 10_000_000
"""Cells grow in a region so large that it has more."""
LEAST_POINTS = 5
"""A picture has seen a cell when it has so many points in it."""
FARTHER = 1.6
"""What was seen from more than this many times as far as a cell was seen from is left out there."""
FARTHEST = 3.0
"""Nothing is kept from more than so many usual distances."""


class Nearness:
    """For cells of a region, the distance of the nearest picture that has points there."""

    def __init__(self, region: Region, usual_m: float) -> None:
        """usual_m: distance from which surfaces were meant to be seen; what is usual in fact may be farther."""
        self._usual_m = usual_m
        self._lower = np.asarray(region.lower_enu_m, np.float64)
        extent = np.asarray(region.upper_enu_m, np.float64) - self._lower
        self._cell_m = max(CELL_M, float(np.cbrt(np.prod(extent) / MOST_CELLS)))
        shape = np.floor(extent / self._cell_m).astype(np.int64) + 1
        self._shape = tuple(shape.tolist())
        self._nearest_m = np.full(int(np.prod(shape)), np.inf, np.float32)

    def add(self, points_enu_m: NDArray[np.float32], camera_enu_m: Array) -> None:
        """A picture's points (n, 3), all in the region. The order of pictures does not matter; all come before any
        question."""
        if not len(points_enu_m):
            return
        key = self._key(points_enu_m)
        cells, where, points = np.unique(key, return_inverse=True, return_counts=True)
        distance_m = np.full(len(cells), np.inf, np.float32)
        np.minimum.at(distance_m, where, _distance(points_enu_m, camera_enu_m))
        seen = points >= LEAST_POINTS
        self._nearest_m[cells[seen]] = np.minimum(self._nearest_m[cells[seen]], distance_m[seen])

    def near_enough(self, points_enu_m: NDArray[np.float32], camera_enu_m: Array) -> NDArray[np.bool_]:
        """(n,) which of a picture's points were not seen from far nearer by another picture."""
        return np.asarray(_distance(points_enu_m, camera_enu_m) <= self._limit_m[self._key(points_enu_m)])

    @cached_property
    def _limit_m(self) -> NDArray[np.float32]:
        """Per cell, the distance from which points are still taken."""
        seen = self._nearest_m[np.isfinite(self._nearest_m)]
        usual_m = max(self._usual_m, float(np.median(seen)) if len(seen) else 0.0)
        limit_m = np.minimum(np.float32(FARTHER) * self._nearest_m, np.float32(FARTHEST * usual_m))
        return np.asarray(limit_m, np.float32)

    def _key(self, points_enu_m: NDArray[np.float32]) -> NDArray[np.int64]:
        cell = np.floor((points_enu_m - self._lower) / self._cell_m).astype(np.int64)
        return np.asarray(np.ravel_multi_index(tuple(cell.T), self._shape, mode="clip"))


def _distance(points_enu_m: NDArray[np.float32], camera_enu_m: Array) -> NDArray[np.float32]:
    return np.asarray(np.linalg.norm(points_enu_m - camera_enu_m.astype(np.float32), axis=1), np.float32)
