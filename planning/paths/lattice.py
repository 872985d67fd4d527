"""The shortest way over the lattice of an obstacle field: A*, complete over what the lattice proves clear."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from planning.paths import kernels, search_kernels
from planning.paths.fields import ObstacleField
from planning.paths.refusal import NoPath

NEAR = np.array([(i, j, k) for i in range(-1, 3) for j in range(-1, 3) for k in range(-1, 3)])
"""Lattice points around a point that it may be joined to."""

EDGE_SPARE_M = 1e-3
"""Steps keep this much more, so that whoever looks at pieces of them finds these clear too."""


def lattice_path(field: ObstacleField, ends_enu_m: Array, clearance_m: float, box_enu_m: tuple[Array, Array]) -> Array:
    """(k, 3) waypoints between two ends (2, 3) over lattice points inside a box. Raises NoPath("search")."""
    first, room = _cut_out(field, clearance_m, box_enu_m)
    seeds, seed_m = _joined(field, ends_enu_m[0], clearance_m, first, room.shape)
    exits, exit_m = _joined(field, ends_enu_m[1], clearance_m, first, room.shape)
    starts, ends = (np.ravel_multi_index(tuple(points.T), room.shape) for points in (seeds, exits))
    if not search_kernels.connected(room, clearance_m, starts, ends):
        raise NoPath("search")
    unit = field.voxel_m / search_kernels.AXIS
    start_costs = np.round(seed_m / unit).astype(np.int64)
    cost, came = search_kernels.search(room, clearance_m + EDGE_SPARE_M, field.voxel_m, starts, start_costs,
                                       exits[int(np.argmin(exit_m))])
    reached = cost[tuple(exits.T)]
    if reached.max() < 0:
        raise NoPath("search")
    last = exits[int(np.argmin(np.where(reached < 0, np.inf, reached * unit + exit_m)))]
    inner = field.origin + (first + _corners(search_kernels.walk_back(came, *(int(c) for c in last)))) * field.voxel_m
    return np.concatenate([ends_enu_m[:1], inner, ends_enu_m[1:]])


def _corners(voxels: NDArray[np.int64]) -> NDArray[np.int64]:
    """The points (n, 3) of a way where its direction changes, and its ends."""
    steps = np.diff(voxels, axis=0)
    turns = np.any(steps[1:] != steps[:-1], axis=1)
    return np.asarray(voxels[np.concatenate([[True], turns, [True]])[:len(voxels)]])


def _cut_out(field: ObstacleField, clearance_m: float,
             box_enu_m: tuple[Array, Array]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """The lattice's part inside a box, spheres included: index of its first point, and the clearances."""
    lower, upper = ((corner - field.origin) / field.voxel_m for corner in box_enu_m)
    first = np.clip(np.ceil(lower - 1e-9), 0, field.distance.shape).astype(np.int64)
    last = np.clip(np.floor(upper + 1e-9) + 1, first, field.distance.shape).astype(np.int64)
    room = field.distance[tuple(slice(a, b) for a, b in zip(first, last, strict=True))].copy()
    kernels.lower_by_spheres(room, field.origin + first * field.voxel_m, field.voxel_m, field.spheres,
                             clearance_m + 2.0 * field.voxel_m)
    return first, room


def _joined(field: ObstacleField, point: Array, clearance_m: float, first: NDArray[np.int64],
            shape: tuple[int, ...]) -> tuple[NDArray[np.int64], Array]:
    """Lattice points (n, 3) around a point that can be flown to from there, and how far each is."""
    around = np.floor((point - field.origin) / field.voxel_m).astype(np.int64) - first + NEAR
    around = around[np.all((around >= 0) & (around < np.array(shape)), axis=1)]
    centers = field.origin + (first + around) * field.voxel_m
    clear = field.segments_clear(point, centers, clearance_m) if len(around) else np.zeros(0, dtype=np.bool_)
    return around[clear], np.linalg.norm(centers[clear] - point, axis=1)
