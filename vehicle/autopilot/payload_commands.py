"""Commands to camera and gimbal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions.frames import yaw_enu_from_heading_deg
from vehicle.autopilot.request import ACCEPTED, REJECTED, Answer, Request
from vehicle.modes import MISSION

if TYPE_CHECKING:
    from vehicle.autopilot.face import Face

YAW_LOCK = mav.GIMBAL_MANAGER_FLAGS_YAW_LOCK


def photo(face: Face, r: Request, t_ns: int) -> Answer:
    """IMAGE_START_CAPTURE: one picture, so many, or one every so many seconds until it is stopped."""
    interval_s, count, sequence = (float(p) if math.isfinite(p) else 0.0 for p in r.params[1:4])
    face.craft.photos.start(interval_s, int(count), int(sequence), r.sender, t_ns)
    return ACCEPTED, []


def stop_photos(face: Face, r: Request, t_ns: int) -> Answer:
    """IMAGE_STOP_CAPTURE."""
    face.craft.photos.stop()
    return ACCEPTED, []


def gimbal(face: Face, r: Request, t_ns: int) -> Answer:
    """DO_GIMBAL_MANAGER_PITCHYAW: the camera's pitch; yaw turns the vehicle. Not while a plan is flown."""
    pitch, yaw, flags = r.params[0], r.params[1], int(r.params[4])
    executor, now = face.craft.executor, face.now
    elevation = float(np.clip(math.radians(pitch), -math.pi / 2, math.pi / 2)) if math.isfinite(pitch) \
        else now.gimbal_elevation_rad
    turned = now.yaw_enu_rad
    if math.isfinite(yaw):
        turned = yaw_enu_from_heading_deg(yaw) if flags & YAW_LOCK else now.yaw_enu_rad - math.radians(yaw)
    if executor.mode == MISSION and not executor.idle:
        return REJECTED, []
    return (ACCEPTED if executor.look(turned, elevation, t_ns) else REJECTED), []


def take_gimbal(face: Face, r: Request, t_ns: int) -> Answer:
    """DO_GIMBAL_MANAGER_CONFIGURE: whoever leads the vehicle has its gimbal."""
    return ACCEPTED, []
