"""Semi-global matching of rectified pairs (Hirschmüller 2008): OpenCV's StereoSGBM, and the same to the bit in torch
where a GPU is."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.accelerator import torch_device

Image = NDArray[np.uint8]

BLOCK_PX = 5
STEP_PENALTY, JUMP_PENALTY = 8 * BLOCK_PX**2, 32 * BLOCK_PX**2
"""For a disparity that differs by one, and by more, from the neighbour's."""
CLIPPED_AT = 31
"""Gradients count as far as this."""
UNIQUENESS_PERCENT = 10
BOTH_WAYS_PX = 1
"""Disparities found from either picture may differ by this."""
SPECKLE_STEP_PX = 2
"""Neighbours that differ by less belong to one speckle."""
NONE = -16


@dataclass(frozen=True)
class RectifiedPair:
    """Two pictures with parallel rows: a point at column x of the left one is at x - d of the right one, d from 0 to
    below `disparities`."""

    left: Image
    right: Image
    disparities: int
    speckle_px: int
    """Islands of no more pixels are dropped."""


def disparities(pairs: list[RectifiedPair], device: str | None = None) -> list[NDArray[np.int16]]:
    """(height, width) for each pair: sixteenths of a pixel, NONE where nothing is trusted. `device`: a torch device,
    "" for OpenCV; by default the GPU if there is one."""
    device = torch_device() if device is None else device
    if not device:
        return [_by_opencv(pair) for pair in pairs]
    from perception.reconstruct import torch_semi_global  # here, for torch takes seconds and memory to import

    return [_without_speckles(raw, pair) for raw, pair in
            zip(torch_semi_global.disparities(pairs, device), pairs, strict=True)]


def _by_opencv(pair: RectifiedPair) -> NDArray[np.int16]:
    matcher = cv2.StereoSGBM.create(
        minDisparity=0, numDisparities=pair.disparities, blockSize=BLOCK_PX, P1=STEP_PENALTY, P2=JUMP_PENALTY,
        disp12MaxDiff=BOTH_WAYS_PX, preFilterCap=CLIPPED_AT, uniquenessRatio=UNIQUENESS_PERCENT,
        speckleWindowSize=pair.speckle_px, speckleRange=SPECKLE_STEP_PX, mode=cv2.STEREO_SGBM_MODE_SGBM)
    return np.asarray(matcher.compute(pair.left, pair.right), np.int16)


def _without_speckles(raw: NDArray[np.int16], pair: RectifiedPair) -> NDArray[np.int16]:
    """What StereoSGBM does at the end."""
    smooth = cv2.medianBlur(raw, 3)
    cv2.filterSpeckles(smooth, NONE, pair.speckle_px, 16 * SPECKLE_STEP_PX)
    return np.asarray(smooth, np.int16)
