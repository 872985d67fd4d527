"""Motion along a straight line from state to state (ruckig).

One axis along the line carries the whole limit, so speed, acceleration and jerk hold as norms.
Source: Berscheid and Kroeger, "Jerk-limited Real-time Trajectory Generation with Arbitrary Target States", RSS 2021.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import ruckig

from missions.frames import Array
from planning.trajectories.curve import Curve, State
from planning.trajectories.limits import Limits

PARALLEL_TOLERANCE = 1e-6
SPARE_SPEED = 1e-7
"""Share by which a straight may exceed its cruise speed: ruckig finds no way between two speeds at the very limit."""


def straight(origin: Array, direction: Array, length_m: float, from_m_s: float, to_m_s: float, limits: Limits,
             cruise_m_s: float) -> Curve:
    """The quickest way along a unit vector (3,), from speed to speed, no faster than cruise_m_s or either of them.

    Raises ValueError where the length does not suffice for the change of speed.
    """
    request = _request(limits, from_m_s, 0.0)
    request.max_velocity = [max(cruise_m_s, from_m_s, to_m_s) * (1.0 + SPARE_SPEED)]
    request.target_position, request.target_velocity = [length_m], [to_m_s]
    return _solve(request, origin, direction)


def brake(start: State, limits: Limits) -> Curve:
    """The quickest stop along the present direction of motion.

    Raises ValueError where velocity and acceleration are not parallel: a vehicle that turns cannot stop at once.
    """
    direction = _direction_of(start)
    if direction is None:
        return Curve.hold(start.position, 0.0)
    request = _request(limits, float(start.velocity @ direction), float(start.acceleration @ direction))
    request.control_interface = ruckig.ControlInterface.Velocity
    request.target_velocity = [0.0]
    return _solve(request, start.position, direction)


def leg_time_s(length_m: Array | float, limits: Limits) -> Array:
    """Seconds from rest to rest over a straight leg, closed form, for lengths of any shape."""
    length = np.maximum(np.asarray(length_m, dtype=np.float64), 0.0)
    v, a, j = limits.motion
    with_plateau = (-a * a / j + np.sqrt(a**4 / j**2 + 4.0 * a * length)) / 2.0
    without_plateau = np.cbrt(length * length * j / 4.0)
    peak = np.minimum(np.where(length >= 2.0 * a**3 / j**2, with_plateau, without_plateau), v)
    ramp = np.where(peak * j >= a * a, peak / a + a / j, 2.0 * np.sqrt(peak / j))
    cruise = np.maximum(length - peak * ramp, 0.0)
    return np.asarray(np.where(length > 0.0, 2.0 * ramp + cruise / np.maximum(peak, 1e-12), 0.0))


def _request(limits: Limits, speed_m_s: float, acceleration_m_s2: float) -> Any:
    request = ruckig.InputParameter(1)
    request.current_position = [0.0]
    request.current_velocity, request.current_acceleration = [speed_m_s], [acceleration_m_s2]
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
    spans = np.array([*profile.brake.t, *profile.t])
    flown = spans > 0.0
    if not flown.any():
        return Curve.hold(origin, 0.0)
    jerks = np.array([*profile.brake.j, *profile.j])[flown]
    start = State(origin, request.current_velocity[0] * direction, request.current_acceleration[0] * direction)
    return Curve.integrated(start, spans[flown], jerks[:, None] * direction)


def _direction_of(start: State) -> Array | None:
    """Unit vector of the motion, None at rest."""
    speed, push = float(np.linalg.norm(start.velocity)), float(np.linalg.norm(start.acceleration))
    if max(speed, push) < 1e-9:
        return None
    direction = start.velocity / speed if speed >= push else start.acceleration / push
    for vector in (start.velocity, start.acceleration):
        along = float(vector @ direction)
        if float(np.linalg.norm(vector - along * direction)) > PARALLEL_TOLERANCE * max(1.0, abs(along)):
            raise ValueError("velocity and acceleration must be parallel: vehicles do not brake in a bend")
    return np.asarray(direction)
