"""Depth along recorded walks, as it would come in flight: move by move, from pictures and poses alone."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.errors import UserError
from missions.frames import Array
from missions.walks import Walks
from perception.depth.pictures import PictureDepths


def online_depths(walks: Walks) -> Iterator[PictureDepths]:
    """Per walk, in order, what is known at its end."""
    for _, group in itertools.groupby(zip(walks.shots, walks.jpegs, strict=True), key=lambda pair: pair[0].walk):
        online = PictureDepths()
        for shot, jpeg in group:
            online.add(picture(jpeg), walks.camera, shot.pose)
            if shot.key:
                online.update()
        yield online


def picture(jpeg: bytes) -> NDArray[np.uint8]:
    """(h, w, 3) RGB."""
    bgr = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    if bgr is None:
        raise UserError("a picture of the walks cannot be decoded; take the pictures anew.")
    return np.asarray(bgr[..., ::-1], np.uint8)


def ray_lengths(camera: Camera) -> Array:
    """(h, w) metres along the ray per metre of depth."""
    result: Array = np.linalg.norm(camera.rays_camera(), axis=-1)
    return result
