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
from perception.depth.confidence import Confidence
from perception.depth.pictures import PictureDepths
from perception.depth.plane_sweep import SweepSettings


def online_updates(walks: Walks, sweep: SweepSettings | None = None,
                   confidence: Confidence | None = None) -> Iterator[tuple[int, PictureDepths, list[int]]]:
    """Per key view: the number of its walk's first picture, what is known by then, and what was estimated for it."""
    first = 0
    for _, group in itertools.groupby(zip(walks.shots, walks.jpegs, strict=True), key=lambda pair: pair[0].walk):
        online = PictureDepths(sweep, confidence=confidence)
        for shot, jpeg in group:
            online.add(picture(jpeg), walks.camera, shot.pose)
            if shot.key:
                yield first, online, online.update()
        first += len(online)


def online_depths(walks: Walks) -> list[PictureDepths]:
    """Per walk, in order, what is known at its end."""
    return list({first: online for first, online, _ in online_updates(walks)}.values())


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
