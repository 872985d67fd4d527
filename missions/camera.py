"""The pinhole camera model and the pose of a picture, as every room sees them."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from missions import frames
from missions.frames import Array


class Camera(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Pinhole intrinsics in pixels, no distortion. Pixel centres lie at integer + 0.5; cx = width / 2 by default."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float

    @classmethod
    def from_diagonal_fov(cls, width_px: int, height_px: int, diagonal_fov_deg: float) -> Camera:
        """Square pixels, centred principal point, the given field of view across the picture's diagonal."""
        f = 0.5 * math.hypot(width_px, height_px) / math.tan(math.radians(diagonal_fov_deg) / 2.0)
        return cls(width_px, height_px, f, f, width_px / 2.0, height_px / 2.0)

    def scaled(self, width_px: int, height_px: int) -> Camera:
        """The same lens read out at another resolution."""
        sx, sy = width_px / self.width_px, height_px / self.height_px
        return Camera(width_px, height_px, self.fx_px * sx, self.fy_px * sy, self.cx_px * sx, self.cy_px * sy)

    @property
    def matrix(self) -> Array:
        """(3, 3) K, with pixel (0.5, 0.5) the centre of the first pixel."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    def rays_camera(self) -> Array:
        """(height, width, 3) directions through the pixel centres, camera axes, z = 1."""
        u = (np.arange(self.width_px) + 0.5 - self.cx_px) / self.fx_px
        v = (np.arange(self.height_px) + 0.5 - self.cy_px) / self.fy_px
        uu, vv = np.meshgrid(u, v)
        return np.stack([uu, vv, np.ones_like(uu)], axis=-1)

    @property
    def half_fov_rad(self) -> tuple[float, float]:
        """(horizontal, vertical) half fields of view."""
        return math.atan(0.5 * self.width_px / self.fx_px), math.atan(0.5 * self.height_px / self.fy_px)


class Pose(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Position and pointing of a camera in ENU. Cameras do not roll; only a measured attitude says that they do."""

    position_enu_m: tuple[float, float, float]
    yaw_enu_rad: float
    elevation_rad: float
    roll_rad: float = 0.0
    """About the optical axis, clockwise as the camera looks."""

    @property
    def enu_from_camera(self) -> Array:
        """(3, 3) rotation."""
        return frames.enu_from_camera(self.yaw_enu_rad, self.elevation_rad, self.roll_rad)

    @property
    def quaternion_wxyz(self) -> Array:
        """(4,) quaternion of enu_from_camera."""
        return frames.quaternion_from_matrix(self.enu_from_camera)

    @property
    def camera_from_enu(self) -> Array:
        """(4, 4) rigid transform."""
        r = self.enu_from_camera.T
        out = np.eye(4)
        out[:3, :3] = r
        out[:3, 3] = -r @ np.array(self.position_enu_m)
        return out


class View(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A picture to take: an id unique in the mission, and where the camera stands."""

    view_id: int
    pose: Pose
