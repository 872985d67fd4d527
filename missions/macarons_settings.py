"""The scene settings of MACARONS (`settings.json`), as a MACARONS user has them, and what they mean in metres.

MACARONS works in a right-handed frame with y up. Its files of settings are in the units of the mesh, its camera poses
in those times SCALE. Poses are (x, y, z, elevation, azimuth), angles in degrees, looking along
(cos e sin a, sin e, cos e cos a). ENU is (x, -z, y) (thesis, section 3.4), so an azimuth is a yaw of a - 90 degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from missions.camera import Pose
from missions.errors import UserError
from missions.frames import Array, wrap_pi

Triple = tuple[float, float, float]

SCALE = 10.0
"""`scene_scale_factor`: the released scenes are blown up by this."""
RANGE_SCALED = 70.0
"""Sensing range in scaled units."""
PICTURE_PX = (456, 256)
SHORT_SIDE_FOV_DEG = 60.0
"""Of PyTorch3D's default camera, which MACARONS uses."""


class SceneSection(msgspec.Struct, frozen=True, kw_only=True):
    """The object's box, mesh units, and the cells that it is cut into along x, y and z."""

    grid_l: int
    grid_w: int
    grid_h: int
    cell_capacity: int = 1000
    cell_resolution: float = 0.05
    x_min: Triple
    x_max: Triple


class CameraSection(msgspec.Struct, frozen=True, kw_only=True):
    """The camera's box, mesh units, and its lattice: positions along x, y and z, elevations, azimuths."""

    pose_l: int
    pose_w: int
    pose_h: int
    pose_n_theta: int = 5
    pose_n_azim: int = 10
    x_min: Triple
    x_max: Triple
    start_positions: list[tuple[int, int, int, int, int]] = []
    contrast_factor: float = 1.0


class MacaronsSettings(msgspec.Struct, frozen=True, kw_only=True):
    """One settings.json."""

    scene: SceneSection
    camera: CameraSection

    def camera_box(self, truncated: bool = True) -> tuple[Array, Array]:
        """(lower, upper) of the camera's box in scaled units.

        The release truncates the box towards zero before it scales it, and its start poses are meant so; the MAGICIAN
        fork does not.
        """
        low, high = np.array(self.camera.x_min), np.array(self.camera.x_max)
        if truncated:
            low, high = np.trunc(low), np.trunc(high)
        return SCALE * low, SCALE * high

    def pose_scaled(self, index: tuple[int, int, int, int, int], truncated: bool = True) -> Array:
        """(5,) x, y, z in scaled units, elevation and azimuth in degrees, of a lattice index: a cell's centre."""
        c = self.camera
        low, high = self.camera_box(truncated)
        place = low + (np.array(index[:3]) + 0.5) * (high - low) / np.array([c.pose_l, c.pose_w, c.pose_h])
        return np.array([*place, self.elevations_deg()[index[3]], 360.0 * index[4] / c.pose_n_azim])

    def elevations_deg(self) -> tuple[float, ...]:
        """Of the lattice, rising."""
        n = self.camera.pose_n_theta
        return tuple(-90.0 + 180.0 * (k + 1) / (n + 1) for k in range(n))


@dataclass(frozen=True)
class Units:
    """How MACARONS' numbers become ENU metres. units_per_metre: how many units of the mesh make a metre."""

    units_per_metre: float = 1.0

    @property
    def scaled_per_metre(self) -> float:
        """Scaled units in a metre."""
        return SCALE * self.units_per_metre

    def poses(self, rows_scaled: Array) -> list[Pose]:
        """Poses of rows (n, 5) of x, y, z in scaled units, elevation and azimuth in degrees."""
        places = enu_from_y_up(rows_scaled[:, :3]) / self.scaled_per_metre
        return [Pose((float(e), float(n), float(u)), wrap_pi(math.radians(azimuth - 90.0)), math.radians(elevation))
                for (e, n, u), (elevation, azimuth) in zip(places, rows_scaled[:, 3:5], strict=True)]

    def rows_scaled(self, poses: list[Pose]) -> Array:
        """(n, 5) rows of poses: the other way round. Azimuths lie in [0, 360)."""
        places = y_up_from_enu(np.array([p.position_enu_m for p in poses])) * self.scaled_per_metre
        angles = [(math.degrees(p.elevation_rad), (math.degrees(p.yaw_enu_rad) + 90.0) % 360.0) for p in poses]
        return np.hstack([places, angles])

    def box_enu_m(self, low: Array, high: Array) -> tuple[Array, Array]:
        """(lower, upper) in ENU metres of a box in mesh units."""
        ends = enu_from_y_up(np.stack([low, high])) / self.units_per_metre
        return ends.min(axis=0), ends.max(axis=0)

    def box_units(self, lower_enu_m: Array, upper_enu_m: Array) -> tuple[Array, Array]:
        """(lower, upper) in mesh units of a box in ENU metres."""
        ends = y_up_from_enu(np.stack([lower_enu_m, upper_enu_m])) * self.units_per_metre
        return ends.min(axis=0), ends.max(axis=0)


def enu_from_y_up(vectors: Array) -> Array:
    """(n, 3) with z up from (n, 3) with y up, as Blender imports OBJ files."""
    return np.stack([vectors[:, 0], -vectors[:, 2], vectors[:, 1]], axis=1)


def y_up_from_enu(vectors: Array) -> Array:
    """(n, 3) with y up from (n, 3) with z up."""
    return np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1)


def diagonal_fov_deg() -> float:
    """Of MACARONS' pictures, corner to corner."""
    focal_px = 0.5 * min(PICTURE_PX) / math.tan(math.radians(SHORT_SIDE_FOV_DEG) / 2.0)
    return 2.0 * math.degrees(math.atan(0.5 * math.hypot(*PICTURE_PX) / focal_px))


def read_settings(path: Path) -> MacaronsSettings:
    """A settings.json; fields that MACARONS does not have are ignored, as it ignores them. Raises UserError."""
    try:
        settings = msgspec.json.decode(path.read_bytes(), type=MacaronsSettings)
    except OSError as e:
        raise UserError(f"{path}: cannot be read ({e.strerror}); give MACARONS' settings.json.") from e
    except msgspec.DecodeError as e:
        raise UserError(f"{path}: not MACARONS' scene settings ({e}); give its settings.json.") from e
    for name, section in (("scene", settings.scene), ("camera", settings.camera)):
        if not all(a < b for a, b in zip(section.x_min, section.x_max, strict=True)):
            raise UserError(f"{path}: {name}.x_max does not exceed {name}.x_min on every axis; mend the box.")
    return settings


def write_settings(settings: MacaronsSettings, path: Path) -> None:
    """Write a settings.json."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(settings)))
