"""The part of a map that is imagined, and where its voxels lie in the object's box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from missions.grid import VoxelGrid

MARGIN_M = 4.0
"""How far the window reaches beyond the object's box, sideways and above; below it reaches one cell into the ground."""
CELL = 2
"""Extents of a window are multiples of this many voxels."""


@dataclass(frozen=True)
class Box:
    """What is known of the object from the start."""

    lower_enu_m: Array
    upper_enu_m: Array
    ground_up_m: float


@dataclass(frozen=True)
class Window:
    """Voxels first to first + shape of a grid, of which some may lie outside; those are unknown."""

    first: NDArray[np.int64]
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, grid: VoxelGrid, box: Box) -> Window:
        """The object's box and MARGIN_M, where that lies in the grid."""
        lower, upper = box.lower_enu_m - MARGIN_M, box.upper_enu_m + MARGIN_M
        lower[2] = min(float(box.lower_enu_m[2]), box.ground_up_m) - CELL * grid.voxel_m
        size = np.array(grid.state.shape)
        first, last = np.clip(grid.index(lower), 0, size), np.clip(grid.index(upper) + 1, 0, size)
        i, j, k = (int(n) for n in -(-np.maximum(last - first, 1) // CELL) * CELL)
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

    def middles(self, grid: VoxelGrid) -> tuple[Array, Array, Array]:
        """East (i,), north (j,) and up (k,) of the voxels' middles."""
        cells = [first + np.arange(n) + 0.5 for first, n in zip(self.first, self.shape, strict=True)]
        x, y, z = (low + at * grid.voxel_m for low, at in zip(grid.origin_enu_m, cells, strict=True))
        return x, y, z
