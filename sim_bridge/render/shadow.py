"""Where the sun's orthographic camera stands, so that its map covers the object and what is near it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.scene import Scene

NEARBY_M = 15.0
FINEST_TEXEL_M = 0.01
MAX_TEXELS = 40_000_000
MAX_SIDE_PX = 8192


@dataclass(frozen=True)
class ShadowFrame:
    """clip_from_enu and texture_from_enu are (4, 4); offset_m lifts the shaded point off its own shadow texel."""

    clip_from_enu: NDArray[np.float64]
    texture_from_enu: NDArray[np.float64]
    size_px: tuple[int, int]
    offset_m: float


def fit_shadow(scene: Scene, to_sun_enu: NDArray[np.float64]) -> ShadowFrame:
    """Rectangle around the object's box grown by NEARBY_M, seen from the sun, as fine as memory allows."""
    sun_from_enu = _sun_axes(to_sun_enu)
    lo, hi = np.asarray(scene.object_min_enu_m) - NEARBY_M, np.asarray(scene.object_max_enu_m) + NEARBY_M
    lo[2], hi[2] = min(scene.ground_up_m, lo[2] + NEARBY_M), hi[2] - NEARBY_M
    near = _corners(lo, hi) @ sun_from_enu.T
    points = np.concatenate([p.vertices_enu_m for p in scene.parts if len(p.vertices_enu_m)])
    depth = points @ sun_from_enu[2]
    low = np.array([*near[:, :2].min(axis=0), depth.min() - 1.0])
    high = np.array([*near[:, :2].max(axis=0), depth.max() + 1.0])
    span = high - low
    texel_m = max(FINEST_TEXEL_M, math.sqrt(span[0] * span[1] / MAX_TEXELS), max(span[:2]) / MAX_SIDE_PX)
    clip = np.eye(4)
    clip[:3, :3] = np.diag([2, 2, -2] / span) @ sun_from_enu
    clip[:3, 3] = -np.array([1, 1, -1]) * (low + high) / span
    to_texture = np.diag([0.5, 0.5, 0.5, 1.0])
    to_texture[:3, 3] = 0.5
    size = (math.ceil(span[0] / texel_m), math.ceil(span[1] / texel_m))
    return ShadowFrame(clip, to_texture @ clip, size, 1.5 * texel_m)


def _sun_axes(to_sun: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) sun_from_enu: x as near East as can be, z towards the sun."""
    east = np.array([1.0, 0.0, 0.0])
    x = east - to_sun * (east @ to_sun)
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-3 else np.array([0.0, 1.0, 0.0])
    return np.stack([x, np.cross(to_sun, x), to_sun])


def _corners(lo: NDArray[np.float64], hi: NDArray[np.float64]) -> NDArray[np.float64]:
    grid = np.stack(np.meshgrid(*zip(lo, hi, strict=True), indexing="ij"), axis=-1)
    return grid.reshape(-1, 3)
