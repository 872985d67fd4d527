"""Offboard set-points: positions that a client streams, and what happens when the stream ends."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions.frames import ned_from_enu, yaw_enu_from_heading_deg
from planning.trajectories import Via
from vehicle.autopilot.craft import Craft
from vehicle.modes import GUIDED, HOLD, OFFBOARD
from vehicle.simulator import NS, Kinematics

STALE_NS = NS // 2
"""PX4 leaves offboard when set-points come more rarely than about twice a second."""
NO_POSITION, NO_YAW = 0b111, 0x400
LOCAL_FRAMES = (mav.MAV_FRAME_LOCAL_NED,)


class Setpoints:
    """The newest set-point."""

    def __init__(self, craft: Craft) -> None:
        self._craft = craft
        self._target: Via | None = None
        self._t_ns = -STALE_NS - 1
        self._leads = False
        """Whether it is the set-points of this link that are followed."""

    def hear(self, message: Any, now: Kinematics, guided: bool, t_ns: int) -> str:
        """Take one in, and follow it in offboard mode, or at once where the guided mode is for that; a sentence when
        it cannot be followed."""
        target = self._via(message, now)
        if target is None:
            return "only position set-points are flown (SET_POSITION_TARGET_LOCAL_NED frame 1, or GLOBAL_INT)"
        self._target, self._t_ns = target, t_ns
        if self._craft.executor.mode == OFFBOARD:
            self._craft.executor.goto(target, t_ns, OFFBOARD)
        elif guided and self._craft.executor.mode in (HOLD, GUIDED):
            self.begin(t_ns)
        return ""

    def begin(self, t_ns: int) -> bool:
        """Follow them from now on; False when none is fresh."""
        if self._target is None or t_ns - self._t_ns > STALE_NS:
            return False
        self._leads = self._craft.executor.goto(self._target, t_ns, OFFBOARD)
        return self._leads

    def stale(self, t_ns: int) -> bool:
        """Whether the vehicle follows set-points that have stopped."""
        self._leads = self._leads and self._craft.executor.mode == OFFBOARD
        return self._leads and t_ns - self._t_ns > STALE_NS

    def _via(self, message: Any, now: Kinematics) -> Via | None:
        if message.type_mask & NO_POSITION:
            return None
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            if message.coordinate_frame not in LOCAL_FRAMES:
                return None
            position = ned_from_enu(np.array([message.x, message.y, message.z]))
        else:
            relative = message.coordinate_frame in (mav.MAV_FRAME_GLOBAL_RELATIVE_ALT,
                                                    mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
            position = self._craft.site.enu_from_geodetic(message.lat_int / 1e7, message.lon_int / 1e7, message.alt)
            if relative:
                position[2] = message.alt + float(self._craft.executor.pad[2])
        if not np.isfinite(position).all():
            return None
        turned = not message.type_mask & NO_YAW and math.isfinite(message.yaw)
        yaw = yaw_enu_from_heading_deg(math.degrees(message.yaw)) if turned else now.yaw_enu_rad
        return Via(position, yaw, now.gimbal_elevation_rad)
