"""The camera of a set of pictures with its lens, here and in COLMAP."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from missions.camera import Camera
from missions.lens import NONE, Distortion, pixels, undistorted


@dataclass(frozen=True)
class Optics:
    """Intrinsics at the files' own resolution, and distortion."""

    camera: Camera
    lens: Distortion = NONE

    @classmethod
    def of(cls, camera: pycolmap.Camera) -> Optics:
        """A COLMAP camera of model PINHOLE or OPENCV."""
        fx, fy, cx, cy, *lens = (float(v) for v in camera.params)
        k1, k2, p1, p2 = lens or NONE
        return cls(Camera(camera.width, camera.height, fx, fy, cx, cy), (k1, k2, p1, p2))

    def colmap(self, with_lens: bool) -> pycolmap.Camera:
        """COLMAP's camera 1: OPENCV where the lens distorts or is to be found, else PINHOLE."""
        c = self.camera
        pinhole = [c.fx_px, c.fy_px, c.cx_px, c.cy_px]
        model, params = ("OPENCV", [*pinhole, *self.lens]) if with_lens or self.lens != NONE else ("PINHOLE", pinhole)
        return pycolmap.Camera(camera_id=1, model=model, width=c.width_px, height=c.height_px, params=params)

    @property
    def pinhole(self) -> Camera:
        """For pictures without distortion: square pixels, the axis in the middle."""
        c = self.camera
        f = 0.5 * (c.fx_px + c.fy_px)
        return Camera(c.width_px, c.height_px, f, f, 0.5 * c.width_px, 0.5 * c.height_px)

    def ideal(self, points_px: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 2) where the points (n, 2) of a picture would be without distortion; the same where there is none."""
        if self.lens == NONE:
            return points_px
        c = self.camera
        points = (points_px - [c.cx_px, c.cy_px]) / [c.fx_px, c.fy_px]
        return pixels(undistorted(points, self.lens), c).astype(np.float32)

    @property
    def numbers(self) -> dict[str, Any]:
        """For people and programs."""
        c = self.camera
        return {"width_px": c.width_px, "height_px": c.height_px, "fx_px": c.fx_px, "fy_px": c.fy_px,
                "cx_px": c.cx_px, "cy_px": c.cy_px, "distortion": list(self.lens)}

    @classmethod
    def from_numbers(cls, numbers: dict[str, Any]) -> Optics:
        """What `numbers` said."""
        k1, k2, p1, p2 = numbers["distortion"]
        camera = Camera(*(numbers[name] for name in ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")))
        return cls(camera, (k1, k2, p1, p2))
