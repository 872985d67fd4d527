"""Distances from one start to everywhere, over free voxels: for hundreds of candidate goals at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from planning.paths import kernels, search_kernels
from planning.paths.fields import ObstacleField
from planning.paths.lattice import NEAR
from planning.paths.refusal import NoPath
from planning.paths.replan import straightened

NOWHERE = np.zeros(0, dtype=np.int64)
ESCAPE_M, BLIND_ESCAPE_M = 3.0, 1.0
"""How far a start that has become too narrow may be from a wide enough place; blind: when the map calls it solid."""
ESCAPE_SLACK_M = 0.1
LEAST_ROOM_M = 0.5


@dataclass(frozen=True)
class Reach:
    """What can be reached from a start with a clearance, and how far it is along free voxels.

    Steps go to the 26 neighbours, so a distance is at most 13 % longer than the shortest path around the obstacles.
    """

    field: ObstacleField
    start_enu_m: Array
    clearance_m: float
    distance_m: NDArray[np.float32]
    """(nx + 2, ny + 2, nz + 2) as field.distance; inf where not reached."""
    came: NDArray[np.int8]

    def distance_to(self, goals_enu_m: Array) -> Array:
        """(n,) metres to goals (n, 3), inf where unreachable; the straight line where it is clear."""
        goals = np.asarray(goals_enu_m, dtype=np.float64).reshape(-1, 3)
        straight = np.linalg.norm(goals - self.start_enu_m, axis=1)
        clear = self.field.segments_clear(np.broadcast_to(self.start_enu_m, goals.shape), goals, self.clearance_m)
        out = np.where(clear, straight, np.inf)
        for m in np.flatnonzero(~clear):
            out[m] = self._join(goals[m])[1]
        return out

    def path_to(self, goal_enu_m: Array) -> Array:
        """(k, 3) waypoints from the start to a goal, both included. Raises NoPath."""
        goal = np.asarray(goal_enu_m, dtype=np.float64)
        if self.field.segments_clear(self.start_enu_m, goal, self.clearance_m)[0]:
            return np.stack([self.start_enu_m, goal])
        voxel, length = self._join(goal)
        if not np.isfinite(length):
            raise NoPath("search")
        inner = self.field.origin + search_kernels.walk_back(self.came, *(int(c) for c in voxel)) * self.field.voxel_m
        if self.narrow:
            wide = straightened(self.field, np.concatenate([inner, goal[None]]), self.clearance_m)
            return np.concatenate([self.start_enu_m[None], wide])
        return straightened(self.field, np.concatenate([self.start_enu_m[None], inner, goal[None]]), self.clearance_m)

    @property
    def narrow(self) -> bool:
        """Whether the start itself lacks the clearance; paths then begin with the straight way out of there."""
        return bool(self.field.clearance_m(self.start_enu_m)[0] < self.clearance_m)

    def _join(self, goal: Array) -> tuple[NDArray[np.int64], float]:
        """The reached voxel through which the goal is nearest, and the distance."""
        voxels, centers = _around(self.field, goal, NEAR)
        far = np.linalg.norm(centers - goal, axis=1) + self.distance_m[tuple(voxels.T)]
        for m in np.argsort(far, kind="stable"):
            if not np.isfinite(far[m]):
                break
            if self.field.segments_clear(centers[m], goal, self.clearance_m)[0]:
                return voxels[m], float(far[m])
        return np.zeros(3, dtype=np.int64), np.inf


def reachable(field: ObstacleField, start_enu_m: Array, clearance_m: float) -> Reach:
    """Search from a start (3,).

    A start that lacks the clearance (the map changed around a hovering vehicle) is left straight for wide enough
    voxels nearby, never coming nearer to anything; where there is none, nothing is reachable.
    """
    start = np.asarray(start_enu_m, dtype=np.float64)
    room = field.distance
    if len(field.spheres):
        room = room.copy()
        kernels.lower_by_spheres(room, field.origin, field.voxel_m, field.spheres, clearance_m + 2.0 * field.voxel_m)
    voxels, centers, clear = _seeds(field, start, clearance_m)
    seeds = np.ravel_multi_index(tuple(voxels[clear].T), room.shape)
    unit = field.voxel_m / search_kernels.AXIS
    costs = np.round(np.linalg.norm(centers[clear] - start, axis=1) / unit).astype(np.int64)
    cost, came = search_kernels.search(room, clearance_m, field.voxel_m, seeds.astype(np.int64), costs, NOWHERE)
    distance = np.where(cost < 0, np.float32(np.inf), cost * np.float32(unit))
    return Reach(field, start, clearance_m, distance, came)


def _seeds(field: ObstacleField, start: Array, need_m: float) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
    """Voxels (n, 3) that the search may begin with, their centres, and which of them can be flown to."""
    here = float(field.clearance_m(start)[0])
    if here >= need_m:
        voxels, centers = _around(field, start, NEAR)
        return voxels, centers, field.segments_clear(np.broadcast_to(start, centers.shape), centers, need_m)
    seeing = here >= LEAST_ROOM_M
    limit_m = ESCAPE_M if seeing else BLIND_ESCAPE_M
    reach = int(limit_m / field.voxel_m)
    cube = np.stack(np.meshgrid(*[np.arange(-reach, reach + 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    voxels, centers = _around(field, start, cube)
    clear = (field.clearance_m(centers) >= need_m) & (np.linalg.norm(centers - start, axis=1) <= limit_m)
    least = here - ESCAPE_SLACK_M if seeing else 0.0
    clear[clear] = field.segments_clear(np.broadcast_to(start, (int(clear.sum()), 3)), centers[clear], least)
    return voxels, centers, clear


def _around(field: ObstacleField, point: Array, offsets: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    base = np.floor((point - field.origin) / field.voxel_m).astype(np.int64)
    voxels = base + offsets
    voxels = voxels[np.all((voxels >= 0) & (voxels < np.array(field.distance.shape)), axis=1)]
    return voxels, field.origin + voxels * field.voxel_m
