"""Collision-free legs in space that is known to be free: the map, the teammates and the fence in one place."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from missions.frames import Array
from missions.grid import VoxelGrid
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import geofence
from planning.paths import NoPath, Reach, VoxelField, plan_path, reachable

PLAN_MARGIN_M = 0.1
"""Planned beyond the demanded clearance: MAVLink rounds positions to about 1 cm, vehicles check what arrives."""
TEAMMATE_MARGIN_M = 0.5


@dataclass(frozen=True)
class Airspace:
    """Where vehicles may fly, as known at one moment."""

    field: VoxelField
    clearance_m: float
    separation_m: float
    lower_enu_m: Array
    upper_enu_m: Array

    @classmethod
    def of(cls, grid: VoxelGrid, mission: Mission, site: SiteBrief) -> Airspace:
        """The airspace of a map; unknown is not free."""
        lower, upper = geofence(mission, site)
        return cls(VoxelField.from_grid(grid), mission.fleet.clearance_m + PLAN_MARGIN_M, mission.fleet.separation_m,
                   lower, upper)

    def around(self, start_enu_m: Array, teammates_enu_m: list[Array]) -> VoxelField:
        """The field with a sphere about every place where a teammate is or will hover. A teammate that is already
        near gets a smaller one, so that a start is never inside."""
        wanted = self.separation_m + TEAMMATE_MARGIN_M - self.clearance_m
        spheres = [(mate, min(wanted, float(np.linalg.norm(mate - start_enu_m)) - self.clearance_m - 0.05))
                   for mate in teammates_enu_m]
        kept = [(mate, radius) for mate, radius in spheres if radius > 0.0]
        if not kept:
            return self.field
        return self.field.with_spheres(np.array([m for m, _ in kept]), np.array([r for _, r in kept]))

    def reach(self, start_enu_m: Array, teammates_enu_m: list[Array]) -> Reach:
        """Distances and paths from a start to everywhere."""
        return reachable(self.around(start_enu_m, teammates_enu_m), start_enu_m, self.clearance_m)

    def path(self, start_enu_m: Array, goal_enu_m: Array, teammates_enu_m: list[Array]) -> Array | None:
        """(k, 3) waypoints from start to goal, both included, or None when there is no way through known-free space.

        The quick random search decides most cases; where it gives up, a complete search over the voxels does.
        """
        field = self.around(start_enu_m, teammates_enu_m)
        try:
            return plan_path(field, start_enu_m, goal_enu_m, self.clearance_m, self.lower_enu_m, self.upper_enu_m,
                             _seed(start_enu_m, goal_enu_m))
        except NoPath as refusal:
            if refusal.reason != "search":
                return None
        try:
            return reachable(field, start_enu_m, self.clearance_m).path_to(goal_enu_m)
        except NoPath:
            return None

    def clear_at(self, points_enu_m: Array) -> Array:
        """(n,) bool: places where a vehicle may hover."""
        return np.asarray(self.field.clearance_m(points_enu_m) >= self.clearance_m)


def length_m(path_enu_m: Array) -> float:
    """Length of a path (k, 3)."""
    return float(np.linalg.norm(np.diff(path_enu_m, axis=0), axis=1).sum())


def _seed(start: Array, goal: Array) -> int:
    """The same leg is searched with the same numbers, whenever it is asked for."""
    digest = hashlib.sha256(np.round(np.concatenate([start, goal]), 6).tobytes()).digest()
    return int.from_bytes(digest[:4], "big")
