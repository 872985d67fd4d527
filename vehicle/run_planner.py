"""The longest part of a run that may be launched now: clear of what is solid, of teammates, and of ways asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missions.frames import Array
from planning.trajectories import MAX_RUN, Flight, Limits, State, Via, fly_run
from vehicle.avoidance import Avoidance
from vehicle.right_of_way import RightOfWayRules
from vehicle.simulator import Kinematics
from vehicle.teammates import Conflict

SHORTER = 3
"""So often a run is cut short before what is left of it has to wait."""


@dataclass(frozen=True)
class Run:
    """What came of planning: a flight, or None and who is in the way."""

    flight: Flight | None
    points: list[Array]
    """The vias that it takes, as many as possible."""
    solid: bool
    """Whether not even the first leg is clear of what is solid."""
    conflicts: list[Conflict]


class RunPlanner:
    """Plans runs, and remembers the last one: who waits asks for the same run again and again."""

    def __init__(self, avoidance: Avoidance, rules: RightOfWayRules) -> None:
        self._avoidance, self._rules = avoidance, rules
        self._key: tuple[bytes, Limits, int, int, int] | None = None
        self._clear = 0
        self._points = np.zeros((0, 3))
        self._flights: dict[int, Flight] = {}

    def plan(self, now: Kinematics, vias: list[Via], limits: Limits, t_ns: int) -> Run:
        """From rest to as many of the vias as possible, at rest at the last of them."""
        vias = vias[:MAX_RUN]
        taken = self._clear_legs(now, vias, limits)
        conflicts: list[Conflict] = []
        for _ in range(SHORTER + 1):
            if taken == 0:
                break
            flight = self.flight(now, vias[:taken], limits)
            conflicts = self._avoidance.conflicts(flight, self._points[:taken + 1], t_ns)
            if not conflicts and not self._rules.refuses(flight, t_ns):
                return Run(flight, [v.position for v in vias[:taken]], False, [])
            before_s = min((c.in_s for c in conflicts), default=0.0)
            taken = min(taken - 1, max(1, int(np.count_nonzero(flight.reached_s[:taken] < before_s))))
        return Run(None, [], self._clear == 0, conflicts)

    def flight(self, now: Kinematics, vias: list[Via], limits: Limits) -> Flight:
        """From rest to the last of the vias, blending the corners where there is room."""
        if len(vias) not in self._flights:
            start = State.at_rest(now.state.position)
            self._flights[len(vias)] = fly_run(start, now.yaw_enu_rad, now.gimbal_elevation_rad, vias, limits,
                                               self._avoidance.outline_clear)
        return self._flights[len(vias)]

    def _clear_legs(self, now: Kinematics, vias: list[Via], limits: Limits) -> int:
        """How many legs, one after the other, are clear of what is solid."""
        points = np.array([now.state.position, *(v.position for v in vias)])
        aims = np.array([(now.yaw_enu_rad, now.gimbal_elevation_rad, 0.0, 0.0),
                         *((v.yaw_rad, v.elevation_rad, v.settle_s, v.speed_m_s) for v in vias)])
        version = self._avoidance.version
        dead = len(self._avoidance.teammates.dead())
        key = (points.tobytes() + aims.tobytes(), limits, version.map, version.hits, dead)
        if key != self._key:
            self._key, self._flights, self._points = key, {}, points
            self._clear = self._avoidance.clear_legs(points)
        return self._clear
