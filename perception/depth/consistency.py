"""Does what one depth map says agree with the others? Geometric consistency between pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perception.depth.depth_map import DepthMap

Votes = NDArray[np.int32]


def votes(depth: DepthMap, others: list[DepthMap], max_shift: float = 3.0) -> tuple[Votes, Votes]:
    """(h, w) others that measure the same point, and others that see through it.

    max_shift: allowed difference of inverse depth, in combined standard deviations of both maps.
    """
    agree, against = np.zeros(depth.valid.shape, np.int32), np.zeros(depth.valid.shape, np.int32)
    rays = depth.camera.rays_camera()
    rows, columns = np.nonzero(depth.valid)
    points = rays[rows, columns] * depth.depth_m[rows, columns, None]
    enu = points @ depth.pose.enu_from_camera.T + np.array(depth.pose.position_enu_m)
    for other in others:
        local = (enu - np.array(other.pose.position_enu_m)) @ other.pose.enu_from_camera
        z = np.maximum(local[:, 2], 1e-3)
        u = np.floor(other.camera.fx_px * local[:, 0] / z + other.camera.cx_px).astype(np.int64)
        v = np.floor(other.camera.fy_px * local[:, 1] / z + other.camera.cy_px).astype(np.int64)
        seen = (local[:, 2] > 0.2) & (u >= 0) & (u < other.camera.width_px) & (v >= 0) & (v < other.camera.height_px)
        u, v = np.where(seen, u, 0), np.where(seen, v, 0)
        measured = seen & other.valid[v, u]
        limit = max_shift * np.hypot(depth.sigma_per_depth2, other.sigma_per_depth2)
        difference = 1.0 / z - 1.0 / other.depth_m[v, u]
        agree[rows, columns] += measured & (np.abs(difference) <= limit)
        against[rows, columns] += (measured & (difference > limit)) | (seen & other.sky[v, u])
    return agree, against
