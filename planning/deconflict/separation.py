"""How near two tracks come: exact between the samples' chords, for all pairs of instants within a window."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from missions.frames import Array

NEVER = -1


@njit(cache=True)  # type: ignore[untyped-decorator]
def first_approach(a: Array, b: Array, window: int, separation_m: float) -> int:
    """The first chord of polyline a (n, 3) that comes nearer than separation_m to a chord of b (m, 3) that is at most
    `window` chords earlier or later; NEVER when none does. Chord n - 1 is the rest at the end, which lasts for ever.

    Samples of a and b are taken at the same instants. With a window, a and b stay apart even when one of them is late
    by that much: each may stop at any time and the other has time to stop as well.
    """
    limit2 = separation_m * separation_m
    last_a, last_b = a.shape[0] - 1, b.shape[0] - 1
    for i in range(last_a + 1):
        i1 = min(i + 1, last_a)
        length = _apart(a[i], a[i1])
        until = last_b if i == last_a else min(last_b, i + window)
        for j in range(min(max(0, i - window), last_b), until + 1):
            j1 = min(j + 1, last_b)
            reach = length + _apart(b[j], b[j1]) + separation_m
            if _apart(a[i], b[j]) < reach and _chords_apart2(a[i], a[i1], b[j], b[j1]) < limit2:
                return i
    return NEVER


@njit(cache=True)  # type: ignore[untyped-decorator]
def meeting(mine: Array, theirs: Array, window: int, separation_m: float, way: Array) -> tuple[int, bool]:
    """(chord of mine (n, 3) at which it comes too near to theirs (m, 3) or NEVER, whether theirs ends in the way of
    mine). A way (k, 3) may not pass where theirs ends either, whenever that is; (0, 3) for none.

    Who is too near at the beginning may only move apart.
    """
    gap = _apart(mine[0], theirs[0])
    end = theirs[-1:]
    to_end = _apart(mine[0], end[0])
    at = first_approach(mine, theirs, window, separation_m if gap >= separation_m else gap - 1e-6)
    limit = separation_m if to_end >= separation_m else to_end - 1e-6
    rests = first_approach(mine if way.shape[0] == 0 else way, end, 0, limit) != NEVER
    if at == NEVER and way.shape[0] > 0 and rests:
        at = 0
    return at, rests


@njit(cache=True)  # type: ignore[untyped-decorator]
def _apart(p: Array, q: Array) -> float:
    return math.sqrt((p[0] - q[0])**2 + (p[1] - q[1])**2 + (p[2] - q[2])**2)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _chords_apart2(p: Array, p1: Array, q: Array, q1: Array) -> float:
    """Squared distance of two segments (Ericson, Real-Time Collision Detection, 2005, section 5.1.9)."""
    d1d1 = d2d2 = d1r = d2r = d1d2 = 0.0
    for c in range(3):
        u, v, r = p1[c] - p[c], q1[c] - q[c], p[c] - q[c]
        d1d1, d2d2, d1r, d2r, d1d2 = d1d1 + u * u, d2d2 + v * v, d1r + u * r, d2r + v * r, d1d2 + u * v
    s = t = 0.0
    if d1d1 <= 1e-12:
        t = min(1.0, max(0.0, d2r / d2d2)) if d2d2 > 1e-12 else 0.0
    elif d2d2 <= 1e-12:
        s = min(1.0, max(0.0, -d1r / d1d1))
    else:
        flat = d1d1 * d2d2 - d1d2 * d1d2
        s = min(1.0, max(0.0, (d1d2 * d2r - d1r * d2d2) / flat)) if flat > 1e-12 else 0.0
        t = (d1d2 * s + d2r) / d2d2
        if t < 0.0:
            t, s = 0.0, min(1.0, max(0.0, -d1r / d1d1))
        elif t > 1.0:
            t, s = 1.0, min(1.0, max(0.0, (d1d2 - d1r) / d1d1))
    total = 0.0
    for c in range(3):
        gap = (p[c] + s * (p1[c] - p[c])) - (q[c] + t * (q1[c] - q[c]))
        total += gap * gap
    return total


def distance_to_polyline_m(points: Array, polyline: Array) -> Array:
    """(n,) metres from points (n, 3) to a polyline (k, 3), k at least 1."""
    points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    return np.asarray(_to_polyline(points, np.ascontiguousarray(polyline, dtype=np.float64)))


@njit(cache=True)  # type: ignore[untyped-decorator]
def _to_polyline(points: Array, line: Array) -> Array:
    out = np.empty(points.shape[0])
    for n in range(points.shape[0]):
        best = math.inf
        for k in range(max(1, line.shape[0] - 1)):
            other = line[min(k + 1, line.shape[0] - 1)]
            best = min(best, _chords_apart2(points[n], points[n], line[k], other))
        out[n] = math.sqrt(best)
    return out
