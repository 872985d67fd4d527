"""From how far away something is in view."""

from __future__ import annotations

import numpy as np
import viser

from missions.frames import Array

MARGIN = 0.7
"""Of half the picture, so that what is to be dragged does not lie at its rim."""


def step_back(camera: viser.CameraHandle, points_enu_m: Array) -> None:
    """Move a browser's camera straight back, never nearer, until it shows the points (n, 3)."""
    position, look_at = np.array(camera.position), np.array(camera.look_at)
    back = stand_back(position, look_at, np.array(camera.up_direction), camera.fov, camera.aspect, points_enu_m)
    camera.position = tuple(back)
    camera.look_at = tuple(look_at)  # which viser moves with the position


def stand_back(position: Array, look_at: Array, up: Array, fov_rad: float, aspect: float, points: Array) -> Array:
    """(3,) where a camera stands that looks the same way at the same place and has the points (n, 3) in its picture.

    fov_rad: vertical, as three.js has it; aspect: width over height.
    """
    away = position - look_at
    distance = float(np.linalg.norm(away))
    ahead = -away / distance
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    across, over, beyond = ((points - look_at) @ axis for axis in (right, np.cross(right, ahead), ahead))
    half = MARGIN * np.tan(0.5 * fov_rad)
    needed = np.maximum(np.abs(over), np.abs(across) / aspect) / half - beyond
    return look_at - max(distance, float(needed.max())) * ahead
