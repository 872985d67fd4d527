"""Depth of one picture from one partner: rectification for known poses, then semi-global matching.

Semi-global matching: Hirschmüller 2008, in OpenCV's StereoSGBM. The rectified x axis runs from the reference to its
partner, wherever that lies, so that disparities are positive for baselines to any side, also up and down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array

Image = NDArray[np.uint8]
Map = NDArray[np.float32]

BLOCK_PX = 5
UNIQUENESS_PERCENT = 10
PATHS = cv2.StereoSGBM_MODE_SGBM
MAX_DISPARITIES = 320
COARSE_SCALE = 0.25
BORDER_PX = 4
MIN_COMMON_FORWARD = 0.5
"""Two cameras that look the same way across their baseline sum to 2; below this they look apart or along it."""


@dataclass(frozen=True)
class Eye:
    """A reduced grey picture with its open sky, intrinsics and pose."""

    grey: Image
    sky: NDArray[np.bool_]
    camera: Camera
    enu_from_camera: Array
    position_enu_m: Array


@dataclass(frozen=True)
class PairDepth:
    """Inverse depth along the reference's optical axis (NaN where unmatched), and what one pixel of disparity means."""

    inverse_depth: Map
    inverse_depth_per_px: float


@dataclass(frozen=True)
class _Rectified:
    """A pair of virtual cameras with parallel rows. Pixel indices (OpenCV's) map by 3x3 homographies."""

    size_px: tuple[int, int]
    focal_px: float
    baseline_m: float
    disparity_min_px: float
    disparities: int
    reference_from_rectified: Array
    partner_from_rectified: Array
    axis_enu: Array


def pair_depth(reference: Eye, partner: Eye, near_m: float, far_m: float) -> PairDepth | None:
    """Match two pictures. None when they share too little of the scene between near_m and far_m.

    A coarse pass finds the depth interval that is really there; the fine pass searches it alone, and shrinks the
    pictures when that would still take more than MAX_DISPARITIES steps (a wide baseline measures well even shrunk).
    """
    coarse = _rectify(reference, partner, COARSE_SCALE, near_m, far_m)
    if coarse is None:
        return None
    inverse = _inverse_depth(reference, coarse, _match(reference, partner, coarse))
    seen = inverse[np.isfinite(inverse)]
    if seen.size < 0.01 * inverse.size:
        return None
    low, high = np.percentile(seen, [0.5, 99.5])
    near, far = max(near_m, 0.85 / float(high)), min(far_m, 1.25 / float(low))
    baseline = float(np.linalg.norm(partner.position_enu_m - reference.position_enu_m))
    steps = reference.camera.fx_px * baseline * (1.0 / near - 1.0 / far)
    fine = _rectify(reference, partner, min(1.0, MAX_DISPARITIES / steps), near, far)
    if fine is None:
        return None
    inverse = _inverse_depth(reference, fine, _match(reference, partner, fine))
    return PairDepth(inverse, 1.0 / (fine.focal_px * baseline))


def _rectify(reference: Eye, partner: Eye, scale: float, near_m: float, far_m: float) -> _Rectified | None:
    """Virtual cameras that share the reference's field and the partner's rows."""
    step = partner.position_enu_m - reference.position_enu_m
    baseline = float(np.linalg.norm(step))
    x = step / baseline
    z = reference.enu_from_camera[:, 2] + partner.enu_from_camera[:, 2]
    z = z - (z @ x) * x
    if np.linalg.norm(z) < MIN_COMMON_FORWARD:
        return None
    z /= np.linalg.norm(z)
    rectified_from_enu = np.array([x, np.cross(z, x), z])
    focal = reference.camera.fx_px * scale
    d_min, d_max = focal * baseline / far_m, focal * baseline / near_m
    disparities = 16 * max(1, math.ceil((d_max - d_min) / 16.0))
    own, other = (_field(eye, rectified_from_enu, focal) for eye in (reference, partner))
    if own is None or other is None:
        return None
    left, right = max(own[0], other[0] + d_min), min(own[2], other[2] + d_max)
    top, bottom = max(own[1], other[1]), min(own[3], other[3])
    width, height = math.ceil(right - left) + disparities, math.ceil(bottom - top)
    if right - left < 24 or height < 24 or width * height > 6 * reference.grey.size:
        return None
    shift = left - disparities
    return _Rectified((width, height), focal, baseline, d_min, disparities,
                      _pixel_map(reference, rectified_from_enu, focal, shift, top),
                      _pixel_map(partner, rectified_from_enu, focal, shift - d_min, top), z)


def _field(eye: Eye, rectified_from_enu: Array, focal_px: float) -> tuple[float, float, float, float] | None:
    """Bounds (left, top, right, bottom) of a picture's frame in rectified pixels; None when it reaches behind."""
    c = eye.camera
    corners = np.array([[0, 0], [c.width_px, 0], [c.width_px, c.height_px], [0, c.height_px]], dtype=np.float64)
    rays = np.column_stack([(corners - [c.cx_px, c.cy_px]) / [c.fx_px, c.fy_px], np.ones(4)])
    local = rays @ (rectified_from_enu @ eye.enu_from_camera).T
    if np.any(local[:, 2] < 0.15):
        return None
    u, v = focal_px * local[:, 0] / local[:, 2], focal_px * local[:, 1] / local[:, 2]
    return float(u.min()), float(v.min()), float(u.max()), float(v.max())


def _pixel_map(eye: Eye, rectified_from_enu: Array, focal_px: float, left: float, top: float) -> Array:
    """(3, 3) homography from rectified pixel indices to indices in the eye's picture (at the eye's own resolution)."""
    ray_from_index = np.array([[1.0, 0.0, left + 0.5], [0.0, 1.0, top + 0.5], [0.0, 0.0, focal_px]]) / focal_px
    half = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
    return half @ eye.camera.matrix @ (rectified_from_enu @ eye.enu_from_camera).T @ ray_from_index


def _match(reference: Eye, partner: Eye, rectified: _Rectified) -> Map:
    """(height, width) disparity in rectified pixels above disparity_min_px; NaN where there is no trusted match."""
    scale = rectified.focal_px / reference.camera.fx_px
    left, left_inside = _warp(reference, rectified.reference_from_rectified, rectified.size_px, scale)
    right, right_inside = _warp(partner, rectified.partner_from_rectified, rectified.size_px, scale)
    matcher = cv2.StereoSGBM.create(
        minDisparity=0, numDisparities=rectified.disparities, blockSize=BLOCK_PX, P1=8 * BLOCK_PX**2,
        P2=32 * BLOCK_PX**2, disp12MaxDiff=1, preFilterCap=31, uniquenessRatio=UNIQUENESS_PERCENT,
        speckleWindowSize=round(150 * scale) + 10, speckleRange=2, mode=PATHS)
    disparity = matcher.compute(left, right).astype(np.float32) / 16.0
    valid = (disparity >= 0.0) & left_inside & _textured(left)
    columns = np.arange(rectified.size_px[0], dtype=np.float32)[None, :] - disparity
    source = np.clip(np.rint(columns), 0, rectified.size_px[0] - 1).astype(np.int32)
    valid &= np.take_along_axis(right_inside, source, axis=1)
    return np.where(valid, disparity, np.float32(np.nan))


def _warp(eye: Eye, eye_from_rectified: Array, size_px: tuple[int, int],
          scale: float) -> tuple[Image, NDArray[np.bool_]]:
    """The eye's picture seen by the virtual camera, and where it is really inside the frame."""
    picture, reduce = eye.grey, np.eye(3)
    if scale < 0.75:
        h, w = eye.grey.shape
        picture = cv2.resize(eye.grey, (round(w * scale), round(h * scale)), interpolation=cv2.INTER_AREA)
        sx, sy = picture.shape[1] / w, picture.shape[0] / h
        reduce = np.array([[sx, 0.0, 0.5 * sx - 0.5], [0.0, sy, 0.5 * sy - 0.5], [0.0, 0.0, 1.0]])
    matrix = reduce @ eye_from_rectified
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    seen = cv2.warpPerspective(picture, matrix, size_px, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    frame = np.zeros(picture.shape, dtype=np.uint8)
    frame[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = 1
    inside = cv2.warpPerspective(frame, matrix, size_px, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)
    return seen, inside.astype(bool)


MIN_TEXTURE_DN = 1.2


def _textured(picture: Image) -> NDArray[np.bool_]:
    """Where the standard deviation in a 9x9 window exceeds MIN_TEXTURE_DN; sky and bare walls match anything."""
    value = picture.astype(np.float32)
    mean = cv2.boxFilter(value, -1, (9, 9))
    variance = cv2.boxFilter(value * value, -1, (9, 9)) - mean * mean
    return np.asarray(variance > MIN_TEXTURE_DN**2)


def _inverse_depth(reference: Eye, rectified: _Rectified, disparity: Map) -> Map:
    """Disparities carried back to the reference's pixels as inverse depth along its optical axis."""
    size = (reference.camera.width_px, reference.camera.height_px)
    rectified_from_reference = np.linalg.inv(rectified.reference_from_rectified)
    carried = {flag: cv2.warpPerspective(disparity, rectified_from_reference, size, flags=flag | cv2.WARP_INVERSE_MAP,
                                         borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
               for flag in (cv2.INTER_LINEAR, cv2.INTER_NEAREST)}
    smooth, nearest = carried[cv2.INTER_LINEAR], carried[cv2.INTER_NEAREST]
    with np.errstate(invalid="ignore"):
        # Interpolation across a depth edge would invent a surface between the two.
        chosen = np.where(np.abs(smooth - nearest) < 1.0, smooth, nearest)
    axis = reference.enu_from_camera.T @ rectified.axis_enu
    c = reference.camera
    u = ((np.arange(c.width_px) + 0.5 - c.cx_px) / c.fx_px * axis[0]).astype(np.float32)
    v = ((np.arange(c.height_px) + 0.5 - c.cy_px) / c.fy_px * axis[1] + axis[2]).astype(np.float32)
    per_px = (u[None, :] + v[:, None]) / np.float32(rectified.focal_px * rectified.baseline_m)
    return np.asarray((chosen + np.float32(rectified.disparity_min_px)) * per_px)
