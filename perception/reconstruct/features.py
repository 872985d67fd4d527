"""Points of a picture that others can be recognised by: SIFT (Lowe 2004, in OpenCV), on the reduced picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.reconstruct.pictures import SurveyPicture, grey, read_colour

WIDTH_PX = 960
"""Pictures are reduced to this width; full HD would take six times as long."""
COUNT = 2000
FINE_WIDTH_PX, FINE_COUNT = 1920, 6000
CONTRAST = 0.02


@dataclass(frozen=True)
class Features:
    """Points (n, 2) float32, pixels at the file's own resolution, descriptors (n, 128) uint8 of length 512, and the
    diameters (n,) float32 of what they describe, in pixels of the reduced picture."""

    points_px: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    sizes_px: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.points_px)

    def largest(self, count: int) -> Features:
        """The count features that describe the largest patches: those that other pictures most likely have too."""
        best = np.argsort(-self.sizes_px, kind="stable")[:count]
        return Features(self.points_px[best], self.descriptors[best], self.sizes_px[best])

    def with_more(self, more: Features) -> Features:
        """These, and others of the same picture after them."""
        return Features(np.concatenate([self.points_px, more.points_px]),
                        np.concatenate([self.descriptors, more.descriptors]),
                        np.concatenate([self.sizes_px, more.sizes_px]))


def features(picture: SurveyPicture) -> Features:
    """The COUNT strongest of a survey picture. Raises UserError when it cannot be read."""
    return _of(picture, WIDTH_PX, COUNT)


def fine_features(picture: SurveyPicture) -> Features:
    """The FINE_COUNT strongest at twice the width. Raises UserError when it cannot be read."""
    return _of(picture, FINE_WIDTH_PX, FINE_COUNT)


def _of(picture: SurveyPicture, width_px: int, count: int) -> Features:
    width = min(width_px, picture.camera.width_px)
    return sift(grey(read_colour(picture, width)), count, picture.camera.width_px / width)


def sift(reduced: NDArray[np.uint8], count: int, scale: float) -> Features:
    """The count strongest, by contrast. Descriptors are square-rooted (Arandjelovic and Zisserman 2012).

    scale: pixels of the file per pixel of the reduced grey picture.
    """
    detector = cv2.SIFT.create(nfeatures=count, contrastThreshold=CONTRAST, enable_precise_upscale=True)
    found, raw = detector.detectAndCompute(reduced, None)
    if not found:
        return Features(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8), np.zeros(0, np.float32))
    points = (np.array([k.pt for k in found]) + 0.5) * scale
    rooted = 512.0 * np.sqrt(raw / np.maximum(raw.sum(axis=1, keepdims=True), 1e-9))
    return Features(points.astype(np.float32), np.minimum(np.rint(rooted), 255.0).astype(np.uint8),
                    np.array([k.size for k in found], np.float32))
