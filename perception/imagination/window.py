"""The part of a map that the network looks at, and what it is told about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid

MARGIN_M = 4.0
"""How far the window reaches beyond the object's box, sideways and above; below it reaches one cell into the ground."""
MULTIPLE = 8
"""Extents of a window are multiples of this many voxels."""
CELL = 2
UNIT_M = 10.0
DEEPEST, FARTHEST = -1.0, 4.0

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Window:
    """Voxels first to first + shape of a grid, of which some may lie outside; those are unknown."""

    first: NDArray[np.int64]
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, grid: VoxelGrid, object_min_enu_m: Array, object_max_enu_m: Array, ground_up_m: float) -> Window:
        """The object's box and MARGIN_M, where that lies in the grid."""
        lower, upper = np.asarray(object_min_enu_m) - MARGIN_M, np.asarray(object_max_enu_m) + MARGIN_M
        lower[2] = min(float(object_min_enu_m[2]), ground_up_m) - CELL * grid.voxel_m
        size = np.array(grid.state.shape)
        first, last = np.clip(grid.index(lower), 0, size), np.clip(grid.index(upper) + 1, 0, size)
        i, j, k = (int(n) for n in -(-np.maximum(last - first, 1) // MULTIPLE) * MULTIPLE)
        return cls(first, (i, j, k))

    def cut(self, grid_values: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(i, j, k) the window's part of an array over the grid, 0 beyond the grid."""
        result = np.zeros(self.shape, dtype=np.uint8)
        inside = grid_values[self.within(grid_values.shape)]
        result[tuple(slice(0, n) for n in inside.shape)] = inside
        return result

    def within(self, shape: tuple[int, ...]) -> tuple[slice, ...]:
        """The window's part of a grid of this shape."""
        return tuple(slice(int(a), int(min(a + n, s))) for a, n, s in zip(self.first, self.shape, shape, strict=True))

    def place(self, grid: VoxelGrid, object_min_enu_m: Array, object_max_enu_m: Array, ground_up_m: float) -> Floats:
        """(3, i / CELL, j / CELL, k / CELL) metres / UNIT_M above the ground, below the box's top, inside its nearest
        side (negative outside)."""
        cells = [first + (np.arange(n // CELL) + 0.5) * CELL for first, n in zip(self.first, self.shape, strict=True)]
        x, y, z = (low + at * grid.voxel_m for low, at in zip(grid.origin_enu_m, cells, strict=True))
        inside_x, inside_y = (np.minimum(at - object_min_enu_m[a], object_max_enu_m[a] - at)
                              for a, at in enumerate((x, y)))
        sides = np.minimum(inside_x[:, None], inside_y[None, :])[:, :, None]
        height, depth = (z - ground_up_m)[None, None, :], (object_max_enu_m[2] - z)[None, None, :]
        channels = np.broadcast_arrays(height, depth, sides)
        return np.clip(np.stack(channels) / UNIT_M, DEEPEST, FARTHEST).astype(np.float32)


def known(state: NDArray[np.uint8]) -> Floats:
    """(2, i, j, k) whether each voxel is known to be free, and whether it is known to be occupied."""
    return np.stack([state == FREE, state == OCCUPIED]).astype(np.float32)
