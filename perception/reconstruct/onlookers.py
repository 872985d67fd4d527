"""Which pictures look at the places that a depth map shows, by the depth maps of all.

Poses alone do not tell: pictures that share much of their frames where surface is usually found may stand beside each
other before a wall twice as far away, while those that would confirm it stand across the gap.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from perception.depth.compiled import compiled
from perception.reconstruct.fusion import PosedDepth

COLUMNS = 120
"""Depths that are looked up per row of a picture."""
ASKED_EVERY = 3
"""Of these, every so many of a row and every so many rows are asked who else shows them."""
LEAST_FACING = math.cos(math.radians(75.0))
"""Between the ways in which two pictures look at a place: from farther aside they see other surface."""
BEFORE_SHARE = 0.1
"""A picture that sees something nearer than a place by more than this share does not show it."""


class Onlookers:
    """Thinned depth maps of all pictures, which share a camera, and their poses."""

    def __init__(self, seen: Iterable[PosedDepth], camera: Camera) -> None:
        """seen: read one after the other; of each 0.03 MiB are kept."""
        self._step = max(1, camera.width_px // COLUMNS)
        half, maps, turns, positions = self._step // 2, [], [], []
        for picture in seen:
            maps.append(np.array(picture.depth[half::self._step, half::self._step]))
            turns.append(picture.enu_from_camera)
            positions.append(picture.position_enu_m)
        self._depth, self._turns, self._positions = np.stack(maps), np.stack(turns), np.stack(positions)
        self._intrinsics = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])

    def of(self, index: int, count: int) -> list[int]:
        """At most `count` pictures that look at what this one shows, so that every place has many of them and none
        goes without; first those that add most, of equal ones the earlier.

        What they see there does not matter, only that nothing is before it. Cost: a projection for each of the other
        pictures and of some 900 places.
        """
        shown = np.zeros((len(self._depth), -(-self._depth.shape[1] // ASKED_EVERY),
                          -(-self._depth.shape[2] // ASKED_EVERY)), np.float32)
        _look(self._depth, index, self._turns, self._positions, self._intrinsics, self._step, shown)
        rows = shown.reshape(len(shown), -1)
        some = np.flatnonzero(rows.any(axis=1))
        return [int(i) for i in some[_cover(rows[some], min(count, len(some)))]]


@compiled
def _look(depth: NDArray[np.float32], index: int, turns: Array, positions: Array, k: Array, step: int,
          shown: NDArray[np.float32]) -> None:
    """How well each other picture shows each place: the smaller of the two distances over the larger."""
    pictures, height, width = depth.shape
    for row in range(0, height, ASKED_EVERY):
        for column in range(0, width, ASKED_EVERY):
            d = depth[index, row, column]
            if d <= 0.0 or d == np.inf:
                continue
            x = (column * step + step // 2 + 0.5 - k[2]) / k[0] * d
            y = (row * step + step // 2 + 0.5 - k[3]) / k[1] * d
            r = turns[index]
            own = r[:, 0] * x + r[:, 1] * y + r[:, 2] * d
            own_m = math.sqrt(own[0] ** 2 + own[1] ** 2 + own[2] ** 2)
            for other in range(pictures):
                if other == index:
                    continue
                t = turns[other]
                ex, ey, ez = (own[0] + positions[index, 0] - positions[other, 0],
                              own[1] + positions[index, 1] - positions[other, 1],
                              own[2] + positions[index, 2] - positions[other, 2])
                ahead = t[0, 2] * ex + t[1, 2] * ey + t[2, 2] * ez
                if ahead < 0.3:
                    continue
                u = (t[0, 0] * ex + t[1, 0] * ey + t[2, 0] * ez) / ahead * k[0] + k[2]
                v = (t[0, 1] * ex + t[1, 1] * ey + t[2, 1] * ez) / ahead * k[1] + k[3]
                i, j = int(np.floor(v / step)), int(np.floor(u / step))
                if i < 0 or i >= height or j < 0 or j >= width:
                    continue
                there_m = math.sqrt(ex * ex + ey * ey + ez * ez)
                facing = (own[0] * ex + own[1] * ey + own[2] * ez) / (own_m * there_m)
                if facing >= LEAST_FACING and depth[other, i, j] > ahead * (1.0 - BEFORE_SHARE):
                    shown[other, row // ASKED_EVERY, column // ASKED_EVERY] = min(own_m, there_m) / max(own_m, there_m)


@compiled
def _cover(shown: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """Greedy choice of rows; the n-th that shows a place adds an n-th of what the first does."""
    pictures, places = shown.shape
    worth, taken = np.ones(places), np.zeros(pictures, np.bool_)
    chosen = np.empty(count, np.int64)
    for n in range(count):
        best, most = -1, -1.0
        for i in range(pictures):
            if taken[i]:
                continue
            gain = 0.0
            for p in range(places):
                gain += shown[i, p] * worth[p]
            if gain > most:
                best, most = i, gain
        chosen[n], taken[best] = best, True
        for p in range(places):
            if shown[best, p] > 0.0:
                worth[p] /= 1.0 + worth[p]
    return chosen
