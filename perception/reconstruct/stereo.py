"""Depth of one picture from its partners: rectification for known poses, then semi-global matching.

The rectified x axis runs from the reference to its partner, wherever that lies, so that disparities are positive for
baselines to any side, also up and down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from perception.reconstruct.semi_global import RectifiedPair, disparities

Image = NDArray[np.uint8]
Map = NDArray[np.float32]

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


@dataclass(frozen=True)
class _Warped:
    """A rectified pair's pictures, and where they lie inside their frames."""

    pair: RectifiedPair
    left_inside: NDArray[np.bool_]
    right_inside: NDArray[np.bool_]


def pair_depths(reference: Eye, partners: list[Eye], near_m: float, far_m: float) -> list[PairDepth]:
    """Match a picture with each partner; who shares too little of the scene between near_m and far_m is left out.

    A coarse pass finds the depth interval that is really there; the fine pass searches it alone, and shrinks the
    pictures when that would still take more than MAX_DISPARITIES steps (a wide baseline measures well even shrunk).
    """
    coarse = [(partner, _rectify(reference, partner, COARSE_SCALE, near_m, far_m)) for partner in partners]
    fine = [(partner, _refined(reference, partner, inverse, near_m, far_m))
            for partner, _, inverse in _matched(reference, coarse)]
    return [PairDepth(inverse, 1.0 / (rectified.focal_px * rectified.baseline_m))
            for _, rectified, inverse in _matched(reference, fine)]


def _refined(reference: Eye, partner: Eye, inverse: Map, near_m: float, far_m: float) -> _Rectified | None:
    """The fine pass's cameras for the depths that the coarse pass found; None where it found hardly any."""
    seen = inverse[np.isfinite(inverse)]
    if seen.size < 0.01 * inverse.size:
        return None
    low, high = np.percentile(seen, [0.5, 99.5])
    near, far = max(near_m, 0.85 / float(high)), min(far_m, 1.25 / float(low))
    baseline = float(np.linalg.norm(partner.position_enu_m - reference.position_enu_m))
    steps = reference.camera.fx_px * baseline * (1.0 / near - 1.0 / far)
    return _rectify(reference, partner, min(1.0, MAX_DISPARITIES / steps), near, far)


def _matched(reference: Eye, tried: list[tuple[Eye, _Rectified | None]]) -> list[tuple[Eye, _Rectified, Map]]:
    """Partner, cameras and inverse depth in the reference's pixels, of those that could be rectified."""
    pairs = [(partner, rectified) for partner, rectified in tried if rectified is not None]
    warped = [_warped(reference, partner, rectified) for partner, rectified in pairs]
    found = disparities([w.pair for w in warped])
    return [(partner, rectified, _inverse_depth(reference, rectified, _trusted(w, d)))
            for (partner, rectified), w, d in zip(pairs, warped, found, strict=True)]


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


def _warped(reference: Eye, partner: Eye, rectified: _Rectified) -> _Warped:
    """Both pictures as the virtual cameras see them."""
    scale = rectified.focal_px / reference.camera.fx_px
    left, left_inside = _warp(reference, rectified.reference_from_rectified, rectified.size_px, scale)
    right, right_inside = _warp(partner, rectified.partner_from_rectified, rectified.size_px, scale)
    return _Warped(RectifiedPair(left, right, rectified.disparities, round(150 * scale) + 10),
                   left_inside, right_inside)


def _trusted(warped: _Warped, found: NDArray[np.int16]) -> Map:
    """(height, width) disparity in rectified pixels above disparity_min_px; NaN where there is no trusted match."""
    disparity = found.astype(np.float32) / 16.0
    valid = (disparity >= 0.0) & warped.left_inside & _textured(warped.pair.left)
    width = disparity.shape[1]
    columns = np.arange(width, dtype=np.float32)[None, :] - disparity
    source = np.clip(np.rint(columns), 0, width - 1).astype(np.int32)
    valid &= np.take_along_axis(warped.right_inside, source, axis=1)
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
