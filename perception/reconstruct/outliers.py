"""Points beside the surface that their neighbours lie on.

Depth maps that agree by chance, and those of far or grazing pictures, scatter points about a surface which others
measure well: nearly all of them have good neighbours. Every point votes for those near it through which its own tangent
plane passes, with its confidence for a weight, and against the others; a plane fitted anew would be drawn to them.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from perception.depth.compiled import compiled
from perception.reconstruct.cloud import Cloud, cell_numbers

METHOD = 1
"""Raised whenever other points are left out of the same cloud."""
REACH_SPACINGS = 3.0
OFF_SPACINGS = 0.5
LEAST_SHARE = 0.5
"""Of the votes. Beside a sharp edge as many speak for a point as against it."""
AT_ONCE_CELLS = 20_000


def without_outliers(cloud: Cloud, spacing_m: float, threads: int = 1) -> Cloud:
    """The points that at least LEAST_SHARE of the votes within REACH_SPACINGS are for, their own included, in order.

    Those whose normals look away, as on the other side of a thin wall, have no vote. Cost: n times the points in reach.
    """
    if not len(cloud):
        return cloud
    reach_m, off_m = REACH_SPACINGS * spacing_m, OFF_SPACINGS * spacing_m
    numbers, across, along = cell_numbers(cloud.points_enu_m, reach_m)
    order = np.argsort(numbers, kind="stable")
    cells, first_of = np.unique(numbers[order], return_index=True)
    starts = np.append(first_of, len(order))
    columns = np.array([dx * across + dy * along for dx in (-1, 0, 1) for dy in (-1, 0, 1)])
    by_cell, kept = cloud.select(order), np.empty(len(cloud), np.bool_)

    def decide(first: int) -> None:
        _decide(by_cell.points_enu_m, by_cell.normals, by_cell.confidence, cells, starts, columns, first,
                min(first + AT_ONCE_CELLS, len(cells)), reach_m, off_m, kept)

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(decide, range(0, len(cells), AT_ONCE_CELLS)))
    return cloud.select(np.sort(order[kept]))


@compiled
def _decide(points: NDArray[np.float32], normals: NDArray[np.float32], confidence: NDArray[np.uint8],
            cells: NDArray[np.int64], starts: NDArray[np.int64], columns: NDArray[np.int64], first: int, last: int,
            reach_m: float, off_m: float, kept: NDArray[np.bool_]) -> None:
    """Of the points in the cells from first to before last; all points are in order of their cells' numbers."""
    begin, end = np.empty(len(columns), np.int64), np.empty(len(columns), np.int64)
    for c in range(first, last):
        for m in range(len(columns)):
            middle = cells[c] + columns[m]
            begin[m] = starts[np.searchsorted(cells, middle - 1)]
            end[m] = starts[np.searchsorted(cells, middle + 1, side="right")]
        for i in range(starts[c], starts[c + 1]):
            votes, speaking_for = 0, 0
            for m in range(len(columns)):
                for j in range(begin[m], end[m]):
                    x, y, z = (points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2])
                    if x * x + y * y + z * z > reach_m * reach_m:
                        continue
                    nx, ny, nz = normals[j, 0], normals[j, 1], normals[j, 2]
                    if normals[i, 0] * nx + normals[i, 1] * ny + normals[i, 2] * nz < 0.0:
                        continue
                    votes += confidence[j]
                    if abs(x * nx + y * ny + z * nz) < off_m:
                        speaking_for += confidence[j]
            kept[i] = speaking_for >= LEAST_SHARE * votes
