"""Runs: flights from rest to rest over several waypoints, corners blended, the camera turning on the way."""

from __future__ import annotations

import numpy as np

from missions.frames import Array, wrap_pi
from planning.trajectories.course import Clear, Course, Via
from planning.trajectories.curve import Curve, State
from planning.trajectories.flight import Flight, joined
from planning.trajectories.limits import Limits

MAX_RUN = 24
"""Waypoints of one run, at most: other vehicles have to wait for the end of what was announced."""
STILL_S = 0.02
"""The camera does not turn for this long around a shutter."""


def run_length(vias: list[Via]) -> int:
    """How many of these vias one run takes: up to the first stop, at most MAX_RUN."""
    return next((n + 1 for n, v in enumerate(vias[:MAX_RUN]) if v.stop), min(len(vias), MAX_RUN))


def fly_run(start: State, yaw_rad: float, elevation_rad: float, vias: list[Via], limits: Limits,
            clear: Clear | None = None) -> Flight:
    """From rest over all vias to rest at the last, in the shortest time.

    Corners are blended, passing within pass_m (at least EXACT_M) of each via, where `clear` says that the polyline
    (k, 3) around the blend is free; else more tightly, or stopping. The camera has turned when a via is passed, and
    does not turn then; stretches on which it could not turn in time are flown more slowly. That the polyline through
    the vias is free is the caller's to know. Raises ValueError when the start is not at rest.
    """
    if start.moving:
        raise ValueError("a run begins at rest")
    yaw = _unwrapped([yaw_rad, *(v.yaw_rad for v in vias)])
    elevation = np.array([elevation_rad, *(v.elevation_rad for v in vias)])
    angle = np.maximum(np.abs(np.diff(yaw)), np.abs(np.diff(elevation)))
    course = Course(start.position, vias, np.where(angle > 0.0, angle / limits.slew_rad_s + STILL_S, 0.0), limits)
    motion = course.motion(clear)
    whole = Curve.chain([motion.curve, Curve.hold(motion.curve.end, vias[-1].settle_s)])
    return Flight(whole, motion.reached_s, _knots(motion.reached_s), np.repeat(yaw, 2)[1:], np.repeat(elevation, 2)[1:],
                  limits, motion.straights_s)


def fly_route(start: State, yaw_rad: float, elevation_rad: float, vias: list[Via], limits: Limits,
              clear: Clear | None = None) -> Flight:
    """A whole route, run after run."""
    flights: list[Flight] = []
    left, state = list(vias), start
    while left:
        n = run_length(left)
        flights.append(fly_run(state, yaw_rad, elevation_rad, left[:n], limits, clear))
        yaw_rad, elevation_rad = left[n - 1].yaw_rad, left[n - 1].elevation_rad
        state, left = State.at_rest(flights[-1].curve.end), left[n:]
    return joined(flights)


def _knots(reached_s: Array) -> Array:
    """When the camera begins and ends to turn: 0, then shortly before and after each via."""
    around = reached_s[:, None] + np.array([-0.5, 0.5]) * STILL_S
    return np.maximum.accumulate(np.concatenate([[0.0], around.ravel()]))


def _unwrapped(angles_rad: list[float]) -> Array:
    """Each angle the short way from the one before."""
    out = [angles_rad[0]]
    for angle in angles_rad[1:]:
        out.append(out[-1] + wrap_pi(angle - out[-1]))
    return np.array(out)
