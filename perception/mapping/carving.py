"""Rays through a voxel grid: which voxels one picture saw to be free, and which it hit (Amanatides & Woo 1987)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from perception.depth.compiled import compiled

AREA_UNIT = 1024
"""One voxel cross-section of swept area."""


@compiled
def trace(start: Array, directions: Array, free_until: Array, ray_area: Array,
          free_area: NDArray[np.int32], touched: NDArray[np.int64]) -> int:
    """Adds the area that each ray sweeps to every voxel between the start and its free end; counts the voxels touched.

    start: (3,) in voxels from the grid's lower corner. directions: (n, 3) unit. free_until: (n,) in voxels.
    ray_area: (n,) cross-section of a ray at distance 1 voxel, in voxel faces.
    free_area: (nx, ny, nz) accumulator in 1 / AREA_UNIT faces, zero at first; touched: flat indices of voxels reached.
    """
    shape = np.array(free_area.shape)
    flat = free_area.reshape(-1)
    count = 0
    for ray in range(directions.shape[0]):
        entry, leave = _clip(start, directions[ray], shape, free_until[ray])
        if entry >= leave:
            continue
        cell, step, next_t, delta = _begin(start, directions[ray], entry, shape)
        t = entry
        while t < leave:
            axis = 0
            if next_t[1] < next_t[axis]:
                axis = 1
            if next_t[2] < next_t[axis]:
                axis = 2
            end = next_t[axis]
            if end > free_until[ray]:
                break
            index = (cell[0] * shape[1] + cell[1]) * shape[2] + cell[2]
            middle = 0.5 * (t + end)
            amount = int(ray_area[ray] * middle * middle * (end - t) * AREA_UNIT) + 1
            if flat[index] == 0:
                touched[count] = index
                count += 1
            flat[index] += amount
            t = end
            next_t[axis] += delta[axis]
            cell[axis] += step[axis]
            if cell[axis] < 0 or cell[axis] >= shape[axis]:
                break
    return count


@compiled
def _clip(start: Array, direction: Array, shape: NDArray[np.int64], reach: float) -> tuple[float, float]:
    """Where a ray enters and leaves the grid."""
    entry, leave = 0.0, reach
    for axis in range(3):
        if direction[axis] == 0.0:
            if start[axis] < 0.0 or start[axis] >= shape[axis]:
                return 1.0, 0.0
            continue
        a, b = -start[axis] / direction[axis], (shape[axis] - start[axis]) / direction[axis]
        entry, leave = max(entry, min(a, b)), min(leave, max(a, b))
    return entry, leave


@compiled
def _begin(start: Array, direction: Array, entry: float,
           shape: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array]:
    """First cell, steps, distance to the first crossing per axis and distance between crossings."""
    cell, step = np.empty(3, np.int64), np.empty(3, np.int64)
    next_t, delta = np.empty(3), np.empty(3)
    for axis in range(3):
        at = start[axis] + entry * direction[axis]
        cell[axis] = min(max(int(np.floor(at)), 0), shape[axis] - 1)
        step[axis] = 1 if direction[axis] > 0.0 else -1
        if direction[axis] == 0.0:
            next_t[axis], delta[axis] = np.inf, np.inf
        else:
            wall = cell[axis] + (1 if step[axis] > 0 else 0)
            next_t[axis] = (wall - start[axis]) / direction[axis]
            delta[axis] = abs(1.0 / direction[axis])
    return cell, step, next_t, delta
