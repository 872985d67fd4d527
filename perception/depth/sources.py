"""Which pictures to match a picture with, by pose alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.frames import Array

RANGES_M = np.array([4.0, 8.0, 14.0, 22.0])
PARALLAX_DEG = (1.0, 3.0, 15.0, 25.0)
"""Worth of a parallax angle: 0 below the first, 1 between the second and third, 0 above the last."""
SECOND = 0.7
"""What the second source of a point is worth beside the first."""
MIN_GAIN = 0.04
MIN_SPACING_M = 0.25


def source_worth(target: Pose, candidates: list[Pose], camera: Camera) -> Array:
    """(n, p) how well each candidate triangulates each of some points all over the target's frustum, 0 to 1.

    The worth of the parallax where the candidate has the point in its picture, else 0.
    """
    points = _frustum_points(target, camera)
    position = np.array([c.position_enu_m for c in candidates]).reshape(-1, 3)
    camera_from_enu = np.array([c.enu_from_camera.T for c in candidates]).reshape(-1, 3, 3)
    away = points[None] - position[:, None]
    local = np.einsum("nij,npj->npi", camera_from_enu, away)
    depth = np.maximum(local[..., 2], 1e-6)
    u = camera.fx_px * local[..., 0] / depth + camera.cx_px
    v = camera.fy_px * local[..., 1] / depth + camera.cy_px
    seen = (local[..., 2] > 0.5) & (u > 0) & (u < camera.width_px) & (v > 0) & (v < camera.height_px)
    to_target = points - np.array(target.position_enu_m)
    cosine = np.einsum("pi,npi->np", to_target, away)
    cosine /= np.linalg.norm(to_target, axis=1) * np.linalg.norm(away, axis=2)
    parallax = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    worth: Array = seen * np.interp(parallax, PARALLAX_DEG, (0.0, 1.0, 1.0, 0.0))
    return worth


def choose_sources(target: Pose, candidates: list[Pose], camera: Camera,
                   count: int = 4) -> tuple[NDArray[np.int64], float]:
    """Indices of at most `count` candidates that together serve the whole frustum, and what they are worth, 0 to 1.

    Greedy: each adds most to the mean over the points of the best source's worth and SECOND times the second best's.
    None within MIN_SPACING_M of another, none that adds less than MIN_GAIN. Ties go to the first.
    """
    worth = source_worth(target, candidates, camera)
    position = np.array([c.position_enu_m for c in candidates]).reshape(-1, 3)
    best, second = np.zeros(worth.shape[1]), np.zeros(worth.shape[1])
    open_ = np.ones(len(candidates), np.bool_)
    chosen: list[int] = []
    total = 0.0
    while len(chosen) < count and open_.any():
        value = (np.maximum(worth, best) + SECOND * np.maximum(np.minimum(worth, best), second)).mean(axis=1)
        value = np.where(open_, value / (1.0 + SECOND), 0.0)
        i = int(value.argmax())
        if value[i] - total < MIN_GAIN:
            break
        second = np.maximum(np.minimum(worth[i], best), second)
        best, total = np.maximum(worth[i], best), float(value[i])
        chosen.append(i)
        open_ &= np.linalg.norm(position - position[i], axis=1) >= MIN_SPACING_M
    return np.array(chosen, dtype=np.int64), total


def _frustum_points(pose: Pose, camera: Camera) -> Array:
    """(p, 3) points at RANGES_M along a 7 x 4 grid of rays."""
    u = (np.linspace(0.03, 0.97, 7) * camera.width_px - camera.cx_px) / camera.fx_px
    v = (np.linspace(0.06, 0.94, 4) * camera.height_px - camera.cy_px) / camera.fy_px
    uu, vv = np.meshgrid(u, v)
    rays = np.stack([uu, vv, np.ones_like(uu)], axis=-1).reshape(-1, 3)
    local = (RANGES_M[:, None, None] * rays).reshape(-1, 3)
    points: Array = local @ pose.enu_from_camera.T + np.array(pose.position_enu_m)
    return points
