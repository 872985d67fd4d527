"""A mesh ready for rays and nearest points (Open3D, Embree)."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from missions.frames import Array


def ray_scene(vertices_enu_m: Array, triangles: NDArray[np.int64]) -> o3d.t.geometry.RaycastingScene:
    """Of vertices (n, 3) and triangles (m, 3)."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices_enu_m, dtype=np.float32)),
                        o3d.core.Tensor.from_numpy(np.ascontiguousarray(triangles, dtype=np.uint32)))
    return scene
