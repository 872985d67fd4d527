"""Which patch can be photographed well from which position: distance, incidence and a free line of sight."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from missions.frames import Array
from missions.grid import FREE, VoxelGrid
from planning.nbv.patches import Patches
from planning.nbv.rays import segment_blocked


@dataclass(frozen=True)
class SightSpec:
    """What makes a good picture of a patch."""

    nearest_m: float = 3.0
    farthest_m: float = 15.0
    incidence_deg: float = 70.0
    """From the axis direction that a patch faces. Normals smoothed over the map were measured in its place and lost: a
    map of voxels rounds edges off, and more of the pictures planned on it see the true walls at grazing angles. 65 and
    75 degrees are a little worse."""
    tolerance_voxels: float = 2.0
    """How far before the patch the line of sight may end: measured surface is a voxel or two thick, unknown behind."""


@dataclass(frozen=True)
class Sightings:
    """(s) pairs of a patch and a position that sees it, sorted by patch, then position."""

    patch: NDArray[np.int64]
    position: NDArray[np.int64]
    towards_position_enu: Array
    """(s, 3) unit vectors from patch to position."""
    quality: Array
    """(s,) in (0, 1]: 1 at the resolution asked for or better, less in proportion where a pixel covers more."""


def find_sightings(grid: VoxelGrid, patches: Patches, positions_enu_m: Array, spec: SightSpec,
                   sharp_m: float) -> Sightings:
    """All pairs within the distances and the incidence limit, with nothing between them that is not known free.

    sharp_m: distance up to which a picture, taken head on, has the resolution asked for: that times the focal length.
    """
    near = cKDTree(positions_enu_m).query_ball_point(patches.position_enu_m, spec.farthest_m, return_sorted=True)
    patch = np.repeat(np.arange(len(patches)), [len(found) for found in near])
    position = np.fromiter((p for found in near for p in found), dtype=np.int64, count=len(patch))
    offset = positions_enu_m[position] - patches.position_enu_m[patch]
    distance = np.linalg.norm(offset, axis=1)
    towards = offset / np.maximum(distance, 1e-9)[:, None]
    facing = np.einsum("ij,ij->i", towards, patches.normal_enu[patch])
    good = (distance >= spec.nearest_m) & (facing >= math.cos(math.radians(spec.incidence_deg)))
    patch, position, towards, distance, facing = (x[good] for x in (patch, position, towards, distance, facing))
    good = ~_blocked(grid.state, FREE, (positions_enu_m - grid.origin_enu_m) / grid.voxel_m,
                     (patches.position_enu_m - grid.origin_enu_m) / grid.voxel_m, position, patch,
                     spec.tolerance_voxels / np.maximum(facing, 0.5))
    return Sightings(patch[good], position[good], towards[good], np.minimum(1.0, sharp_m * facing / distance)[good])


@nb.njit(cache=True, parallel=True)
def _blocked(state, free, eyes, targets, eye, target, tolerance):  # type: ignore[no-untyped-def]
    result = np.zeros(len(eye), dtype=np.bool_)
    for s in nb.prange(len(eye)):
        result[s] = segment_blocked(state, free, eyes[eye[s]], targets[target[s]], tolerance[s])
    return result
