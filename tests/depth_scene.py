"""A textured wall in front of a distant background, drawn exactly: pictures and true depths for the depth tests."""

from __future__ import annotations

import functools
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from perception.depth.depth_map import DepthMap

CAMERA = Camera.from_diagonal_fov(456, 256, 84.0)
TEXELS_PER_M = 50.0


@functools.cache
def texture() -> NDArray[np.float32]:
    """(2048, 2048) grey noise with detail at several scales."""
    rng = np.random.default_rng(0)
    layers = [cv2.resize(rng.standard_normal((n, n)).astype(np.float32), (2048, 2048), interpolation=cv2.INTER_CUBIC)
              for n in (64, 256, 1024)]
    return np.asarray(np.clip(128.0 + 30.0 * np.sum(layers, axis=0), 0, 255), dtype=np.float32)


def wall_picture(pose: Pose, wall_north_m: float = 0.0, top_up_m: float = math.inf,
                 noise_seed: int | None = None) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Picture (h, w, 3) of the wall north = wall_north_m and true z-depth (h, w); above its top a textured infinity."""
    rays = CAMERA.rays_camera() @ pose.enu_from_camera.T
    position = np.array(pose.position_enu_m)
    depth = (wall_north_m - position[1]) / rays[..., 1]
    point = position + rays * depth[..., None]
    wall = (depth > 0) & (point[..., 2] < top_up_m)
    elevation = np.arcsin(rays[..., 2] / np.linalg.norm(rays, axis=-1))
    angle = np.stack([np.arctan2(rays[..., 1], rays[..., 0]), elevation], axis=-1)
    at = np.where(wall[..., None], point[..., [0, 2]] * TEXELS_PER_M, angle * 700.0 + 300.0).astype(np.float32) + 1024.0
    gray = cv2.remap(texture(), at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    if noise_seed is not None:
        gray = gray + np.random.default_rng(noise_seed).standard_normal(gray.shape)
    rgb = np.repeat(np.clip(gray, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    return rgb, np.where(wall, depth, np.inf)


def halved(depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """True depth at the resolution of the depth maps, through inverse depth so that infinity survives."""
    h, w = depth_m.shape
    return 1.0 / np.maximum((1.0 / depth_m).reshape(h // 2, 2, w // 2, 2).mean(axis=(1, 3)), 1e-9)


def exact_depth_map(pose: Pose, depth_m: NDArray[np.float64], sigma_per_depth2: float = 1e-4) -> DepthMap:
    """A depth map that is sure of everything finite; (h, w) at half resolution."""
    finite = np.isfinite(depth_m)
    return DepthMap(CAMERA.scaled(228, 128), pose, np.where(finite, depth_m, 1e3).astype(np.float32), finite,
                    finite.astype(np.float32), ~finite, sigma_per_depth2)
