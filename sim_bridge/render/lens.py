"""Pictures through a lens that distorts: drawn by a pinhole that sees all of it, then warped."""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.lens import Distortion, pixel_points, pixels, undistorted
from sim_bridge.render.light import Bytes

MARGIN_PX = 3
"""Bicubic interpolation needs neighbours."""


def wide_camera(camera: Camera, lens: Distortion) -> Camera:
    """The pinhole with the same focal length that sees all that the camera sees through the lens."""
    return _warp(camera, lens)[0]


def through_lens(drawn: Bytes, camera: Camera, lens: Distortion) -> Bytes:
    """(height, width, 3) the picture of the camera, from what its wide_camera saw."""
    _, u, v = _warp(camera, lens)
    return np.asarray(cv2.remap(drawn, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))


@lru_cache(maxsize=4)
def _warp(camera: Camera, lens: Distortion) -> tuple[Camera, NDArray[np.float32], NDArray[np.float32]]:
    """The wide camera, and where in its picture (indices) each pixel's ray lies."""
    seen = pixels(undistorted(pixel_points(camera), lens), camera)
    low = np.floor(seen.min(axis=(0, 1))) - MARGIN_PX
    width, height = (math.ceil(v) for v in seen.max(axis=(0, 1)) - low + MARGIN_PX)
    wide = Camera(width, height, camera.fx_px, camera.fy_px, camera.cx_px - low[0], camera.cy_px - low[1])
    return wide, (seen[..., 0] - low[0] - 0.5).astype(np.float32), (seen[..., 1] - low[1] - 0.5).astype(np.float32)
