"""Which pixels show open sky, from colour alone: rather "unknown" than a wall called sky."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose

MAX_TEXTURE_DN = 3.0
MIN_BLUE_EXCESS_DN = 6.0
MIN_BRIGHTNESS_DN = 90.0
SAFETY_PX = 2
LEVEL_DN = 16
MIN_BLUE_EXCESS_OF_GAPS_DN = 25


def sky_mask(rgb: NDArray[np.uint8], camera: Camera, pose: Pose) -> NDArray[np.bool_]:
    """(h, w) smooth, bright, bluish pixels above the horizon that connect to the highest part of the picture.

    rgb: (h, w, 3) at the camera's resolution. The mask keeps SAFETY_PX away from everything else.
    """
    return _away_from_edges(_open_sky(_like_sky(rgb, camera, pose)))


def sky_and_gaps(rgb: NDArray[np.uint8], camera: Camera, pose: Pose) -> NDArray[np.bool_]:
    """The same with what is as blue as the open sky of this picture but enclosed, as between the bars of a railing."""
    like = _like_sky(rgb, camera, pose)
    sky = _open_sky(like)
    level = (rgb // LEVEL_DN).astype(np.int64)
    blue = rgb[..., 2].astype(np.int64) - rgb[..., 0] > MIN_BLUE_EXCESS_OF_GAPS_DN
    levels = 256 // LEVEL_DN
    key = (level[..., 0] * levels + level[..., 1]) * levels + level[..., 2]
    known = np.bincount(key[sky & blue], minlength=levels**3) > 0
    return _away_from_edges(sky | (like & blue & known[key]))


def _like_sky(rgb: NDArray[np.uint8], camera: Camera, pose: Pose) -> NDArray[np.bool_]:
    up = camera.rays_camera() @ pose.enu_from_camera[2]
    colour = cv2.blur(rgb.astype(np.float32), (3, 3))
    gray = rgb.astype(np.float32).mean(axis=-1)
    mean = cv2.blur(gray, (3, 3))
    texture = np.sqrt(np.maximum(cv2.blur(gray * gray, (3, 3)) - mean * mean, 0.0))
    bluish = (colour[..., 2] >= colour[..., 0] + MIN_BLUE_EXCESS_DN) & (colour[..., 2] >= colour[..., 1])
    return np.asarray((up > 0.02) & (texture < MAX_TEXTURE_DN) & bluish & (mean > MIN_BRIGHTNESS_DN))


def _open_sky(like: NDArray[np.bool_]) -> NDArray[np.bool_]:
    _, label = cv2.connectedComponents(like.astype(np.uint8), connectivity=4)
    reached = np.unique(label[0][like[0]])
    return np.isin(label, reached[reached > 0])


def _away_from_edges(sky: NDArray[np.bool_]) -> NDArray[np.bool_]:
    kernel = np.ones((2 * SAFETY_PX + 1, 2 * SAFETY_PX + 1), np.uint8)
    return np.asarray(cv2.erode(sky.astype(np.uint8), kernel, borderType=cv2.BORDER_REPLICATE) > 0)
