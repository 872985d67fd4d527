"""Jerk-limited motion from a state to a point (ruckig, state to state).

All motion is along straight lines: one axis along the line carries the whole limit, so speed, acceleration and jerk
hold as norms, and a leg between two rests never leaves its segment. A change of direction happens at rest.
Source: Berscheid and Kroeger, "Jerk-limited Real-time Trajectory Generation with Arbitrary Target States", RSS 2021.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import ruckig

from missions.frames import Array
from missions.mission import FleetSpec
from planning.trajectories.curve import Curve, State

POINT_TOLERANCE_M = 1e-6
PARALLEL_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Limits:
    """Norms of speed, acceleration and jerk, and the slew rate of yaw and gimbal."""

    speed_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float
    slew_rad_s: float = math.inf

    @classmethod
    def of_fleet(cls, fleet: FleetSpec) -> Limits:
        """The limits of a mission's vehicles."""
        return cls(fleet.speed_m_s, fleet.acceleration_m_s2, fleet.jerk_m_s3, math.radians(fleet.yaw_rate_deg_s))

    @property
    def stopping_distance_m(self) -> float:
        """From full speed to rest, starting at zero acceleration."""
        return 0.5 * self.speed_m_s * float(_ramp_time_s(np.array(self.speed_m_s), self))


class Leg(Curve):
    """From `start` to rest (or to `goal_speed_m_s` in the direction of flight) at `goal`.

    A start that moves along the line to the goal is taken up smoothly; any other motion is braked to rest first.
    `minimum_s` stretches the leg, e.g. until the camera has turned. Raises ValueError when velocity and acceleration
    of the start are not parallel, or the speeds exceed the limits by more than rounding.
    """

    def __init__(self, start: State, goal: Array, limits: Limits, *, goal_speed_m_s: float = 0.0,
                 minimum_s: float = 0.0) -> None:
        goal = np.asarray(goal, dtype=np.float64)
        parts: list[Curve] = []
        spent = 0.0
        direction = _unit(goal - start.position)
        if start.moving and not _points_along(start, direction):
            parts.append(brake(start, limits))
            start, spent = State.at_rest(parts[0].end), parts[0].duration_s
            direction = _unit(goal - start.position)
        rest = max(0.0, minimum_s - spent)
        if direction is None:
            parts.append(Curve.hold(start.position, rest))
        else:
            parts.append(_straight(start, goal, direction, limits, goal_speed_m_s, rest))
        whole = Curve.chain(parts)
        super().__init__(whole._start, whole._p, whole._v, whole._a, whole._j, whole.duration_s)


def brake(start: State, limits: Limits) -> Curve:
    """The quickest stop along the present direction of motion. Raises ValueError as Leg does."""
    direction = _direction_of(start)
    if direction is None:
        return Curve.hold(start.position, 0.0)
    request = _request(start, direction, limits)
    request.control_interface = ruckig.ControlInterface.Velocity
    request.target_velocity = [0.0]
    return _solve(request, start.position, direction)


def leg_time_s(length_m: Array | float, limits: Limits) -> Array:
    """Seconds from rest to rest over a straight leg, closed form, for lengths of any shape."""
    length = np.maximum(np.asarray(length_m, dtype=np.float64), 0.0)
    v, a, j = limits.speed_m_s, limits.acceleration_m_s2, limits.jerk_m_s3
    with_plateau = (-a * a / j + np.sqrt(a**4 / j**2 + 4.0 * a * length)) / 2.0
    without_plateau = np.cbrt(length * length * j / 4.0)
    peak = np.minimum(np.where(length >= 2.0 * a**3 / j**2, with_plateau, without_plateau), v)
    ramp = _ramp_time_s(peak, limits)
    cruise = np.maximum(length - peak * ramp, 0.0)
    return np.asarray(np.where(length > 0.0, 2.0 * ramp + cruise / np.maximum(peak, 1e-12), 0.0))


def _ramp_time_s(peak_m_s: Array, limits: Limits) -> Array:
    """From rest to this speed, acceleration zero at both ends."""
    a, j = limits.acceleration_m_s2, limits.jerk_m_s3
    return np.asarray(np.where(peak_m_s * j >= a * a, peak_m_s / a + a / j, 2.0 * np.sqrt(peak_m_s / j)))


def _straight(start: State, goal: Array, direction: Array, limits: Limits, goal_speed: float,
              minimum_s: float) -> Curve:
    request = _request(start, direction, limits)
    request.target_position = [float(np.dot(goal - start.position, direction))]
    request.target_velocity = [goal_speed]
    request.minimum_duration = minimum_s or None
    return _solve(request, start.position, direction)


def _request(start: State, direction: Array, limits: Limits) -> Any:
    speed, acceleration = float(start.velocity @ direction), float(start.acceleration @ direction)
    request = ruckig.InputParameter(1)
    request.current_position = [0.0]
    request.current_velocity, request.current_acceleration = [speed], [acceleration]
    request.max_velocity = [limits.speed_m_s]
    request.max_acceleration = [limits.acceleration_m_s2]
    request.max_jerk = [limits.jerk_m_s3]
    return request


def _solve(request: Any, origin: Array, direction: Array) -> Curve:
    trajectory = ruckig.Trajectory(1)
    result = ruckig.Ruckig(1).calculate(request, trajectory)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise ValueError(f"no trajectory within the limits: {result}")
    profile = trajectory.profiles[0][0]
    durations = [*profile.brake.t, *profile.t]
    jerks = [*profile.brake.j, *profile.j]
    s, v, a, t = 0.0, request.current_velocity[0], request.current_acceleration[0], 0.0
    pieces = []
    for dt, j in zip(durations, jerks, strict=True):
        if dt > 0.0:
            pieces.append((t, s, v, a, j))
            s, v, a, t = s + dt * (v + dt * (a / 2 + dt * j / 6)), v + dt * (a + dt * j / 2), a + dt * j, t + dt
    if not pieces:
        return Curve.hold(origin, 0.0)
    return Curve.along(origin, direction, np.array(pieces), t)


def _unit(vector: Array) -> Array | None:
    length = float(np.linalg.norm(vector))
    return None if length < POINT_TOLERANCE_M else vector / length


def _direction_of(start: State) -> Array | None:
    fast = float(np.linalg.norm(start.velocity)) >= float(np.linalg.norm(start.acceleration))
    vector = start.velocity if fast else start.acceleration
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        return None
    direction = vector / length
    if not _points_along(start, direction):
        raise ValueError("velocity and acceleration must be parallel: vehicles turn at rest")
    return np.asarray(direction)


def _points_along(start: State, direction: Array | None) -> bool:
    if direction is None:
        return not start.moving
    for vector in (start.velocity, start.acceleration):
        along = float(vector @ direction)
        if float(np.linalg.norm(vector - along * direction)) > PARALLEL_TOLERANCE * max(1.0, abs(along)):
            return False
    return True
