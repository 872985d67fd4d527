"""OBSTACLE_DISTANCE: the simulated range sensor's nearest echoes around the vehicle, in sectors of 5 degrees."""

from __future__ import annotations

import math

import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions.messages import RangeScan
from missions.sensors import RANGE_DIRECTIONS

SECTORS = 72
LEVEL_RAD = math.radians(15.0)
"""Rays that rise or fall less than this count."""
NOTHING_CM = 65535
_AZIMUTH = np.arctan2(RANGE_DIRECTIONS[:, 1], RANGE_DIRECTIONS[:, 0])
_LEVEL = np.abs(RANGE_DIRECTIONS[:, 2]) < math.sin(LEVEL_RAD)


def obstacle_distance(scan: RangeScan | None, yaw_enu_rad: float) -> mav.MAVLink_message | None:
    """The message in the body's frame, clockwise from straight ahead; None before the first scan."""
    if scan is None:
        return None
    ranges_m = np.array(scan.ranges_m)
    clockwise = np.mod(yaw_enu_rad - _AZIMUTH, math.tau)
    sector = np.round(clockwise / (math.tau / SECTORS)).astype(np.int64) % SECTORS
    nearest = np.full(SECTORS, np.inf)
    np.minimum.at(nearest, sector[_LEVEL], ranges_m[_LEVEL])
    within = np.isfinite(nearest)
    distances = np.full(SECTORS, NOTHING_CM)
    distances[within] = np.round(100.0 * nearest[within]).astype(np.int64)
    finite = ranges_m[np.isfinite(ranges_m)]
    farthest = math.ceil(100.0 * float(finite.max())) if len(finite) else 0
    return mav.MAVLink_obstacle_distance_message(
        scan.t_ns // 1000, mav.MAV_DISTANCE_SENSOR_LASER, distances.tolist(), 5, 20, farthest, 5.0, 0.0,
        mav.MAV_FRAME_BODY_FRD)
