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
MIRRORED = (np.array([True, False, False]), np.array([False, True, False]), np.array([True, True, False]))
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
    known = _known_inside(grid, kind, object_min_enu_m, object_max_enu_m)
    result, most = np.zeros(index.shape[1], dtype=np.float32), np.zeros(index.shape[1])
    for mirrored in MIRRORED:
        pairs = _opposites(kind, known, middle, mirrored, grid.voxel_m)
        odds, tells = _log_odds(pairs, kind[tuple(known)] == SOLID)
        opposite = _opposites(kind, index, middle, mirrored, grid.voxel_m)
        better = (opposite != UNSEEN) & (tells > most)
        result[better], most[better] = odds[opposite[better]], tells
    return result * np.float32(SHARE)


def _kinds(state: NDArray[np.uint8]) -> NDArray[np.uint8]:
    beside = ndimage.maximum_filter((state == OCCUPIED).astype(np.uint8), 3, mode="constant") > 0
    return np.select([state == OCCUPIED, (state == FREE) & beside, state == FREE], [SOLID, BESIDE, OPEN],
                     UNSEEN).astype(np.uint8)


def _known_inside(grid: VoxelGrid, kind: NDArray[np.uint8], low: Array, high: Array) -> NDArray[np.int64]:
    """(3, m) known voxels of the object's box."""
    first = np.maximum(grid.index(low), 0)
    box = tuple(slice(int(a), int(b) + 1) for a, b in zip(first, grid.index(high), strict=True))
    return np.stack(np.nonzero(kind[box] != UNSEEN)) + first[:, None]


def _opposites(kind: NDArray[np.uint8], index: NDArray[np.int64], middle: Array, mirrored: NDArray[np.bool_],
               voxel_m: float) -> NDArray[np.uint8]:
    """(n,) what the opposites of voxels (3, n) are; UNSEEN too beyond the grid and near the plane between them."""
    across = np.where(mirrored[:, None], 2.0 * middle[:, None] - (index + 0.5), index + 0.5)
    opposite = np.floor(across).astype(np.int64)
    away_m = np.linalg.norm(across - (index + 0.5), axis=0) * voxel_m
    use = ((opposite >= 0) & (opposite < np.array(kind.shape)[:, None])).all(axis=0) & (away_m >= APART_M)
    result = np.full(index.shape[1], UNSEEN, dtype=np.uint8)
    result[use] = kind[tuple(opposite[:, use])]
    return result


def _log_odds(opposite: NDArray[np.uint8], solid: NDArray[np.bool_]) -> tuple[Floats, float]:
    """(KINDS,) log odds for solid by what the opposite is, and the information in that, from pairs (m,)."""
    seen = opposite != UNSEEN
    counts = np.stack([np.bincount(opposite[seen & (solid == s)], minlength=KINDS) for s in (False, True)])
    share = (counts.sum(axis=0) + 1.0) / (counts.sum() + KINDS)
    chance = (counts + PRIOR * share) / (counts.sum(axis=1, keepdims=True) + PRIOR)
    odds: Floats = np.log(chance[1] / chance[0]).astype(np.float32)
    tells = counts.sum(axis=1) / max(int(counts.sum()), 1) @ (chance * np.log(chance / share)).sum(axis=1)
    return odds, float(tells)
