"""Is the way clear, and if not, which way is: obstacles from map and range sensor, teammates in space and time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from missions.frames import Array
from missions.mission import FleetSpec
from missions.sensors import fibonacci_directions
from planning.paths import NoPath, ObstacleField, plan_path
from planning.trajectories import Flight
from vehicle.sensor_memory import HIT_RADIUS_M, SensorMemory
from vehicle.teammates import Conflict, Teammates

REPLAN_SPARE_M = 0.15
"""Ways around keep this much more than the clearance, so that the next scan does not at once block them again."""
SEPARATION_SPARE_M = 0.3
"""Planned flights keep this much more than the separation, for what is not yet announced."""
REPLAN_REACH_M = (6.0, 16.0)
"""How far around the direct way a detour is looked for, first and then."""
ESCAPE_STEPS_M = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
BODY_SPARE_M = 0.2
DIRECTIONS = fibonacci_directions(320)
"""In which a way out of a narrow place, or out of a teammate's way, is looked for."""


class Knowledge(NamedTuple):
    """Versions of all that a clear way depends on."""

    map: int
    hits: int
    teammates: int


class Avoidance:
    """One vehicle's idea of where it may go."""

    def __init__(self, memory: SensorMemory, teammates: Teammates, fleet: FleetSpec, fence: tuple[Array, Array],
                 seed: int) -> None:
        self.memory, self.teammates, self._fleet, self._seed = memory, teammates, fleet, seed
        self._lower, self._upper = fence[0] + fleet.clearance_m, fence[1] - fleet.clearance_m
        self.replans = 0

    @property
    def version(self) -> Knowledge:
        """Changes whenever a way that was clear may have become blocked."""
        return Knowledge(self.memory.map_version, self.memory.hit_version, self.teammates.version)

    def clear(self, a_enu_m: Array, b_enu_m: Array) -> bool:
        """Whether the straight way from a to b keeps the clearance from all that is not known to be free."""
        need = self._fleet.clearance_m
        return bool(self.memory.field(a_enu_m, b_enu_m, need).segments_clear(a_enu_m, b_enu_m, need)[0])

    def clear_of_hits(self, a_enu_m: Array, b_enu_m: Array) -> bool:
        """The part of `clear` that can change while the map stays the same."""
        return self.memory.hits_clear(a_enu_m, b_enu_m, self._fleet.clearance_m + HIT_RADIUS_M)

    def conflicts(self, flight: Flight, start_ns: int, now_ns: int,
                  spare_m: float = SEPARATION_SPARE_M) -> list[Conflict]:
        """Teammates that this flight comes too near to."""
        return self.teammates.conflicts(flight, start_ns, now_ns, self._fleet.separation_m + spare_m)

    @property
    def separation_m(self) -> float:
        """How near a place may be to a resting vehicle before it counts as taken."""
        return self._fleet.separation_m + SEPARATION_SPARE_M

    def may_leave(self, a_enu_m: Array, b_enu_m: Array) -> bool:
        """Whether the body itself gets through from a to b, out of a place that became too narrow."""
        return self.memory.hits_clear(a_enu_m, b_enu_m, self._fleet.radius_m + BODY_SPARE_M)

    def way(self, start_enu_m: Array, goal_enu_m: Array, t_ns: int) -> Array:
        """(k, 3) waypoints from start to goal around obstacles and resting teammates. Raises NoPath.

        From a place that has become too narrow, the first waypoint is the nearest one that is wide enough.
        """
        self.replans += 1
        failure = NoPath("search")
        for reach in REPLAN_REACH_M:
            field = self._field(start_enu_m, goal_enu_m, reach, t_ns)
            try:
                return self._way_in(field, start_enu_m, goal_enu_m)
            except NoPath as e:
                failure = e
                if e.reason == "outside":
                    break
        raise failure

    def blocked_by_teammate(self, goal_enu_m: Array, t_ns: int) -> bool:
        """Whether a teammate rests where the goal is."""
        others = self.teammates.resting(t_ns)
        return bool(len(others)) and float(np.linalg.norm(others - goal_enu_m, axis=1).min()) < self.separation_m

    def room_for(self, position_enu_m: Array, place_enu_m: Array, t_ns: int) -> Array | None:
        """Where to go to leave a place to a teammate that wants it; None where there is no room."""
        others = self.teammates.positions(t_ns)
        keep = self._fleet.separation_m + 2.0 * SEPARATION_SPARE_M
        level = DIRECTIONS[np.abs(DIRECTIONS[:, 2]) < 0.5]
        best: tuple[float, Array] | None = None
        for distance in (keep + 0.5, keep + 2.5):
            for goal in place_enu_m + distance * level:
                away = float(np.linalg.norm(goal - position_enu_m))
                if best is not None and away >= best[0]:
                    continue
                far = not len(others) or float(np.linalg.norm(others - goal, axis=1).min()) >= keep
                inside = bool(np.all(goal >= self._lower) and np.all(goal <= self._upper))
                if far and inside and self.clear(position_enu_m, goal):
                    best = (away, goal)
        return None if best is None else best[1]

    def _way_in(self, field: ObstacleField, start: Array, goal: Array) -> Array:
        need = self._fleet.clearance_m + REPLAN_SPARE_M
        if field.clearance_m(goal)[0] < need:
            need = self._fleet.clearance_m
        if field.clearance_m(start)[0] >= need:
            return plan_path(field, start, goal, need, self._lower, self._upper, self._seed)
        wide = self._escape(field, start, need)
        return np.concatenate([start[None], plan_path(field, wide, goal, need, self._lower, self._upper, self._seed)])

    def _escape(self, field: ObstacleField, start: Array, need: float) -> Array:
        """The nearest place with the clearance, along a straight way that does not come nearer to anything."""
        here = float(field.clearance_m(start)[0])
        for distance in ESCAPE_STEPS_M:
            goals = start + distance * DIRECTIONS
            room = field.clearance_m(goals)
            room[np.any(goals < self._lower, axis=1) | np.any(goals > self._upper, axis=1)] = 0.0
            for m in np.argsort(-room, kind="stable"):
                if room[m] < need:
                    break
                if self._may_escape(field, start, goals[m], here):
                    return np.asarray(goals[m])
        raise NoPath("start")

    def _may_escape(self, field: ObstacleField, start: Array, goal: Array, here_m: float) -> bool:
        least = self._fleet.radius_m + BODY_SPARE_M
        if here_m >= least:
            return bool(field.segments_clear(start, goal, max(least, here_m - 0.1))[0])
        # The map calls the very place solid in which the vehicle hovers: there the range sensor alone is believed.
        return self.may_leave(start, goal)

    def _field(self, start: Array, goal: Array, reach_m: float, t_ns: int) -> ObstacleField:
        field = self.memory.field(start, goal, reach_m)
        resting = self.teammates.resting(t_ns)
        # A sphere of this radius turns the clearance into the separation.
        radius = self.separation_m - self._fleet.clearance_m
        return field.with_spheres(resting, max(radius, 0.0)) if len(resting) else field
