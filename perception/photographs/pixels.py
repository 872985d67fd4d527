"""Pixels of a picture file, whatever it holds: 8 bits or 16, grey, indexed, CMYK, floating point."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

LARGEST_PX = 250_000_000
"""A medium-format aerial camera takes 150 million; more is a mosaic, or an attack."""
Image.MAX_IMAGE_PIXELS = None  # Pillow's own limit warns at 89 million and does not know cameras
FLAGS = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION | cv2.IMREAD_ANYDEPTH

Picture = NDArray[np.uint8]


def decoded(path: Path) -> Picture:
    """(height, width, 3) BGR as stored. Raises OSError, or what else Pillow raises, when the file is no picture.

    OpenCV is the faster for JPEG, and reads 16-bit colour, which Pillow does not.
    """
    try:
        with Image.open(path) as image:
            if image.format in ("JPEG", "MPO"):
                pixels = _by_opencv(path)
                if pixels is not None:
                    return pixels
            return np.ascontiguousarray(_by_pillow(image)[..., ::-1])
    except UnidentifiedImageError:
        pixels = _by_opencv(path)
        if pixels is None:
            raise
        return pixels


def glance(path: Path, width_px: int) -> Picture:
    """(height, width) grey, at least width_px wide where the file is. Raises like `decoded`, also for a JPEG that is
    cut off, which OpenCV would fill up."""
    with suppress(UnidentifiedImageError), Image.open(path) as image:
        if image.format in ("JPEG", "MPO"):
            image.draft("RGB", (width_px, width_px * image.height // image.width))
            return np.asarray(image.convert("L"))
    return np.asarray(cv2.cvtColor(decoded(path), cv2.COLOR_BGR2GRAY))


def _by_opencv(path: Path) -> Picture | None:
    data = np.fromfile(path, np.uint8)
    pixels = cv2.imdecode(data, FLAGS) if len(data) else None
    return None if pixels is None else in_8_bits(np.asarray(pixels))


def _by_pillow(image: Image.Image) -> Picture:
    if image.mode.startswith(("I", "F")):
        return np.repeat(in_8_bits(np.asarray(image))[..., None], 3, axis=2)
    return np.asarray(image.convert("RGB"))


def in_8_bits(values: NDArray[np.generic]) -> Picture:
    """Deeper values scaled by the power of two that their largest needs: 10, 12 and 14 bits lie in files of 16."""
    if values.dtype == np.uint8:
        return np.asarray(values, np.uint8)
    finite = np.nan_to_num(values.astype(np.float32), posinf=0.0, neginf=0.0)
    largest = max(float(finite.max(initial=0.0)), 1e-6)
    scaled = np.clip(finite * (255.0 / 2.0 ** np.ceil(np.log2(largest))), 0.0, 255.0)
    return np.asarray(scaled, np.uint8)
