"""Flights over several waypoints: straight runs from stop to stop, the camera turning on the way.

Waypoints that lie on the straight line between two stops are passed at speed; corners are turned at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from missions.frames import Array, wrap_pi
from planning.trajectories.curve import Curve, State
from planning.trajectories.leg import Leg, Limits

LINE_TOLERANCE_M = 0.05
"""MAVLink rounds positions to about 1 cm, so points this near to a line count as lying on it."""
STRETCH_ROUNDS = 4


@dataclass(frozen=True)
class Via:
    """A point to fly through: position (3,), the camera's yaw and elevation there, whether to come to rest."""

    position: Array
    yaw_rad: float
    elevation_rad: float = 0.0
    stop: bool = True
    settle_s: float = 0.0


@dataclass(frozen=True)
class Flight:
    """Motion of body and camera. `reached_s[i]` is when via i is reached, the camera turned; settling follows."""

    curve: Curve
    reached_s: Array
    turn_s: Array
    """(m,) knots of the camera's turn."""
    yaw_rad: Array
    """(m,) yaw at the knots, unwrapped; linear in between."""
    elevation_rad: Array

    @property
    def duration_s(self) -> float:
        """Settling included."""
        return self.curve.duration_s

    def attitude(self, t_s: float) -> tuple[float, float]:
        """(yaw, elevation) at a time, radians."""
        yaw = float(np.interp(t_s, self.turn_s, self.yaw_rad))
        return wrap_pi(yaw), float(np.interp(t_s, self.turn_s, self.elevation_rad))


def straight_run(start: Array, vias: list[Via]) -> int:
    """How many of these vias one straight run takes: up to the first stop, or the last before a corner."""
    taken = 1
    while taken < len(vias) and not vias[taken - 1].stop and _on_line(start, vias[: taken + 1]):
        taken += 1
    return taken


def fly_run(start: State, yaw_rad: float, elevation_rad: float, vias: list[Via], limits: Limits) -> Flight:
    """One straight run to the last of the vias, at rest there, passing the others at speed.

    The run is stretched where the camera could not turn in time at limits.slew_rad_s.
    """
    yaw = _unwrapped([yaw_rad, *(v.yaw_rad for v in vias)])
    elevation = np.array([elevation_rad, *(v.elevation_rad for v in vias)])
    turn = np.maximum(np.abs(np.diff(yaw)), np.abs(np.diff(elevation))) / limits.slew_rad_s
    leg = Leg(start, vias[-1].position, limits)
    reached = _pass_times(leg, vias)
    for _ in range(STRETCH_ROUNDS):
        spans = np.diff(reached, prepend=0.0)
        if np.all(spans >= turn - 1e-9):
            break
        factor = float(np.max(turn / np.maximum(spans, 1e-6)))
        leg = Leg(start, vias[-1].position, limits, minimum_s=min(leg.duration_s * factor, _longest(turn, leg)))
        reached = _pass_times(leg, vias)
    knots, yaw, elevation = _turns(reached, yaw, elevation, turn)
    end = max(leg.duration_s, float(knots[-1]))
    reached[-1] = end
    whole = Curve.chain([leg, Curve.hold(vias[-1].position, end - leg.duration_s + vias[-1].settle_s)])
    return Flight(whole, reached, knots, yaw, elevation)


def fly_route(start: State, yaw_rad: float, elevation_rad: float, vias: list[Via], limits: Limits) -> Flight:
    """A whole route, run after run."""
    flights: list[Flight] = []
    left = list(vias)
    state = start
    while left:
        n = straight_run(state.position, left)
        flights.append(fly_run(state, yaw_rad, elevation_rad, left[:n], limits))
        yaw_rad, elevation_rad = left[n - 1].yaw_rad, left[n - 1].elevation_rad
        state, left = State.at_rest(flights[-1].curve.end), left[n:]
    return _joined(flights)


def _joined(flights: list[Flight]) -> Flight:
    offsets = np.cumsum([0.0, *(f.duration_s for f in flights[:-1])])
    reached = np.concatenate([f.reached_s + o for f, o in zip(flights, offsets, strict=True)])
    knots = np.concatenate([f.turn_s + o for f, o in zip(flights, offsets, strict=True)])
    yaw = np.unwrap(np.concatenate([f.yaw_rad for f in flights]))
    elevation = np.concatenate([f.elevation_rad for f in flights])
    return Flight(Curve.chain([f.curve for f in flights]), reached, knots, yaw, elevation)


def _on_line(start: Array, vias: list[Via]) -> bool:
    points = np.array([v.position for v in vias])
    span = points[-1] - start
    length = float(np.linalg.norm(span))
    if length < LINE_TOLERANCE_M:
        return False
    along = (points - start) @ span / length
    off = np.linalg.norm(points - start - along[:, None] * span / length, axis=1)
    return bool(np.all(off <= LINE_TOLERANCE_M) and np.all(np.diff(along, prepend=0.0) >= 0.0))


def _pass_times(leg: Leg, vias: list[Via]) -> Array:
    """When the leg is nearest to each via: bisection on the distance flown, which never decreases."""
    span = vias[-1].position - leg.at(0.0)[0]
    length = float(np.linalg.norm(span))
    if length < 1e-6 or len(vias) == 1:
        return np.full(len(vias), leg.duration_s)
    wanted = np.array([(v.position - leg.at(0.0)[0]) @ span / length for v in vias])
    low, high = np.zeros(len(vias)), np.full(len(vias), leg.duration_s)
    for _ in range(50):
        middle = 0.5 * (low + high)
        before = (leg.at(middle)[0] - leg.at(0.0)[0]) @ span / length < wanted
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    high[-1] = leg.duration_s
    return np.asarray(high)


def _turns(reached: Array, yaw: Array, elevation: Array, turn_s: Array) -> tuple[Array, Array, Array]:
    """Knots of the camera's turn: from waypoint to waypoint, later where the slew rate demands it."""
    knots = [0.0]
    for t, least in zip(reached, turn_s, strict=True):
        knots.append(max(float(t), knots[-1] + float(least)))
    return np.array(knots), yaw, elevation


def _longest(turn_s: Array, leg: Leg) -> float:
    return leg.duration_s + 2.0 * float(turn_s.sum())


def _unwrapped(angles_rad: list[float]) -> Array:
    out = [angles_rad[0]]
    for angle in angles_rad[1:]:
        step = wrap_pi(angle - out[-1])
        out.append(out[-1] + (step if math.isfinite(step) else 0.0))
    return np.array(out)
