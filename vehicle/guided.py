"""Single points on somebody's word: goto, offboard set-points, the climb after a take-off, turning the camera."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

import numpy as np

from missions.frames import Array
from planning.trajectories import Via
from vehicle.pilot import Outcome, Pilot

SAME_POINT_M, SAME_ANGLE_RAD = 0.02, 0.01
ARRIVED_M = 1e-3


class Heading(Enum):
    """What has become of the way to the point."""

    ON_THE_WAY = "on the way"
    THERE = "there"
    BLOCKED = "blocked"


class Guided:
    """The point that the vehicle was told to be at, and the way there. It flies as carefully as on any other leg."""

    def __init__(self, pilot: Pilot) -> None:
        self._pilot = pilot
        self.target: Via | None = None

    def aim(self, position_enu_m: Array, yaw_enu_rad: float, gimbal_elevation_rad: float) -> bool:
        """Be there, looking there; False when that is the target already (commands and set-points are repeated)."""
        target = Via(np.asarray(position_enu_m, dtype=float), yaw_enu_rad, gimbal_elevation_rad)
        if self.target is not None and _same(self.target, target):
            return False
        self.target = target
        return True

    def forget(self) -> None:
        """No point is asked for any more."""
        self.target = None

    def step(self, t_ns: int) -> Heading:
        """At rest: go on towards the target."""
        assert self.target is not None, "only a target is flown to"
        now = self._pilot.body.at(t_ns)
        here = Via(now.state.position, now.yaw_enu_rad, now.gimbal_elevation_rad)
        if np.linalg.norm(here.position - self.target.position) < ARRIVED_M and _same(here, self.target):
            return Heading.THERE
        outcome = self._pilot.go([self.target], t_ns, [self.target.position])
        if outcome is Outcome.BLOCKED:
            return Heading.BLOCKED
        if outcome is Outcome.WAITING:
            self._pilot.make_way(t_ns)
        return Heading.ON_THE_WAY


def free_below(position_enu_m: Array, ground_up_m: float, clearance_m: float,
               clear: Callable[[Array, Array], bool]) -> bool:
    """Whether the vehicle could sink straight down to the ground through what it knows to be free."""
    low = position_enu_m.copy()
    low[2] = ground_up_m + clearance_m
    return bool(position_enu_m[2] <= low[2]) or clear(position_enu_m, low)


def _same(a: Via, b: Via) -> bool:
    turn = np.angle(np.exp(1j * (a.yaw_rad - b.yaw_rad)))
    return (float(np.linalg.norm(a.position - b.position)) < SAME_POINT_M and abs(float(turn)) < SAME_ANGLE_RAD
            and abs(a.elevation_rad - b.elevation_rad) < SAME_ANGLE_RAD)
