"""Surface patches: the faces of the explored surface, gathered into areas that one picture sees as a whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid

LOOK_OUT_VOXELS = 2
"""How far outwards free space may begin: measured surface is often a voxel thicker than the true one."""
FACINGS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])


@dataclass(frozen=True)
class Patches:
    """(k) patches of surface."""

    position_enu_m: Array
    """(k, 3) mean position."""
    normal_enu: Array
    """(k, 3) unit axis direction towards the free space before the patch."""
    voxels: NDArray[np.int64]
    """(k,) voxel faces in the patch."""

    def __len__(self) -> int:
        return len(self.voxels)


def surface_patches(grid: VoxelGrid, object_min_enu_m: Array, object_max_enu_m: Array,
                    patch_m: float = 0.9) -> Patches:
    """Gather the faces between occupied voxels in the box and known-free space by cell of size patch_m and facing.

    A face needs no estimated normal, so thin members, edges and both sides of a deck ask for pictures from every side
    that lies open. Patches come in rising order of cell and facing.
    """
    lower, upper = np.asarray(object_min_enu_m), np.asarray(object_max_enu_m)
    index = np.argwhere(grid.state == OCCUPIED)
    position = grid.centers(index)
    inside = np.all((position >= lower - 0.5 * grid.voxel_m) & (position <= upper + 0.5 * grid.voxel_m), axis=1)
    index, position = index[inside], position[inside]
    rows, points = [np.zeros((0, 4), dtype=np.int64)], [np.zeros((0, 3))]
    for facing, step in enumerate(FACINGS):
        open_ahead = np.zeros(len(index), dtype=np.bool_)
        for reach in range(1, LOOK_OUT_VOXELS + 1):
            ahead = index + reach * step
            seen = grid.inside(ahead)
            open_ahead[seen] |= grid.state[tuple(ahead[seen].T)] == FREE
        cell = np.floor((position[open_ahead] - lower) / patch_m).astype(np.int64)
        rows.append(np.column_stack([cell, np.full(len(cell), facing)]))
        points.append(position[open_ahead] + 0.5 * grid.voxel_m * step)
    faces, where = np.concatenate(rows), np.concatenate(points)
    unique, patch, voxels = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(patch.ravel(), where[:, a], minlength=len(unique)) for a in range(3)], axis=1)
    return Patches(mean / np.maximum(voxels, 1)[:, None], FACINGS[unique[:, 3]].astype(np.float64), voxels)
