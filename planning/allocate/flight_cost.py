"""Seconds that flying from view to view takes: what allocation minimises.

A leg is timed from shutter to shutter over the corners of its collision-free way, with the jerk-limited motion that
vehicles fly (trajectories/course.py): blended corners, speed limited at the shutter, the camera turned in time. How
sharply a vehicle turns at a view depends on the views before and after it; the mean over possible turns is taken. So
does how much room it has to turn: the other leg at a view is taken to be as long as the way to the nearest place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from missions.frames import Array
from planning.paths.roadmap import Roadmap
from planning.trajectories import Limits, profile
from planning.trajectories.course import EXACT_M
from planning.trajectories.run import STILL_S

COSINES = np.array([0.8125, 0.4375, 0.0625, -0.3125])
BENDS = np.sqrt((1.0 - COSINES) / 2.0)
"""Sines of half the turns at views that legs are timed with, on average: evenly spread directions but the quarter that
is most nearly a reversal. The mean cosine, 0.25, is that of good tours around structures."""


@dataclass(frozen=True)
class Passing:
    """How the n places of a roadmap are passed; arrays (n,)."""

    yaw_rad: Array
    elevation_rad: Array
    speed_m_s: Array
    """Highest at the shutter; 0 where the vehicle rests."""
    pass_m: Array
    """How far beside a place it may pass."""


def leg_seconds(roadmap: Roadmap, passing: Passing, limits: Limits, corner_pass_m: float) -> Array:
    """(n, n) seconds from place to place, from shutter to shutter; inf where there is no way.

    Corners on the way are cut by corner_pass_m at most. Settling and waiting come on top.
    """
    ways = roadmap.places_enu_m, np.ascontiguousarray(roadmap.corners_enu_m), roadmap.lengths_m
    speed, pass_m = np.minimum(passing.speed_m_s, limits.speed_m_s), np.maximum(passing.pass_m, EXACT_M)
    seconds = np.mean([_legs_s(*ways, speed, pass_m, max(corner_pass_m, EXACT_M), bend, *limits.motion)
                       for bend in BENDS], axis=0)
    yaw = np.abs(np.angle(np.exp(1j * (passing.yaw_rad[:, None] - passing.yaw_rad))))
    turn = np.maximum(yaw, np.abs(passing.elevation_rad[:, None] - passing.elevation_rad))
    return np.asarray(np.maximum(seconds, np.where(turn > 0.0, turn / limits.slew_rad_s + STILL_S, 0.0)))


@njit(cache=True)  # type: ignore[untyped-decorator]
def _legs_s(places: Array, corners: Array, lengths: Array, speed: Array, pass_m: Array, corner_pass_m: float,
            bend: float, v: float, a: float, j: float) -> Array:
    n, most = corners.shape[1], corners.shape[2]
    out = np.full((n, n), np.inf)
    points = np.empty((most + 2, 3))
    at_place = np.empty(n)
    for i in range(n):
        within = profile.lateral_speed_m_s(pass_m[i], a, j) / bend
        near = np.sort(lengths[i])[min(1, n - 1)]
        at_place[i] = min(speed[i] / math.sqrt(1.0 - bend * bend), within, _stoppable_m_s(near, bend, v, a, j))
        out[i, i] = 0.0
    for start in range(n):
        for goal in range(start):
            if lengths[start, goal] == np.inf:
                continue
            count = _way(places[start], corners[start, goal], places[goal], points)
            seconds = _way_s(points[:count], at_place[start], at_place[goal], bend, bend, corner_pass_m, v, a, j)
            out[start, goal] = out[goal, start] = seconds
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _way(start: Array, corners: Array, goal: Array, points: Array) -> int:
    """Write start, corners that are there, and goal into points; how many these are."""
    points[0] = start
    count = 1
    for k in range(len(corners)):
        if not math.isnan(corners[k, 0]):
            points[count] = corners[k]
            count += 1
    points[count] = goal
    return count + 1


@njit(cache=True)  # type: ignore[untyped-decorator]
def _way_s(points: Array, v_start: float, v_goal: float, bend_start: float, bend_goal: float, corner_pass_m: float,
           v: float, a: float, j: float) -> float:
    """Seconds over a polyline (k, 3); bend_start and bend_goal are half-sines of the turns at its ends."""
    n = len(points)
    length, bends, speed = np.empty(n - 1), np.full(n, bend_start), np.full(n, v)
    bends[n - 1] = bend_goal
    for k in range(n - 1):
        length[k] = math.sqrt(((points[k + 1] - points[k]) ** 2).sum())
    speed[0], speed[n - 1] = v_start, v_goal
    for k in range(1, n - 1):
        before = (points[k] - points[k - 1]) / max(length[k - 1], 1e-9)
        across = (points[k + 1] - points[k]) / max(length[k], 1e-9) - before
        bends[k] = max(0.5 * math.sqrt((across * across).sum()), 1e-6)
        speed[k] = min(v, profile.lateral_speed_m_s(corner_pass_m, a, j) / bends[k])
    for k in range(n):
        room = min(length[max(k - 1, 0)], length[min(k, n - 2)])
        speed[k] = min(speed[k], _stoppable_m_s(room, bends[k], v, a, j))
    for k in range(n - 2, -1, -1):
        speed[k] = _reachable_m_s(speed[k + 1], speed[k], length[k], bends[k + 1], bends[k], a, j)
    for k in range(1, n):
        speed[k] = _reachable_m_s(speed[k - 1], speed[k], length[k - 1], bends[k - 1], bends[k], a, j)
    total = 0.0
    for k in range(n - 1):
        half1, half2 = _half_s(speed[k], bends[k], a, j), _half_s(speed[k + 1], bends[k + 1], a, j)
        room = max(length[k] - speed[k] * half1 - speed[k + 1] * half2, 0.0)
        peak = profile.peak_m_s(speed[k], speed[k + 1], room, v, a, j)
        total += half1 + half2 + profile.straight_s(speed[k], speed[k + 1], room, peak, a, j)
    return total


@njit(cache=True)  # type: ignore[untyped-decorator]
def _half_s(speed: float, bend: float, a: float, j: float) -> float:
    return 0.5 * float(profile.ramp_s(2.0 * speed * bend, a, j))


@njit(cache=True)  # type: ignore[untyped-decorator]
def _stoppable_m_s(room_m: float, bend: float, v: float, a: float, j: float) -> float:
    """The highest speed at a corner that leaves room to stop before another of the same kind."""
    low, high = 0.0, v
    for _ in range(20):
        speed = 0.5 * (low + high)
        needed = 2.0 * speed * _half_s(speed, bend, a, j) + profile.ramp_m(speed, 0.0, a, j)
        if needed <= room_m:
            low = speed
        else:
            high = speed
    return low


@njit(cache=True)  # type: ignore[untyped-decorator]
def _reachable_m_s(v_from: float, v_to: float, length: float, bend_from: float, bend_to: float, a: float,
                   j: float) -> float:
    """v_to, or the highest speed below it that the straight from v_from, blends left out, allows."""
    low, high = 0.0, v_to
    taken = v_from * _half_s(v_from, bend_from, a, j)
    if v_to <= v_from or taken + v_to * _half_s(v_to, bend_to, a, j) + profile.ramp_m(v_from, v_to, a, j) <= length:
        return v_to
    for _ in range(20):
        speed = 0.5 * (low + high)
        needed = taken + speed * _half_s(speed, bend_to, a, j) + profile.ramp_m(v_from, speed, a, j)
        if needed <= length:
            low = speed
        else:
            high = speed
    return low
