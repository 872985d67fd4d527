"""What is known around each unknown voxel, as numbers that do not change when the map is turned by a right angle or
mirrored: how much is free and how much is surface in cubes of several sizes, along lines and in slabs through the
voxel, above and below it; where it lies in the object's box; and what the map is like as a whole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from perception.imagination.window import CELL, Box, Window

CUBES_M = (1.5, 3.5)
WIDE_CUBES_M = (7.0, 15.0, 31.0)
"""Edges of cubes; the wide ones are counted in cells of CELL voxels."""
STRIP_M = 4.5
"""Length of lines and edge of slabs."""
UNIT_M = 10.0
DEEPEST, FARTHEST = -1.0, 4.0
COUNT = 2 * len(CUBES_M) + 2 * len(WIDE_CUBES_M) + 4 + 4 + 3 + 5

Floats = NDArray[np.float32]
Where = NDArray[np.int64]


def surroundings(grid: VoxelGrid, window: Window, box: Box, where: Where) -> Floats:
    """(n, COUNT) numbers for the window's voxels `where`, flat and in ascending order."""
    state = window.cut(grid.state)
    free, solid = (state == FREE).astype(np.float32), (state == OCCUPIED).astype(np.float32)
    rows = [*_cubes(free, solid, grid.voxel_m, where), *_strips(solid, grid.voxel_m, where),
            *_columns(free, solid, grid.voxel_m, where), *_place(grid, window, box, where),
            *(np.full(len(where), v, np.float32) for v in _whole(free, solid, box))]
    return np.stack(rows).T


def _cubes(free: Floats, solid: Floats, voxel_m: float, where: Where) -> list[Floats]:
    """Shares of free and solid in cubes around each voxel."""
    rows = [ndimage.uniform_filter(values, _odd(edge / voxel_m), mode="constant").ravel()[where]
            for edge in CUBES_M for values in (free, solid)]
    shape = np.array(free.shape) // CELL
    i, j, k = np.unravel_index(where, free.shape)
    cell = np.ravel_multi_index((i // CELL, j // CELL, k // CELL), tuple(shape))
    for values in (free, solid):
        coarse = values.reshape(shape[0], CELL, shape[1], CELL, shape[2], CELL).mean(axis=(1, 3, 5))
        rows += [ndimage.uniform_filter(coarse, _odd(edge / (CELL * voxel_m)), mode="constant").ravel()[cell]
                 for edge in WIDE_CUBES_M]
    return rows


def _strips(solid: Floats, voxel_m: float, where: Where) -> list[Floats]:
    """Share of solid along the vertical and the better horizontal, in the horizontal slab and the better vertical."""
    size = _odd(STRIP_M / voxel_m)
    x, y, z = (ndimage.uniform_filter1d(solid, size, axis=axis, mode="constant") for axis in range(3))
    xy, yz, zx = (ndimage.uniform_filter1d(line, size, axis=axis, mode="constant").ravel()[where]
                  for line, axis in ((x, 1), (y, 2), (z, 0)))
    x, y, z = (line.ravel()[where] for line in (x, y, z))
    return [z, np.maximum(x, y), xy, np.maximum(yz, zx)]


def _columns(free: Floats, solid: Floats, voxel_m: float, where: Where) -> list[Floats]:
    """UNIT_M of free and of solid below and above each voxel."""
    rows = []
    for values in (free, solid):
        below = np.cumsum(values, axis=2, dtype=np.float32)
        above = below[:, :, -1:] - below
        rows += [np.minimum(column.ravel()[where] * np.float32(voxel_m / UNIT_M), FARTHEST)
                 for column in (below, above)]
    return rows


def _place(grid: VoxelGrid, window: Window, box: Box, where: Where) -> list[Floats]:
    """UNIT_M above the ground, below the box's top, inside its nearest side (negative outside)."""
    x, y, z = window.middles(grid)
    i, j, k = np.unravel_index(where, window.shape)
    inside_x, inside_y = (np.minimum(at - box.lower_enu_m[a], box.upper_enu_m[a] - at) for a, at in enumerate((x, y)))
    rows = ((z - box.ground_up_m)[k], (box.upper_enu_m[2] - z)[k], np.minimum(inside_x[i], inside_y[j]))
    return [np.clip(row / UNIT_M, DEEPEST, FARTHEST).astype(np.float32) for row in rows]


def _whole(free: Floats, solid: Floats, box: Box) -> tuple[float, ...]:
    """Share of what is known that is solid, share that is known, and the box's height, lesser and greater width."""
    known_free, known_solid = float(free.sum()), float(solid.sum())
    known = known_free + known_solid
    x, y, z = (box.upper_enu_m - box.lower_enu_m) / UNIT_M
    return known_solid / max(known, 1.0), known / free.size, float(z), float(min(x, y)), float(max(x, y))


def unknown_voxels(grid: VoxelGrid, window: Window) -> Where:
    """(n,) flat numbers in the window of the grid's unknown voxels."""
    inside = window.cut((grid.state == UNKNOWN).astype(np.uint8))
    result: Where = np.flatnonzero(inside)
    return result


def _odd(voxels: float) -> int:
    """The odd whole number next to it."""
    return 2 * round((voxels - 1.0) / 2.0) + 1
