"""Pictures drawn anew, as a pinhole would have seen them: without distortion, turned upright, at another size."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.lens import Distortion, distorted, pixel_points, pixels

Map = NDArray[np.float32]
MAX_SHRINK = 1.5
"""Beyond this a picture is averaged down before it is warped."""


def redrawn(picture: NDArray[np.uint8], camera: Camera, lens: Distortion, wanted: Camera,
            quarter_turns: int = 0) -> NDArray[np.uint8]:
    """(height, width, ...) what the wanted pinhole sees of a picture that camera took through the lens; black where
    the picture shows nothing. quarter_turns: how often the picture is turned clockwise by 90 degrees on the way."""
    if camera.fx_px > MAX_SHRINK * wanted.fx_px:
        share = wanted.fx_px / camera.fx_px
        camera = camera.scaled(round(camera.width_px * share), round(camera.height_px * share))
        picture = np.asarray(cv2.resize(picture, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA))
    u, v = _maps(camera, lens, wanted, quarter_turns % 4)
    return np.asarray(cv2.remap(picture, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT))


@lru_cache(maxsize=8)
def _maps(camera: Camera, lens: Distortion, wanted: Camera, quarter_turns: int) -> tuple[Map, Map]:
    """Where in the picture (indices) each wanted pixel lies."""
    points = pixel_points(wanted)
    for _ in range(quarter_turns):
        points = np.stack([points[..., 1], -points[..., 0]], axis=-1)
    seen = (pixels(distorted(points, lens), camera) - 0.5).astype(np.float32)
    return np.ascontiguousarray(seen[..., 0]), np.ascontiguousarray(seen[..., 1])
