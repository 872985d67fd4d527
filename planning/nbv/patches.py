"""Surface patches: the faces of the explored surface, gathered into areas that one picture sees as a whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid

Mask = NDArray[np.bool_]
LOOK_OUT_VOXELS = 2
"""How far outwards free space may begin: measured surface is often a voxel thicker than the true one."""
FACINGS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])


@dataclass(frozen=True)
class Patches:
    """(k) patches of surface."""

    position_enu_m: Array
    """(k, 3) mean position."""
    normal_enu: Array
    """(k, 3) unit axis direction towards what is free or not known before the patch."""
    voxels: NDArray[np.int64]
    """(k,) voxel faces in the patch."""
    open: NDArray[np.bool_]
    """(k,) known-free space lies before one of its faces; else it is not known what lies there."""

    def __len__(self) -> int:
        return len(self.voxels)


def surface_patches(grid: VoxelGrid, object_min_enu_m: Array, object_max_enu_m: Array,
                    patch_m: float = 0.9) -> Patches:
    """Gather the faces between occupied voxels in the box and what is not known to be solid by cell of size patch_m and
    facing.

    Where nothing is known next to a face, pictures may show it all the same: exploration leaves rims at the foot of
    walls and between girders, and 5 % of a bridge's surface was in too few pictures only because of them. Faces that
    look into the structure have no line of sight that meets nothing solid.

    A face needs no estimated normal, so thin members, edges and both sides of a deck ask for pictures from every side
    that lies open. Patches come in rising order of cell and facing.
    """
    lower, upper = np.asarray(object_min_enu_m), np.asarray(object_max_enu_m)
    index = np.argwhere(grid.state == OCCUPIED)
    position = grid.centers(index)
    inside = np.all((position >= lower - 0.5 * grid.voxel_m) & (position <= upper + 0.5 * grid.voxel_m), axis=1)
    index, position = index[inside], position[inside]
    rows, points, opens = [np.zeros((0, 4), dtype=np.int64)], [np.zeros((0, 3))], [np.zeros(0, dtype=np.bool_)]
    for facing, step in enumerate(FACINGS):
        open_ahead, unknown = _before(grid, index, step)
        face = open_ahead | unknown
        cell = np.floor((position[face] - lower) / patch_m).astype(np.int64)
        rows.append(np.column_stack([cell, np.full(len(cell), facing)]))
        points.append(position[face] + 0.5 * grid.voxel_m * step)
        opens.append(open_ahead[face])
    faces, where = np.concatenate(rows), np.concatenate(points)
    unique, patch, voxels = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(patch.ravel(), where[:, a], minlength=len(unique)) for a in range(3)], axis=1)
    open_faces = np.bincount(patch.ravel(), np.concatenate(opens), minlength=len(unique))
    return Patches(mean / np.maximum(voxels, 1)[:, None], FACINGS[unique[:, 3]].astype(np.float64), voxels,
                   open_faces > 0)


def _before(grid: VoxelGrid, index: NDArray[np.int64], step: NDArray[np.int64]) -> tuple[Mask, Mask]:
    """Of voxels (n, 3) and an axis direction (3,): whether known-free space begins there within LOOK_OUT_VOXELS, and
    whether nothing is known of the next voxel. Outside the grid counts as neither."""
    free, unknown = np.zeros(len(index), dtype=np.bool_), np.zeros(len(index), dtype=np.bool_)
    for reach in range(1, LOOK_OUT_VOXELS + 1):
        ahead = index + reach * step
        seen = grid.inside(ahead)
        state = grid.state[tuple(ahead[seen].T)]
        free[seen] |= state == FREE
        if reach == 1:
            unknown[seen] = state == UNKNOWN
    return free, unknown
