"""Pictures of a point cloud without a graphics driver: points splatted into a depth buffer, then shaded by depth."""

from __future__ import annotations

import base64
import io
import math

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from missions.frames import Array, enu_from_camera

SUPERSAMPLE = 2
BACKGROUND = (255, 255, 255)
SHADE_STRENGTH = 1.4

Pixels = NDArray[np.uint8]


def splat(points_enu_m: NDArray[np.float32], colours: Pixels, yaw_enu_rad: float, elevation_rad: float, width_px: int,
          point_m: float) -> Pixels:
    """(height, width_px, 3) orthographic picture of points (n, 3) with colours (n, 3), seen along yaw and elevation.

    The picture is fitted to the points; each covers a square of about point_m. Edges in depth are darkened
    (eye-dome lighting, Boucheny 2009), which makes shape readable without normals.
    """
    axes = enu_from_camera(yaw_enu_rad, elevation_rad)
    local = points_enu_m @ axes.astype(np.float32)
    u, v, scale, height = _fit(local, width_px * SUPERSAMPLE)
    order = np.argsort(-local[:, 2], kind="stable")
    column = np.floor((local[order, 0] - u) * scale).astype(np.int64)
    row = np.floor((local[order, 1] - v) * scale).astype(np.int64)
    picture = np.full((height, width_px * SUPERSAMPLE, 3), BACKGROUND, dtype=np.uint8)
    depth = np.full(picture.shape[:2], np.inf, dtype=np.float32)
    # Far to near, so the highest rank on a pixel hides the others; float32 holds ranks exactly up to 16 million.
    front = np.full(picture.shape[:2], -1.0, dtype=np.float32)
    inside = (row >= 0) & (row < picture.shape[0]) & (column >= 0) & (column < picture.shape[1])
    np.maximum.at(front, (row[inside], column[inside]), np.flatnonzero(inside).astype(np.float32))
    size = 2 * (max(1, math.ceil(point_m * scale)) // 2) + 1
    nearest = cv2.dilate(front, np.ones((size, size), np.uint8)).astype(np.int64)
    hit = nearest >= 0
    picture[hit] = colours[order[nearest[hit]]]
    depth[hit] = local[order[nearest[hit]], 2]
    return _reduce(_shaded(picture, depth))


def _fit(local: NDArray[np.float32], width: int) -> tuple[float, float, float, int]:
    """Left and top edge (m, in the picture plane), pixels per metre and height that show all points with a rim."""
    across, down = local[:, 0], local[:, 1]  # one by one: numpy takes ten times as long over both at once
    low, high = (across.min(), down.min()), (across.max(), down.max())
    rim = 0.02 * (high[0] - low[0])
    scale = width / (high[0] - low[0] + 2 * rim)
    height = math.ceil((high[1] - low[1] + 2 * rim) * scale / SUPERSAMPLE) * SUPERSAMPLE
    return float(low[0] - rim), float(low[1] - rim), float(scale), height


def _shaded(picture: Pixels, depth: NDArray[np.float32]) -> Pixels:
    """Darken a pixel by how far its neighbours stand before it."""
    finite = np.where(np.isfinite(depth), depth, np.float32(1e6))
    step = SUPERSAMPLE
    before = np.zeros_like(finite)
    for dy, dx in ((step, 0), (-step, 0), (0, step), (0, -step)):
        neighbour = np.roll(finite, (dy, dx), axis=(0, 1))
        before += np.clip(finite - neighbour, 0.0, 1.0)
    shade = np.exp(-SHADE_STRENGTH * before / 4.0)[..., None]
    return np.where(np.isfinite(depth)[..., None], picture * shade, picture).astype(np.uint8)


def _reduce(picture: Pixels) -> Pixels:
    h, w = picture.shape[0] // SUPERSAMPLE, picture.shape[1] // SUPERSAMPLE
    blocks = picture.reshape(h, SUPERSAMPLE, w, SUPERSAMPLE, 3)
    return np.asarray(np.rint(blocks.mean(axis=(1, 3))), dtype=np.uint8)


def data_uri(picture: Pixels, kind: str = "PNG") -> str:
    """The picture as the content of an `img` element."""
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, kind, quality=82)
    return f"data:image/{kind.lower()};base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"


def ramp(values: Array, low: float, high: float, stops: tuple[tuple[int, int, int], ...]) -> Pixels:
    """(n, 3) colours of values (n,), linear between evenly spaced stops."""
    t = np.clip((np.asarray(values, dtype=np.float64) - low) / (high - low), 0.0, 1.0) * (len(stops) - 1)
    table = np.array(stops, dtype=np.float64)
    return np.column_stack([np.interp(t, np.arange(len(stops)), table[:, k]) for k in range(3)]).astype(np.uint8)
