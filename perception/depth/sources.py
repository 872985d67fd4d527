"""Which pictures to match a picture with, by pose alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.frames import Array

RANGES_M = np.array([6.0, 10.0, 16.0])
PARALLAX_DEG = (1.0, 3.0, 15.0, 25.0)
"""Score of a parallax angle: 0 below the first, 1 between the second and third, 0 above the last."""
MIN_SCORE = 0.12
MIN_SPACING_M = 0.25


def source_scores(target: Pose, candidates: list[Pose], camera: Camera) -> Array:
    """(n,) how well each candidate triangulates what the target sees, 0 to 1.

    Mean over a grid of points in the target's frustum of: seen by the candidate, times the worth of the parallax.
    """
    if not candidates:
        return np.zeros(0)
    points = _frustum_points(target, camera)
    position = np.array([c.position_enu_m for c in candidates])
    camera_from_enu = np.stack([c.enu_from_camera.T for c in candidates])
    local = np.einsum("nij,npj->npi", camera_from_enu, points[None] - position[:, None])
    depth = np.maximum(local[..., 2], 1e-6)
    u = camera.fx_px * local[..., 0] / depth + camera.cx_px
    v = camera.fy_px * local[..., 1] / depth + camera.cy_px
    seen = (local[..., 2] > 0.5) & (u > 0) & (u < camera.width_px) & (v > 0) & (v < camera.height_px)
    to_target = points - np.array(target.position_enu_m)
    cosine = np.einsum("pi,npi->np", to_target, points[None] - position[:, None])
    cosine /= np.linalg.norm(to_target, axis=1) * np.linalg.norm(points[None] - position[:, None], axis=2)
    parallax = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    worth = np.interp(parallax, PARALLAX_DEG, (0.0, 1.0, 1.0, 0.0))
    score: Array = (seen * worth).mean(axis=1)
    return score


def choose_sources(target: Pose, candidates: list[Pose], camera: Camera, count: int = 4) -> NDArray[np.int64]:
    """Indices of at most `count` candidates, best first, none within MIN_SPACING_M of another. Ties go to the first."""
    score = source_scores(target, candidates, camera)
    position = np.array([c.position_enu_m for c in candidates]).reshape(-1, 3)
    chosen: list[int] = []
    for i in np.argsort(-score, kind="stable"):
        if len(chosen) == count or score[i] < MIN_SCORE:
            break
        if all(np.linalg.norm(position[i] - position[j]) >= MIN_SPACING_M for j in chosen):
            chosen.append(int(i))
    return np.array(chosen, dtype=np.int64)


def _frustum_points(pose: Pose, camera: Camera) -> Array:
    """(p, 3) points at RANGES_M along a 5 x 3 grid of rays."""
    u = (np.linspace(0.1, 0.9, 5) * camera.width_px - camera.cx_px) / camera.fx_px
    v = (np.linspace(0.15, 0.85, 3) * camera.height_px - camera.cy_px) / camera.fy_px
    uu, vv = np.meshgrid(u, v)
    rays = np.stack([uu, vv, np.ones_like(uu)], axis=-1).reshape(-1, 3)
    local = (RANGES_M[:, None, None] * rays).reshape(-1, 3)
    points: Array = local @ pose.enu_from_camera.T + np.array(pose.position_enu_m)
    return points
