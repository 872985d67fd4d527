"""Closed forms of jerk-limited speed changes along a line, and the speeds at the nodes of a run that make it shortest.

A ramp changes the speed by a trapezoid or triangle of acceleration, zero at both ends; a straight is a ramp, a cruise
and a ramp. The speeds are found by dynamic programming over levels, which are then refined around the best ones.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from missions.frames import Array

LEVELS, REFINEMENTS = 8, 3
"""Speeds at corners are found to within 1 %: speed / (LEVELS - 1) / 4**(REFINEMENTS - 1)."""
CREEP_M_S = 0.05
"""Straights are not stretched below this speed."""
SLACK = 1e-9
"""Share of a straight that stays unused, so that rounding does not make it too short."""


@njit(cache=True)  # type: ignore[untyped-decorator]
def ramp_s(change_m_s: float, a: float, j: float) -> float:
    """Seconds of a change of speed, acceleration zero at both ends."""
    if change_m_s * j >= a * a:
        return change_m_s / a + a / j
    return 2.0 * math.sqrt(change_m_s / j)


@njit(cache=True)  # type: ignore[untyped-decorator]
def ramp_m(v1: float, v2: float, a: float, j: float) -> float:
    """Metres of the change of speed from v1 to v2."""
    return 0.5 * (v1 + v2) * float(ramp_s(abs(v2 - v1), a, j))


@njit(cache=True)  # type: ignore[untyped-decorator]
def peak_m_s(v1: float, v2: float, length: float, v: float, a: float, j: float) -> float:
    """Highest speed, at most v, on the way from v1 to v2 (regula falsi after Dowell and Jarratt, 1971)."""
    low, high = max(v1, v2), v
    over_low = ramp_m(v1, low, a, j) + ramp_m(low, v2, a, j) - length
    over_high = ramp_m(v1, high, a, j) + ramp_m(high, v2, a, j) - length
    if over_high <= 0.0 or high <= low:
        return max(low, high)
    if over_low >= 0.0:
        return low
    side = 0
    for _ in range(40):
        p = (low * over_high - high * over_low) / (over_high - over_low)
        over = ramp_m(v1, p, a, j) + ramp_m(p, v2, a, j) - length
        if over > 0.0:
            if side == 1:
                over_low *= 0.5
            high, over_high, side = p, over, 1
        else:
            if side == -1:
                over_high *= 0.5
            low, over_low, side = p, over, -1
        if high - low < 1e-9 or abs(over) < 1e-10:
            break
    return low


@njit(cache=True)  # type: ignore[untyped-decorator]
def straight_s(v1: float, v2: float, length: float, cruise: float, a: float, j: float) -> float:
    """Seconds from v1 to v2 over a length, cruising at a speed that is at least both."""
    rest = length - ramp_m(v1, cruise, a, j) - ramp_m(cruise, v2, a, j)
    held = max(rest, 0.0) / cruise if cruise > 0.0 else 0.0
    return float(ramp_s(cruise - v1, a, j) + ramp_s(cruise - v2, a, j) + held)


@njit(cache=True)  # type: ignore[untyped-decorator]
def cruise_for(v1: float, v2: float, length: float, least_s: float, v: float, a: float, j: float) -> float:
    """Cruise speed of the quickest straight that takes at least least_s; negative where there is none.

    Where one end is a rest there always is one: what CREEP_M_S does not stretch is waited there.
    """
    high = float(peak_m_s(v1, v2, length, v, a, j))
    low = max(v1, v2, min(high, CREEP_M_S))
    if straight_s(v1, v2, length, high, a, j) >= least_s:
        return high
    if straight_s(v1, v2, length, low, a, j) < least_s:
        return -1.0 if v1 > 0.0 and v2 > 0.0 else low
    for _ in range(60):
        p = 0.5 * (low + high)
        if straight_s(v1, v2, length, p, a, j) >= least_s:
            low = p
        else:
            high = p
    return low


@njit(cache=True)  # type: ignore[untyped-decorator]
def deviation_m(lateral_m_s: float, a: float, j: float) -> float:
    """How far a blend (blend.py) passes from its corner; lateral_m_s is v sin(turn / 2).

    With m the lateral speed: m²/2a + a³/24j² where the acceleration a is reached, else m sqrt(2m/j) / 3.
    """
    if 2.0 * lateral_m_s * j >= a * a:
        return lateral_m_s * lateral_m_s / (2.0 * a) + a**3 / (24.0 * j * j)
    return lateral_m_s * math.sqrt(2.0 * lateral_m_s / j) / 3.0


@njit(cache=True)  # type: ignore[untyped-decorator]
def lateral_speed_m_s(deviation: float, a: float, j: float) -> float:
    """The inverse of deviation_m."""
    if deviation >= a**3 / (6.0 * j * j):
        return math.sqrt(2.0 * a * (deviation - a**3 / (24.0 * j * j)))
    return float((4.5 * j * deviation * deviation) ** (1.0 / 3.0))


@njit(cache=True)  # type: ignore[untyped-decorator]
def fitting_speed_m_s(room_m: float, bend: float, a: float, j: float) -> float:
    """The speed whose blend takes room_m of either straight; bend is sin(turn / 2)."""
    triangle = float((room_m * room_m * j / (2.0 * bend)) ** (1.0 / 3.0))
    if 2.0 * triangle * bend * j < a * a:
        return triangle
    return (math.sqrt(a * a / (4.0 * j * j) + 4.0 * bend * room_m / a) - a / (2.0 * j)) * a / (2.0 * bend)


@njit(cache=True)  # type: ignore[untyped-decorator]
def plan_speeds(highest: Array, bend: Array, length: Array, least_s: Array, beyond: Array, v: float, a: float,
                j: float) -> Array:
    """(n,) speeds at the nodes of a run, at rest at both ends, for the least total time.

    highest (n,): greatest speed at each node. bend (n,): sine of half the turn. length (n - 1,): from node to node,
    corners included. least_s (n - 1,): what a stretch must take at least, from the middle of one blend to the middle
    of the next. beyond (n,): how much farther the straight goes on after a node that is no corner. After a corner the
    vehicle can always brake to rest on the straight that follows.
    """
    n = len(highest)
    best = np.zeros(n)
    for refinement in range(REFINEMENTS):
        levels = np.zeros((n, LEVELS))
        for i in range(1, n - 1):
            step = highest[i] / (LEVELS - 1) / 4.0**refinement
            for k in range(LEVELS):
                middle = best[i] + (k - LEVELS // 2) * step
                levels[i, k] = k * step if refinement == 0 else min(max(middle, 0.0), highest[i])
        best = _best_levels(levels, bend, length, least_s, beyond, v, a, j)
    return best


@njit(cache=True)  # type: ignore[untyped-decorator]
def _best_levels(levels: Array, bend: Array, length: Array, least_s: Array, beyond: Array, v: float, a: float,
                 j: float) -> Array:
    n, m = levels.shape
    cost = np.full((n, m), np.inf)
    came = np.zeros((n, m), np.int64)
    cost[0, 0] = 0.0
    for i in range(n - 1):
        for k in range(m):
            if cost[i, k] == np.inf:
                continue
            v1 = levels[i, k]
            half1 = 0.5 * ramp_s(2.0 * v1 * bend[i], a, j)
            for h in range(m):
                v2 = levels[i + 1, h]
                half2 = 0.5 * ramp_s(2.0 * v2 * bend[i + 1], a, j)
                room = length[i] - v1 * half1 - v2 * half2
                if not _passable(v1, v2, bend[i], room, beyond[i + 1], length[i], a, j):
                    continue
                cruise = cruise_for(v1, v2, room, least_s[i] - half1 - half2, v, a, j)
                if cruise < 0.0:
                    continue
                spent = max(half1 + half2 + straight_s(v1, v2, room, cruise, a, j), least_s[i])
                if cost[i, k] + spent < cost[i + 1, h]:
                    cost[i + 1, h], came[i + 1, h] = cost[i, k] + spent, k
    out = np.zeros(n)
    k = 0
    for i in range(n - 1, 0, -1):
        k = came[i, k]
        out[i - 1] = levels[i - 1, k]
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _passable(v1: float, v2: float, bend1: float, room: float, beyond: float, length: float, a: float,
              j: float) -> bool:
    """Whether v1 becomes v2 on this straight, and after a corner rest before the next."""
    usable = room - SLACK * length
    if ramp_m(v1, v2, a, j) > usable and (v1 > 0.0 or v2 > 0.0):
        return False
    return v1 == 0.0 or bend1 == 0.0 or bool(ramp_m(v1, 0.0, a, j) <= usable + beyond)


@njit(cache=True)  # type: ignore[untyped-decorator]
def integrate(p: Array, v: Array, a: Array, spans_s: Array, jerks: Array) -> tuple[Array, Array, Array, Array]:
    """Start times (n,), positions, velocities and accelerations (n, 3) of pieces of constant jerk (n, 3)."""
    n = len(spans_s)
    start, position, velocity, acceleration = np.zeros(n), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    for axis in range(3):
        position[0, axis], velocity[0, axis], acceleration[0, axis] = p[axis], v[axis], a[axis]
    for i in range(1, n):
        dt = spans_s[i - 1]
        start[i] = start[i - 1] + dt
        for axis in range(3):
            q, w, b, j = position[i - 1, axis], velocity[i - 1, axis], acceleration[i - 1, axis], jerks[i - 1, axis]
            position[i, axis] = q + dt * (w + dt * (b / 2.0 + dt * j / 6.0))
            velocity[i, axis] = w + dt * (b + dt * j / 2.0)
            acceleration[i, axis] = b + dt * j
    return start, position, velocity, acceleration


@njit(cache=True)  # type: ignore[untyped-decorator]
def crossing_s(start_s: Array, p: Array, v: Array, a: Array, j: Array, from_s: float, to_s: float, origin: Array,
               direction: Array, wanted_m: float) -> float:
    """When motion along a direction has come wanted_m from the origin, between two times: bisection."""
    low, high = from_s, to_s
    for _ in range(60):
        t = 0.5 * (low + high)
        i = max(int(np.searchsorted(start_s, t, side="right")) - 1, 0)
        dt = t - start_s[i]
        along = 0.0
        for axis in range(3):
            x = p[i, axis] + dt * (v[i, axis] + dt * (a[i, axis] / 2.0 + dt * j[i, axis] / 6.0))
            along += (x - origin[axis]) * direction[axis]
        if along < wanted_m:
            low = t
        else:
            high = t
    return high
