"""What depth a picture of a known surface has, to hold an estimated depth map against."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from perception.evaluate.ray_scene import ray_scene


def depths_of_mesh(vertices_enu_m: Array, triangles: NDArray[np.int64], camera: Camera,
                   positions_enu_m: Sequence[Array], enu_from_cameras: Sequence[Array]) -> list[Array]:
    """Per view (h, w) metres along the optical axis to a mesh of vertices (n, 3) and triangles (m, 3), through the
    pixels' middles; inf where nothing of it is in the way."""
    scene = ray_scene(vertices_enu_m, triangles)
    local, found = camera.rays_camera().reshape(-1, 3), []
    for position, enu_from_camera in zip(positions_enu_m, enu_from_cameras, strict=True):
        directions = local @ enu_from_camera.T
        rays = np.concatenate([np.broadcast_to(position, directions.shape), directions], axis=1, dtype=np.float32)
        hit = scene.cast_rays(o3d.core.Tensor.from_numpy(rays))["t_hit"].numpy()
        found.append(hit.astype(np.float64).reshape(camera.height_px, camera.width_px))
    return found
