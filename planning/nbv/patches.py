"""Surface patches: the voxels of the explored surface, gathered into areas that one picture sees as a whole."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from missions.frames import Array
from missions.grid import SurfaceVoxels

LEAST_OF_A_WALL = 0.5
"""A patch with fewer voxels around it than this share of what a flat wall would have is a thin member."""
LEAST_AGREEMENT = 0.7
"""Length of the mean of the unit normals below which they contradict each other."""


@dataclass(frozen=True)
class Patches:
    """(k) patches of surface."""

    position_enu_m: Array
    """(k, 3) mean position."""
    normal_enu: Array
    """(k, 3) unit mean normal."""
    any_incidence: NDArray[np.bool_]
    """(k,) patches without a trustworthy normal, such as cables and rails: they may be seen from any side."""
    voxels: NDArray[np.int64]
    """(k,) voxels in the patch."""

    def __len__(self) -> int:
        return len(self.voxels)


def surface_patches(surface: SurfaceVoxels, object_min_enu_m: Array, object_max_enu_m: Array, voxel_m: float,
                    patch_m: float = 0.9) -> Patches:
    """Gather the surface voxels in the box by cell of size patch_m and by the axis that their normal is nearest to.

    So both faces of a thin deck are patches of their own. A patch with few voxels (of voxel_m) around it, or whose
    normals disagree, accepts any incidence. Patches come in rising order of cell and axis.
    """
    lower, upper = np.asarray(object_min_enu_m), np.asarray(object_max_enu_m)
    inside = np.all((surface.position_enu_m >= lower) & (surface.position_enu_m <= upper), axis=1)
    position, normal = surface.position_enu_m[inside], surface.normal_enu[inside]
    if not len(position):
        return Patches(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.bool_), np.zeros(0, dtype=np.int64))
    cell = np.floor((position - lower) / patch_m).astype(np.int64)
    axis = np.abs(normal).argmax(axis=1)
    facing = 2 * axis + (np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] < 0)
    _, patch, voxels = np.unique(np.column_stack([cell, facing]), axis=0, return_inverse=True, return_counts=True)
    mean, direction = (_mean(values, patch.ravel(), voxels) for values in (position, normal))
    agreement = np.linalg.norm(direction, axis=1)
    unit = direction / np.maximum(agreement, 1e-9)[:, None]
    around = cKDTree(position).query_ball_point(mean, patch_m, return_length=True)
    thin = around < LEAST_OF_A_WALL * math.pi * (patch_m / voxel_m) ** 2
    return Patches(mean, unit, thin | (agreement < LEAST_AGREEMENT), voxels)


def _mean(values: Array, group: NDArray[np.int64], count: NDArray[np.int64]) -> Array:
    sums = np.stack([np.bincount(group, values[:, a], minlength=len(count)) for a in range(3)], axis=1)
    result: Array = sums / count[:, None]
    return result
