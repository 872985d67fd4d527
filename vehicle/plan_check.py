"""Whether a whole plan may be accepted: fence, clearance where it must be, energy for it and for the way home."""

from __future__ import annotations

import numpy as np

from missions.frames import Array
from missions.mavlink import Route
from missions.mission import BatterySpec, FleetSpec
from planning.trajectories import Limits
from planning.trajectories.energy import stops_percent
from vehicle.avoidance import Avoidance
from vehicle.battery import Battery
from vehicle.geofence import FENCE_TOLERANCE_M, Geofence
from vehicle.teammates import LOST_TEAMMATE
from vehicle.way_home import WayHome


def refusal(route: Route, position_enu_m: Array, fence: Geofence, fleet: FleetSpec, spec: BatterySpec,
            avoidance: Avoidance, battery: Battery, way_home: WayHome) -> str:
    """Why the plan is refused, beginning with the kind (empty, fence, clearance, energy); "" when it is accepted."""
    if not route.waypoints:
        return "empty: the plan has no waypoint"
    if battery.level_percent <= spec.threshold_percent:
        return f"energy: the battery is at {battery.level_percent:.1f} %, at or below the threshold"
    points = np.array([w.position_enu_m for w in route.waypoints])
    inside = fence.room_m(points) >= -FENCE_TOLERANCE_M
    for n, (waypoint, point) in enumerate(zip(route.waypoints, points, strict=True)):
        if not inside[n]:
            return f"fence: waypoint {n} lies outside the geofence"
        # corners on the way are advice: what stands there in truth is gone around
        if (waypoint.stop or waypoint.view_id is not None) and not avoidance.clear(point, point):
            if avoidance.beside_dead(point):
                return f"clearance: waypoint {n} is beside {LOST_TEAMMATE}"
            return f"clearance: waypoint {n} is nearer than {fleet.clearance_m} m to what is not known to be free"
    settle_s = np.array([w.settle_s for w in route.waypoints])
    legs = stops_percent(battery.energy, np.concatenate([position_enu_m[None], points]), settle_s,
                         Limits.of_fleet(fleet))
    need = float(np.max(np.cumsum(legs) + way_home.percent(points)))
    if battery.level_percent - need < spec.reserve_percent:
        return (f"energy: the plan and the way home take {need:.1f} % of {battery.level_percent:.1f} %; "
                f"{spec.reserve_percent:g} % must stay")
    return ""
