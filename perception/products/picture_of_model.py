"""A picture of a textured surface without a graphics driver: parallel rays, by Embree."""

from __future__ import annotations

import math

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from missions.frames import Array, enu_from_camera
from perception.products.atlas import Textured

BACKGROUND = (255, 255, 255)
SAMPLES = 2
"""Rays per pixel along each axis."""
ROWS_AT_A_TIME = 64
RIM = 1.04


def picture_of(model: Textured, yaw_enu_rad: float, elevation_rad: float, width_px: int) -> NDArray[np.uint8]:
    """(height, width_px, 3) orthographic picture along a direction, fitted to the surface."""
    axes = enu_from_camera(yaw_enu_rad, elevation_rad)
    local = model.surface.vertices_enu_m @ axes
    low, high = local.min(axis=0), local.max(axis=0)
    step = RIM * float(high[0] - low[0]) / (width_px * SAMPLES)
    height_px = math.ceil(RIM * float(high[1] - low[1]) / step / SAMPLES)
    centre = 0.5 * (low + high)
    right = centre[0] + (np.arange(width_px * SAMPLES) + 0.5 - 0.5 * width_px * SAMPLES) * step
    down = centre[1] + (np.arange(height_px * SAMPLES) + 0.5 - 0.5 * height_px * SAMPLES) * step
    rows = []
    for begin in range(0, len(down), ROWS_AT_A_TIME):
        u, v = np.meshgrid(right, down[begin:begin + ROWS_AT_A_TIME])
        start = np.stack([u, v, np.full_like(u, low[2] - 1.0)], axis=-1) @ axes.T
        colours, _ = seen_along(model, start.reshape(-1, 3), axes[:, 2])
        blocks = colours.reshape(len(u) // SAMPLES, SAMPLES, width_px, SAMPLES, 3)
        rows.append(np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8))
    return np.concatenate(rows)


def seen_along(model: Textured, start_enu_m: Array, direction_enu: Array) -> tuple[NDArray[np.float32], Array]:
    """(n, 3) colours that parallel rays from points (n, 3) meet, BACKGROUND where none, and (n,) how far off, inf."""
    rays = np.concatenate([start_enu_m, np.broadcast_to(direction_enu, start_enu_m.shape)], axis=1)
    hit = model.surface.rays.cast_rays(o3d.core.Tensor.from_numpy(rays.astype(np.float32)))
    distance = hit["t_hit"].numpy()
    met = np.isfinite(distance)
    face, share = hit["primitive_ids"].numpy()[met], hit["primitive_uvs"].numpy()[met]
    weights = np.column_stack([1.0 - share.sum(axis=1), share])
    px = np.einsum("nk,nkc->nc", weights, model.corner_px[face])
    column, row = (np.clip(np.floor(px[:, k]).astype(np.int64), 0, model.image.shape[1 - k] - 1) for k in range(2))
    colours = np.full((len(rays), 3), BACKGROUND, np.float32)
    colours[met] = model.image[row, column]
    return colours, distance
