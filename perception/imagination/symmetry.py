"""What the map knows of a voxel's opposites: many things are alike left and right, front and back, or turned halfway.

How far that holds, the map's own pairs of known opposites tell, so that a thing that is not symmetric teaches nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid
from perception.imagination.surroundings import Floats

UNSEEN, SOLID, BESIDE, OPEN = range(4)
"""What an opposite is: not known, occupied, free beside something occupied, free elsewhere."""
KINDS = 4
ACROSS = ((0,), (1,), (0, 1))
"""Axes along which each symmetry mirrors, about the middle of the object's box."""
APART_M = 3.0
"""Opposites nearer to each other are alike because they are neighbours."""
PRIOR = 50.0
"""Pairs without a say that are added to those of the map."""
SHARE = 0.5
"""Of what opposites say: the network has read some of it off what lies between."""


def evidence(grid: VoxelGrid, index: NDArray[np.int64], object_min_enu_m: Array, object_max_enu_m: Array) -> Floats:
    """(n,) log odds for solid that the opposites of voxels (3, n) add. Of the symmetries that tell something, the one
    that tells most counts."""
    kind = _kinds(grid.state)
    middle = (object_min_enu_m + object_max_enu_m - 2.0 * grid.origin_enu_m) / (2.0 * grid.voxel_m)
    first = np.maximum(grid.index(object_min_enu_m), 0)
    box = tuple(slice(int(a), int(b) + 1) for a, b in zip(first, grid.index(object_max_enu_m), strict=True))
    result, most = np.zeros(index.shape[1], dtype=np.float32), np.zeros(index.shape[1])
    for axes in ACROSS:
        mirrored = _opposites(kind, middle, axes, APART_M / grid.voxel_m)
        odds, tells = _log_odds(mirrored[box], kind[box])
        opposite = mirrored[tuple(index)]
        better = (opposite != UNSEEN) & (tells > most)
        result[better], most[better] = odds[opposite[better]], tells
    return result * np.float32(SHARE)


def _kinds(state: NDArray[np.uint8]) -> NDArray[np.uint8]:
    beside = ndimage.maximum_filter((state == OCCUPIED).astype(np.uint8), 3, mode="constant") > 0
    return np.select([state == OCCUPIED, (state == FREE) & beside, state == FREE], [SOLID, BESIDE, OPEN],
                     UNSEEN).astype(np.uint8)


def _opposites(kind: NDArray[np.uint8], middle: Array, axes: tuple[int, ...], apart: float) -> NDArray[np.uint8]:
    """(i, j, k) what the opposite of each voxel is; UNSEEN too beyond the grid and nearer than apart, in voxels."""
    result, away = kind, np.zeros((1, 1, 1))
    for axis in axes:
        at = np.arange(kind.shape[axis]) + 0.5
        opposite = 2.0 * middle[axis] - at
        inside = (opposite >= 0.0) & (opposite < len(at))
        along = [-1 if a == axis else 1 for a in range(3)]
        result = np.where(inside.reshape(along), np.take(result, opposite.clip(0, len(at) - 1).astype(np.int64), axis),
                          np.uint8(UNSEEN))
        away = np.hypot(away, (opposite - at).reshape(along))
    return np.where(away < apart, np.uint8(UNSEEN), result)


def _log_odds(opposite: NDArray[np.uint8], kind: NDArray[np.uint8]) -> tuple[Floats, float]:
    """(KINDS,) log odds for solid by what the opposite is, and the information in that, from voxels (i, j, k)."""
    pairs = np.bincount((KINDS * kind + opposite).ravel(), minlength=KINDS * KINDS).reshape(KINDS, KINDS)
    pairs[:, UNSEEN] = 0
    counts = np.stack([pairs[BESIDE] + pairs[OPEN], pairs[SOLID]])
    share = (counts.sum(axis=0) + 1.0) / (counts.sum() + KINDS)
    chance = (counts + PRIOR * share) / (counts.sum(axis=1, keepdims=True) + PRIOR)
    odds: Floats = np.log(chance[1] / chance[0]).astype(np.float32)
    tells = counts.sum(axis=1) / max(int(counts.sum()), 1) @ (chance * np.log(chance / share)).sum(axis=1)
    return odds, float(tells)
