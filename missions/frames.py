"""Frames and units: the only place where ENU meets geodetic, NED, degrees and degE7.

World: local ENU, metres, origin at the mission's WGS84 point. Yaw is counter-clockwise from East, radians.
Cameras have OpenCV axes (x right, y down, z forward). Quaternions are ``wxyz``. Transforms are named ``a_from_b``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WGS84_A_M = 6378137.0
WGS84_E2 = 6.69437999014e-3


def wrap_pi(angle_rad: float) -> float:
    """Angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def heading_deg_from_yaw_enu(yaw_enu_rad: float) -> float:
    """MAVLink heading (degrees clockwise from North, [0, 360)) of an ENU yaw."""
    return (90.0 - math.degrees(yaw_enu_rad)) % 360.0


def yaw_enu_from_heading_deg(heading_deg: float) -> float:
    """ENU yaw (radians counter-clockwise from East) of a MAVLink heading."""
    return wrap_pi(math.radians(90.0 - heading_deg))


def ned_from_enu(vector_enu: Array) -> Array:
    """(..., 3) ENU to NED; its own inverse."""
    v = np.asarray(vector_enu, dtype=np.float64)
    return np.stack([v[..., 1], v[..., 0], -v[..., 2]], axis=-1)


def forward_enu(yaw_enu_rad: float, elevation_rad: float) -> Array:
    """(3,) unit optical axis of a camera at this yaw and elevation (positive looks up)."""
    c = math.cos(elevation_rad)
    return np.array([c * math.cos(yaw_enu_rad), c * math.sin(yaw_enu_rad), math.sin(elevation_rad)])


def enu_from_camera(yaw_enu_rad: float, elevation_rad: float, roll_rad: float = 0.0) -> Array:
    """(3, 3) rotation whose columns are the camera's right, down and forward axes in ENU; roll turns right to down."""
    cy, sy = math.cos(yaw_enu_rad), math.sin(yaw_enu_rad)
    ce, se = math.cos(elevation_rad), math.sin(elevation_rad)
    right = (sy, -cy, 0.0)
    down = (se * cy, se * sy, -ce)
    forward = (ce * cy, ce * sy, se)
    level = np.array([right, down, forward]).T
    if roll_rad == 0.0:
        return level
    c, s = math.cos(roll_rad), math.sin(roll_rad)
    return np.asarray(level @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))


def yaw_elevation_from_forward(direction_enu: Array) -> tuple[float, float]:
    """(yaw_enu_rad, elevation_rad) of a non-zero direction (3,)."""
    x, y, z = (float(c) for c in direction_enu)
    return math.atan2(y, x), math.atan2(z, math.hypot(x, y))


def roll_about_axis(rotation: Array) -> float:
    """Roll (radians) of enu_from_camera (3, 3): what `yaw_elevation_from_forward` of its last column leaves out."""
    level = enu_from_camera(*yaw_elevation_from_forward(rotation[:, 2]))
    turn = level.T @ rotation
    return math.atan2(turn[1, 0], turn[0, 0])


def quaternion_from_matrix(rotation: Array) -> Array:
    """(4,) unit quaternion ``wxyz`` with w >= 0 of a (3, 3) rotation matrix."""
    m = np.asarray(rotation, dtype=np.float64)
    k = np.array(
        [
            [m[0, 0] + m[1, 1] + m[2, 2], 0.0, 0.0, 0.0],
            [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], 0.0, 0.0],
            [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], 0.0],
            [m[1, 0] - m[0, 1], m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1]],
        ]
    )
    _, vectors = np.linalg.eigh(k / 3.0)
    q: Array = vectors[:, -1]
    return -q if q[0] < 0 else q


def matrix_from_quaternion(quaternion_wxyz: Array) -> Array:
    """(3, 3) rotation matrix of a quaternion ``wxyz`` (normalised here)."""
    w, x, y, z = np.asarray(quaternion_wxyz, dtype=np.float64) / np.linalg.norm(quaternion_wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


class Site:
    """Geodetic anchor of the ENU frame: metres to degrees and back, on the ellipsoid's local radii.

    Linear in latitude and longitude, so exact both ways; against a true ENU frame the error is below 1 cm within
    200 m of the origin for |latitude| < 66 deg. It grows with the square of the distance.
    """

    def __init__(self, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        self.lat_deg, self.lon_deg, self.alt_m = lat_deg, lon_deg, alt_m
        s = math.sin(math.radians(lat_deg))
        w = math.sqrt(1.0 - WGS84_E2 * s * s)
        self._m_per_deg_lat = math.radians(WGS84_A_M * (1.0 - WGS84_E2) / w**3)
        self._m_per_deg_lon = math.radians(WGS84_A_M / w) * math.cos(math.radians(lat_deg))

    def geodetic_from_enu(self, position_enu_m: Array) -> tuple[float, float, float]:
        """(latitude_deg, longitude_deg, altitude_m above the ellipsoid) of a position (3,)."""
        lat, lon, alt = (float(c) for c in self.geodetic_rows_from_enu(np.asarray(position_enu_m, dtype=np.float64)))
        return lat, lon, alt

    def geodetic_rows_from_enu(self, position_enu_m: Array) -> Array:
        """(..., 3) latitude_deg, longitude_deg, altitude_m above the ellipsoid of positions (..., 3)."""
        e, n, u = (position_enu_m[..., k] for k in range(3))
        return np.stack([self.lat_deg + n / self._m_per_deg_lat, self.lon_deg + e / self._m_per_deg_lon,
                         self.alt_m + u], axis=-1)

    def enu_from_geodetic(self, lat_deg: float, lon_deg: float, alt_m: float) -> Array:
        """(3,) ENU metres of a geodetic position."""
        return np.array(
            [(lon_deg - self.lon_deg) * self._m_per_deg_lon, (lat_deg - self.lat_deg) * self._m_per_deg_lat,
             alt_m - self.alt_m]
        )
