"""Which photographs are fit: how blurred, how dark or bright, and which show the same twice.

Blur is the measure of Crete et al. (2007): how little a picture changes when it is blurred once more; it hardly depends
on what is in the picture. It is taken per tile, and the sharpest quarter counts, because much of a picture may be sky.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.photographs.pixels import glance

LOOK_WIDTH_PX = 1280
TILES = (6, 8)
THUMBNAIL = (64, 48)
SHARP_ENOUGH = 0.42
BLUR_ABOVE_USUAL = 0.1
"""Rejected is what is blurred more than most of its fellows by this, unless it is sharp enough all the same."""
DARK, BRIGHT, FLAT = 16.0, 242.0, 5.0
"""Mean and standard deviation of brightness, of 255."""
MAX_CLIPPED = 0.85
"""Share of pixels that are black or white."""
SAME_SHARE = 0.02
"""Thumbnails that differ less, beside their own contrast, show the same from the same place."""
LEAST_DIFFERENCE_DN = 0.6


@dataclass(frozen=True)
class Look:
    """What a glance at the pixels tells."""

    blur: float
    """0 sharp, 1 blurred."""
    brightness: float
    contrast: float
    clipped: float
    thumbnail: NDArray[np.uint8]


def look_at(path: Path) -> Look:
    """Raises what Pillow raises when the file is damaged, truncated ones included."""
    grey = glance(path, LOOK_WIDTH_PX)
    width = min(LOOK_WIDTH_PX, grey.shape[1])
    height = max(1, round(grey.shape[0] * width / grey.shape[1]))
    grey = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA))
    clipped = float(np.mean((grey <= 3) | (grey >= 252)))
    thumbnail = np.asarray(cv2.resize(grey, THUMBNAIL, interpolation=cv2.INTER_AREA))
    return Look(_blur(grey), float(grey.mean()), float(grey.std()), clipped, thumbnail)


def _blur(grey: NDArray[np.uint8]) -> float:
    """Crete's measure over the tiles with most structure, the worse of both directions."""
    value = grey.astype(np.float32)
    worst = 0.0
    for axis, kernel in ((1, (9, 1)), (0, (1, 9))):
        sharp = np.abs(np.diff(value, axis=axis))
        lost = np.maximum(sharp - np.abs(np.diff(cv2.blur(value, kernel), axis=axis)), 0.0)
        rows, columns = TILES
        before, after = (np.asarray(cv2.resize(v, (columns, rows), interpolation=cv2.INTER_AREA)).ravel()
                         for v in (sharp, lost))
        strongest = np.argsort(-before, kind="stable")[:len(before) // 4]
        worst = max(worst, 1.0 - float(after[strongest].sum()) / max(float(before[strongest].sum()), 1e-6))
    return worst


def reasons(looks: Sequence[Look], digests: Sequence[str], names: Sequence[str]) -> list[str]:
    """Why each picture is to be left out, in words; empty for a good one.

    Of two that show the same the sharper one stays, of two equal files the first.
    """
    usual = float(np.median([look.blur for look in looks])) if looks else 0.0
    limit = max(SHARP_ENOUGH, usual + BLUR_ABOVE_USUAL)
    found = [_fault(look, limit) for look in looks]
    first: dict[str, int] = {}
    for i, digest in enumerate(digests):
        if digest in first:
            found[i] = f"duplicate: the same file as {names[first[digest]]}"
        else:
            first[digest] = i
    _mark_same(looks, names, found)
    return found


def _fault(look: Look, blur_limit: float) -> str:
    if look.brightness < DARK:
        return f"underexposed: mean brightness {look.brightness:.0f} of 255"
    if look.brightness > BRIGHT:
        return f"overexposed: mean brightness {look.brightness:.0f} of 255"
    if look.contrast < FLAT:
        return f"blank: contrast {look.contrast:.1f} of 255"
    if look.clipped > MAX_CLIPPED:
        return f"badly exposed: {look.clipped:.0%} of the pixels are black or white"
    if look.blur > blur_limit:
        return f"blurred: {look.blur:.2f}, where up to {blur_limit:.2f} is usual here"
    return ""


def _mark_same(looks: Sequence[Look], names: Sequence[str], found: list[str]) -> None:
    """Near duplicates, sharpest first."""
    thumbnails = [look.thumbnail.astype(np.float32) for look in looks]
    kept: list[int] = []
    for i in sorted((i for i, why in enumerate(found) if not why), key=lambda i: looks[i].blur):
        if kept:
            apart = np.abs(np.stack([thumbnails[k] for k in kept]) - thumbnails[i]).mean(axis=(1, 2))
            nearest = int(np.argmin(apart))
            if apart[nearest] < max(LEAST_DIFFERENCE_DN, SAME_SHARE * looks[i].contrast):
                found[i] = f"duplicate: shows the same as {names[kept[nearest]]}"
                continue
        kept.append(i)
