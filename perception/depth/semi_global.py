"""Semi-global aggregation of a cost volume along four or eight directions (Hirschmuller 2008), in numba."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perception.depth.compiled import compiled
from perception.depth.depth_map import Image

Volume = NDArray[np.int16]

SMALL_JUMP = 30
LARGE_JUMP = 150
NOWHERE = np.int16(32000)
"""Cost of planes before the first and after the last."""


def aggregate(cost: Volume, gray: Image) -> Volume:
    """(h, w, planes) costs summed over eight paths; jumps cost less across grey edges."""
    total = np.zeros_like(cost)
    for rows, step in ((1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        _sweep_rows(cost, gray, rows, step, total)
    for columns in (1, -1):
        _sweep_columns(cost, gray, columns, total)
    return total


def winners(volume: Volume) -> tuple[NDArray[np.int32], Image, Image]:
    """(h, w) best plane, its sub-plane offset, and the least cost more than three planes away.

    The offset is where two lines of equal slope meet: costs are sampled too coarsely for a parabola, which would draw
    the offset to whole planes (Shimizu & Okutomi 2001).
    """
    h, w, _ = volume.shape
    best, offset, second = np.empty((h, w), np.int32), np.empty((h, w), np.float32), np.empty((h, w), np.float32)
    _winners(volume, best, offset, second)
    return best, offset, second


@compiled
def _step(cost: Volume, previous: Volume, jump: int, out: Volume) -> None:
    """One pixel further along a path: the recursion of Hirschmuller (2008), Eq. 13. previous, out (planes + 2,) begin
    and end with NOWHERE. Sums stay within 16 bits, so that loops compile to vectors of 16 planes."""
    below, at, above, new = previous[:-2], previous[1:-1], previous[2:], out[1:-1]
    least = at[0]
    for d in range(len(at)):
        least = min(least, at[d])
    most = np.int16(least + jump)
    for d in range(len(cost)):
        beside = np.int16(min(below[d], above[d]) + SMALL_JUMP)
        new[d] = np.int16(cost[d] + np.int16(min(min(at[d], most), beside) - least))


@compiled
def _add(more: Volume, total: Volume) -> None:
    for d in range(len(total)):
        total[d] += more[d]


@compiled
def _jump(a: float, b: float) -> int:
    return max(SMALL_JUMP + 20, int(LARGE_JUMP / (1.0 + abs(a - b) * 0.1)))


@compiled
def _sweep_rows(cost: Volume, gray: Image, direction: int, step: int, total: Volume) -> None:
    h, w, planes = cost.shape
    previous, current = np.full((w, planes + 2), NOWHERE), np.full((w, planes + 2), NOWHERE)
    start = 0 if direction > 0 else h - 1
    for k in range(h):
        y = start + direction * k
        for x in range(w):
            x0 = x - step
            if k == 0 or x0 < 0 or x0 >= w:
                current[x, 1:-1] = cost[y, x]
            else:
                _step(cost[y, x], previous[x0], _jump(gray[y, x], gray[y - direction, x0]), current[x])
            _add(current[x, 1:-1], total[y, x])
        previous, current = current, previous


@compiled
def _sweep_columns(cost: Volume, gray: Image, direction: int, total: Volume) -> None:
    h, w, planes = cost.shape
    start = 0 if direction > 0 else w - 1
    previous, current = np.full(planes + 2, NOWHERE), np.full(planes + 2, NOWHERE)
    for y in range(h):
        for k in range(w):
            x = start + direction * k
            if k == 0:
                current[1:-1] = cost[y, x]
            else:
                _step(cost[y, x], previous, _jump(gray[y, x], gray[y, x - direction]), current)
            _add(current[1:-1], total[y, x])
            previous, current = current, previous


@compiled
def _winners(volume: Volume, best: NDArray[np.int32], offset: Image, second: Image) -> None:
    h, w, planes = volume.shape
    for y in range(h):
        for x in range(w):
            cost = volume[y, x]
            b = 0
            for d in range(1, planes):
                if cost[d] < cost[b]:
                    b = d
            other = 32767
            for d in range(planes):
                if abs(d - b) > 3 and cost[d] < other:
                    other = cost[d]
            best[y, x], second[y, x], offset[y, x] = b, other, 0.0
            if 0 < b < planes - 1:
                rise = float(max(cost[b - 1], cost[b + 1])) - cost[b]
                if rise > 0:
                    offset[y, x] = 0.5 * (float(cost[b - 1]) - cost[b + 1]) / rise
