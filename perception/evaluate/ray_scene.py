"""A mesh ready for rays and nearest points (Open3D, Embree)."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from missions.frames import Array

LIFT_M = 0.01
"""A ray to a place ends this far before it, so that its own triangle does not hide it."""


def ray_scene(vertices_enu_m: Array, triangles: NDArray[np.int64]) -> o3d.t.geometry.RaycastingScene:
    """Of vertices (n, 3) and triangles (m, 3)."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices_enu_m, dtype=np.float32)),
                        o3d.core.Tensor.from_numpy(np.ascontiguousarray(triangles, dtype=np.uint32)))
    return scene


def hidden(scene: o3d.t.geometry.RaycastingScene, eye_enu_m: Array, points_enu_m: Array) -> NDArray[np.bool_]:
    """(n,) whether something lies between a camera and each of the points (n, 3)."""
    away = points_enu_m - eye_enu_m
    length = np.linalg.norm(away, axis=1, keepdims=True)
    reach = away * np.clip(1.0 - LIFT_M / np.maximum(length, 1e-9), 0.0, None)
    rays = np.concatenate([np.broadcast_to(eye_enu_m, points_enu_m.shape), reach], axis=1, dtype=np.float32)
    between: NDArray[np.bool_] = scene.test_occlusions(o3d.core.Tensor.from_numpy(rays), tnear=0.0, tfar=1.0).numpy()
    return between
