"""The 5-D lattice of candidate views: position (x, y, z) times elevation and azimuth.

Positions are those of missions.lattice; orientations are every elevation with every azimuth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.frames import Array, enu_from_camera, wrap_pi
from missions.lattice import view_positions
from missions.mission import ExploreSpec


@dataclass(frozen=True)
class Lattice:
    """Candidate positions and candidate orientations; a view is a pair of indices into them."""

    positions_enu_m: Array
    """(p, 3)"""
    yaw_enu_rad: Array
    """(o,)"""
    elevation_rad: Array
    """(o,)"""

    def pose(self, position: int, orientation: int) -> Pose:
        """The pose of one candidate."""
        x, y, z = (float(c) for c in self.positions_enu_m[position])
        return Pose((x, y, z), float(self.yaw_enu_rad[orientation]), float(self.elevation_rad[orientation]))


def build_lattice(lower_enu_m: Array, upper_enu_m: Array, spec: ExploreSpec) -> Lattice:
    """The lattice inside the camera bounds. Azimuth a has yaw 2 pi a / azimuths; elevations vary slowest."""
    yaws = [wrap_pi(2.0 * math.pi * a / spec.azimuths) for a in range(spec.azimuths)]
    pairs = [(yaw, math.radians(e)) for e in spec.elevations_deg for yaw in yaws]
    yaw, elevation = np.array(pairs).T
    return Lattice(view_positions(lower_enu_m, upper_enu_m, spec), yaw, elevation)


def in_view(directions_enu: Array, yaw_enu_rad: Array, elevation_rad: Array, camera: Camera) -> NDArray[np.bool_]:
    """(r, o) whether direction r falls into the picture of a camera with orientation o."""
    result = np.zeros((len(directions_enu), len(yaw_enu_rad)), dtype=np.bool_)
    for o, (yaw, elevation) in enumerate(zip(yaw_enu_rad, elevation_rad, strict=True)):
        x, y, z = (np.asarray(directions_enu) @ enu_from_camera(float(yaw), float(elevation))).T
        ahead = np.where(z > 1e-9, z, np.inf)
        u = camera.fx_px * x / ahead + camera.cx_px
        v = camera.fy_px * y / ahead + camera.cy_px
        result[:, o] = (z > 1e-9) & (u >= 0) & (u < camera.width_px) & (v >= 0) & (v < camera.height_px)
    return result
