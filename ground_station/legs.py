"""Waypoints of exploration legs: pictures spread along a path, the camera turning on the way."""

from __future__ import annotations

import numpy as np

from missions.camera import Pose
from missions.frames import Array, wrap_pi
from missions.mavlink import Waypoint

KEY_SETTLE_S = 0.2
SAME_PLACE_M = 0.05
COLUMN_ELEVATION_RAD = 0.15
"""Slightly upwards, so that the ground does not fill the first pictures."""


def picture_leg(path_enu_m: Array, start: Pose, goal: Pose, frames: int, first_view_id: int) -> list[Waypoint]:
    """Waypoints along a path (k, 3) with `frames` pictures, the last one the key view at rest at the goal.

    Position advances evenly along the path; yaw and elevation turn linearly with it, as in MACARONS. Corners are
    waypoints without a picture. A path without length gives the key view alone.
    """
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path_enu_m, axis=0), axis=1))])
    if along[-1] < SAME_PLACE_M:
        return [_waypoint(path_enu_m[-1], goal.yaw_enu_rad, goal.elevation_rad, first_view_id, True)]
    shots = {along[-1] * ((k + 1) / frames): first_view_id + k for k in range(frames)}
    stations = sorted({*along[1:-1].tolist(), *shots})
    turn = wrap_pi(goal.yaw_enu_rad - start.yaw_enu_rad)
    out = []
    for s in stations:
        f = s / along[-1]
        position = np.array([np.interp(s, along, path_enu_m[:, axis]) for axis in range(3)])
        yaw = wrap_pi(start.yaw_enu_rad + f * turn)
        elevation = start.elevation_rad + f * (goal.elevation_rad - start.elevation_rad)
        out.append(_waypoint(position, yaw, elevation, shots.get(s), s == stations[-1]))
    return out


def column_leg(pad_enu_m: Array, heights_enu_m: tuple[float, float], yaw_enu_rad: float, frames: int,
               first_view_id: int) -> list[Waypoint]:
    """Pictures from the first to the second height (ENU) over a pad; one alone is taken at the second."""
    heights = np.linspace(*heights_enu_m, frames) if frames > 1 else np.array([heights_enu_m[1]])
    places = [np.array([pad_enu_m[0], pad_enu_m[1], h]) for h in heights]
    return [_waypoint(p, wrap_pi(yaw_enu_rad), COLUMN_ELEVATION_RAD, first_view_id + k, k == frames - 1)
            for k, p in enumerate(places)]


def _waypoint(position: Array, yaw: float, elevation: float, view_id: int | None, stop: bool) -> Waypoint:
    x, y, z = (float(c) for c in position)
    return Waypoint(position_enu_m=(x, y, z), yaw_enu_rad=yaw, gimbal_elevation_rad=elevation, view_id=view_id,
                    stop=stop, settle_s=KEY_SETTLE_S if stop else 0.0)
