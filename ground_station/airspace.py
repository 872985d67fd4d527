"""Collision-free legs in space that is known to be free: the map, the teammates and the fence in one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ground_station.obstacles import NO_HITS
from ground_station.prior import Prior
from missions.frames import Array
from missions.grid import VoxelGrid
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import fence_limit
from missions.sensors import HIT_RADIUS_M, RANGE_DIRECTIONS
from planning.paths import NoPath, ObstacleField, Reach, VoxelField, plan_path, reachable

PLAN_MARGIN_M = 0.1
"""Planned beyond the demanded clearance: MAVLink rounds positions to about 1 cm, vehicles check what arrives."""
TEAMMATE_MARGIN_M = 0.5
ESCAPE_STEPS_M = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
LEAST_ESCAPE_M = 0.5


@dataclass(frozen=True)
class Airspace:
    """Where vehicles may fly, as known at one moment."""

    field: ObstacleField
    clearance_m: float
    separation_m: float
    lower_enu_m: Array
    upper_enu_m: Array

    @classmethod
    def of(cls, grid: VoxelGrid, mission: Mission, site: SiteBrief, prior: Prior | None = None,
           hits_enu_m: Array = NO_HITS) -> Airspace:
        """The airspace of a map, where unknown is not free; or that of the prior model, where there is one. hits_enu_m:
        (n, 3) what stands in it all the same."""
        lower, upper = fence_limit(mission, site)
        field: ObstacleField = VoxelField.from_grid(grid) if prior is None else prior.field
        return cls(field.with_spheres(hits_enu_m, HIT_RADIUS_M), mission.fleet.clearance_m + PLAN_MARGIN_M,
                   mission.fleet.separation_m, lower, upper)

    def around(self, start_enu_m: Array, teammates_enu_m: list[Array]) -> ObstacleField:
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
        return self._reach(self.around(start_enu_m, teammates_enu_m), start_enu_m)

    def path(self, start_enu_m: Array, goal_enu_m: Array, teammates_enu_m: list[Array]) -> Array:
        """(k, 3) waypoints from start to goal, both included, through space known to be free. Raises NoPath, which says
        why there are none."""
        field, known = self.around(start_enu_m, teammates_enu_m), self.known_way(start_enu_m, goal_enu_m)
        if known is not None and field.segments_clear(known[:-1], known[1:], self.clearance_m).all():
            return known
        if field.clearance_m(start_enu_m)[0] >= self.clearance_m:
            return plan_path(field, start_enu_m, goal_enu_m, self.clearance_m, self.lower_enu_m, self.upper_enu_m)
        if field.clearance_m(goal_enu_m)[0] < self.clearance_m:
            raise NoPath("goal")
        return joined(start_enu_m, self._reach(field, start_enu_m).path_to(goal_enu_m))

    def known_way(self, start_enu_m: Array, goal_enu_m: Array) -> Array | None:
        """(k, 3) waypoints that are flown without a search where they keep the clearance; None when there are none."""
        return None

    def _reach(self, field: ObstacleField, start_enu_m: Array) -> Reach:
        """From the start, by whichever wide place around it leads on; where none is near, from the nearest."""
        reach = reachable(field, start_enu_m, self.clearance_m)
        if np.isfinite(reach.distance_m).any():
            return reach
        return reachable(field, self.wide_place(field, start_enu_m), self.clearance_m)

    def wide_place(self, field: ObstacleField, start_enu_m: Array) -> Array:
        """The start itself when it has the clearance. A newer map may have taken it away where a vehicle hovers; then
        the nearest place that has it, along a straight way that does not come nearer to anything (the vehicle, which
        has a range sensor, decides whether it flies there). The start when there is no such place."""
        here = float(field.clearance_m(start_enu_m)[0])
        if here >= self.clearance_m:
            return start_enu_m
        for distance in ESCAPE_STEPS_M:
            places = start_enu_m + distance * RANGE_DIRECTIONS
            room = field.clearance_m(places)
            keep = max(LEAST_ESCAPE_M, here - 0.1) if here >= LEAST_ESCAPE_M else 0.0
            for n in np.argsort(-room, kind="stable"):
                if room[n] < self.clearance_m:
                    break
                if field.segments_clear(start_enu_m, places[n], keep)[0]:
                    return np.asarray(places[n])
        return start_enu_m

    def outline_clear(self, way_enu_m: Array) -> bool:
        """Whether a vehicle, which does without the margin of plans, finds a polyline (k, 3) around a blend clear."""
        need = self.clearance_m - PLAN_MARGIN_M
        return bool(self.field.segments_clear(way_enu_m[:-1], way_enu_m[1:], need).all())

    def clear_at(self, points_enu_m: Array) -> Array:
        """(n,) bool: places where a vehicle may hover."""
        return np.asarray(self.field.clearance_m(points_enu_m) >= self.clearance_m)


def joined(start_enu_m: Array, path_enu_m: Array) -> Array:
    """The path with the start before it, when it begins elsewhere."""
    return path_enu_m if np.array_equal(path_enu_m[0], start_enu_m) else np.concatenate([start_enu_m[None], path_enu_m])
