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
    nx, ny, nz = free_area.shape
    flat = free_area.reshape(-1)
    count = 0
    for ray in range(directions.shape[0]):
        until, area = free_until[ray], ray_area[ray]
        entry, leave = _clip(start, directions[ray], free_area.shape, until)
        if entry >= leave:
            continue
        i, step_i, t_i, span_i = _begin(start[0], directions[ray, 0], entry, nx)
        j, step_j, t_j, span_j = _begin(start[1], directions[ray, 1], entry, ny)
        k, step_k, t_k, span_k = _begin(start[2], directions[ray, 2], entry, nz)
        t = entry
        while t < leave:
            end = min(t_i, min(t_j, t_k))
            if end > until:
                break
            index = (i * ny + j) * nz + k
            middle = 0.5 * (t + end)
            amount = int(area * middle * middle * (end - t) * AREA_UNIT) + 1
            if flat[index] == 0:
                touched[count] = index
                count += 1
            flat[index] += amount
            t = end
            if t_i <= end:
                t_i, i = t_i + span_i, i + step_i
                if i < 0 or i >= nx:
                    break
            elif t_j <= end:
                t_j, j = t_j + span_j, j + step_j
                if j < 0 or j >= ny:
                    break
            else:
                t_k, k = t_k + span_k, k + step_k
                if k < 0 or k >= nz:
                    break
    return count


@compiled
def _clip(start: Array, direction: Array, shape: tuple[int, int, int], reach: float) -> tuple[float, float]:
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
def _begin(start: float, direction: float, entry: float, size: int) -> tuple[int, int, float, float]:
    """Along one axis: first cell, step, distance to the first crossing and between crossings."""
    cell = min(max(int(np.floor(start + entry * direction)), 0), size - 1)
    if direction == 0.0:
        return cell, -1, np.inf, np.inf
    step = 1 if direction > 0.0 else -1
    wall = cell + (1 if step > 0 else 0)
    return cell, step, (wall - start) / direction, abs(1.0 / direction)
