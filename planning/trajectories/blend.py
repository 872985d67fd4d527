"""Corners flown without stopping.

In the corner's frame, u along d1 + d2 and w along d2 - d1, a vehicle that flies in along d1 and out along d2 at speed v
keeps its velocity along u and changes that along w by 2 v sin(turn / 2). Doing so with one trapezoid or triangle of
acceleration keeps jerk and acceleration within their limits and the speed below v, as norms. The motion begins and ends
v T / 2 from the corner, T being the time of the change, and passes it nearest in the middle, at v cos(turn / 2).
"""

from __future__ import annotations

import math

import numpy as np

from missions.frames import Array
from planning.trajectories import profile
from planning.trajectories.curve import Curve, State
from planning.trajectories.limits import Limits

OUTLINE_M = 1e-3
"""The outline of a blend is at most this far from it."""


def blend(corner: Array, d1: Array, d2: Array, speed_m_s: float, limits: Limits) -> Curve:
    """Around a corner (3,) from direction d1 to d2, unit vectors (3,) that differ."""
    _, a, j = limits.motion
    change = speed_m_s * (d2 - d1)
    size = float(np.linalg.norm(change))
    duration = profile.ramp_s(size, a, j)
    rise = min(a / j, 0.5 * duration)
    spans, jerks = np.array([rise, duration - 2.0 * rise, rise]), np.array([j, 0.0, -j])[:, None] * (change / size)
    keep = spans > 0.0
    start = State(corner - 0.5 * duration * speed_m_s * d1, speed_m_s * d1, np.zeros(3))
    return Curve.integrated(start, spans[keep], jerks[keep])


def outline(curve: Curve, limits: Limits) -> Array:
    """(k, 3) points of a blend; the polyline through them stays within OUTLINE_M of it."""
    pieces = math.ceil(curve.duration_s * math.sqrt(limits.acceleration_m_s2 / (8.0 * OUTLINE_M)))
    return curve.at(np.linspace(0.0, curve.duration_s, max(pieces, 1) + 1))[0]
