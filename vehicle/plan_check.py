"""Whether a whole plan may be accepted: fence, clearance at its waypoints, energy for it and for the way home."""

from __future__ import annotations

import numpy as np

from missions.frames import Array
from missions.mavlink import Route
from missions.mission import FleetSpec
from vehicle.avoidance import Avoidance
from vehicle.battery import Battery

RESERVE_PERCENT = 5.0
"""What must be left in the battery after the last landing."""
FENCE_TOLERANCE_M = 0.05
"""MAVLink rounds positions to about 1 cm."""


def refusal(route: Route, position_enu_m: Array, home_enu_m: Array, fence: tuple[Array, Array], fleet: FleetSpec,
            threshold_percent: float, avoidance: Avoidance, battery: Battery) -> str:
    """Why the plan is refused, beginning with the kind (empty, fence, clearance, energy); "" when it is accepted."""
    if not route.waypoints:
        return "empty: the plan has no waypoint"
    if battery.level_percent <= threshold_percent:
        return f"energy: the battery is at {battery.level_percent:.1f} %, at or below the threshold"
    points = np.array([w.position_enu_m for w in route.waypoints])
    lower, upper = fence[0] - FENCE_TOLERANCE_M, fence[1] + FENCE_TOLERANCE_M
    for n, point in enumerate(points):
        if np.any(point < lower) or np.any(point > upper):
            return f"fence: waypoint {n} lies outside the geofence"
        if not avoidance.clear(point, point):
            return f"clearance: waypoint {n} is nearer than {fleet.clearance_m} m to what is not known to be free"
    whole = np.concatenate([position_enu_m[None], points, home_enu_m[None]])
    length = float(np.linalg.norm(np.diff(whole, axis=0), axis=1).sum())
    need = battery.cost_percent(length, length / fleet.speed_m_s)
    if battery.level_percent - need < RESERVE_PERCENT:
        return f"energy: the plan takes {need:.1f} % of {battery.level_percent:.1f} %; {RESERVE_PERCENT} % must stay"
    return ""
