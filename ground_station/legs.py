"""Waypoints of exploration and survey legs: pictures spread along a path, or taken at given views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from missions.camera import Pose, View
from missions.frames import Array, wrap_pi
from missions.mavlink import Waypoint

KEY_SETTLE_S = 0.2
SAME_PLACE_M = 0.05
CORNER_PASS_M = 0.5
"""How far corners between survey views may be cut; the vehicle stops at those where clearance does not allow it."""
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


@dataclass(frozen=True)
class Shooting:
    """How survey pictures are taken: at rest for settle_s, or in passing, pass_m beside the view at most, at
    speed_m_s(view) or slower."""

    stop: bool
    settle_s: float
    pass_m: float
    speed_m_s: Mapping[int, float]
    """By view id."""


def survey_leg(paths_enu_m: list[Array], views: list[View], shooting: Shooting) -> list[Waypoint]:
    """Waypoints over survey views, the way to each along its path (k, 3), which begins where the one before ends. The
    vehicle comes to rest at the last."""
    out: list[Waypoint] = []
    for path, view in zip(paths_enu_m, views, strict=True):
        out.extend(_via(p, view) for p in path[1:-1])
        out.append(_shot(view, shooting, shooting.stop or view is views[-1]))
    return out


def _shot(view: View, shooting: Shooting, stop: bool) -> Waypoint:
    pose = view.pose
    how = {"settle_s": shooting.settle_s} if stop else {"pass_m": shooting.pass_m,
                                                        "speed_m_s": shooting.speed_m_s.get(view.view_id, 0.0)}
    return Waypoint(position_enu_m=pose.position_enu_m, yaw_enu_rad=pose.yaw_enu_rad,
                    gimbal_elevation_rad=pose.elevation_rad, view_id=view.view_id, stop=stop, **how)


def _via(position: Array, view: View) -> Waypoint:
    x, y, z = (float(c) for c in position)
    return Waypoint(position_enu_m=(x, y, z), yaw_enu_rad=view.pose.yaw_enu_rad,
                    gimbal_elevation_rad=view.pose.elevation_rad, stop=False, pass_m=CORNER_PASS_M)


def _waypoint(position: Array, yaw: float, elevation: float, view_id: int | None, stop: bool) -> Waypoint:
    x, y, z = (float(c) for c in position)
    return Waypoint(position_enu_m=(x, y, z), yaw_enu_rad=yaw, gimbal_elevation_rad=elevation, view_id=view_id,
                    stop=stop, settle_s=KEY_SETTLE_S if stop else 0.0)
