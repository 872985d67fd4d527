"""Consistency between depth maps: which points other pictures confirm, and which they look through."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from perception.reconstruct.stereo import Map

AGREE_SHARE = 0.006
"""Two depth maps agree on a point when their depths differ by less than this share of the distance from the nearer one:
what is seen from afar, and so vaguely, confirms nothing that is seen from nearby."""
THROUGH_SHARE = 0.03
"""A picture looks through a point when it sees something farther off by more than this share of the distance."""
NORMAL_STEP_PX = 3


@dataclass(frozen=True)
class PosedDepth:
    """A depth map with its pose; all maps of a reconstruction share one camera. 0 is unknown, infinity is open sky."""

    depth: Map
    enu_from_camera: Array
    position_enu_m: Array


@dataclass(frozen=True)
class Support:
    """Per pixel: refined depth (m, 0 where none), agreeing depth maps (its own included), pictures that see through."""

    depth: Map
    agreeing: NDArray[np.uint8]
    through: NDArray[np.uint8]


def support(own: PosedDepth, others: Iterable[PosedDepth], camera: Camera) -> Support:
    """Check every pixel of a depth map against other depth maps, which are asked for one after the other.

    Its depth becomes the mean of those that agree.
    """
    shape = own.depth.shape
    depth = np.ascontiguousarray(own.depth)
    known = (depth > 0.0) & (depth < np.inf)
    total = depth.astype(np.float64)
    agreeing, through = known.astype(np.uint8), np.zeros(shape, np.uint8)
    intrinsics = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
    for other in others:
        rotation = other.enu_from_camera.T @ own.enu_from_camera
        shift = other.enu_from_camera.T @ (own.position_enu_m - other.position_enu_m)
        _check(depth, np.ascontiguousarray(other.depth), rotation, shift, intrinsics, total, agreeing, through)
    mean = np.divide(total, agreeing, out=np.zeros(shape), where=known)
    return Support(mean.astype(np.float32), agreeing, through)


def _check_pixels(own: NDArray[np.float32], other: NDArray[np.float32], r: Array, t: Array, k: Array,
                  total: Array, agreeing: NDArray[np.uint8], through: NDArray[np.uint8]) -> None:
    height, width = other.shape
    for v in range(own.shape[0]):
        for u in range(own.shape[1]):
            d = own[v, u]
            if d <= 0.0 or d == np.inf:
                continue
            x, y = (u + 0.5 - k[2]) / k[0] * d, (v + 0.5 - k[3]) / k[1] * d
            z = r[2, 0] * x + r[2, 1] * y + r[2, 2] * d + t[2]
            if z < 0.3:
                continue
            pu = int(np.floor((r[0, 0] * x + r[0, 1] * y + r[0, 2] * d + t[0]) / z * k[0] + k[2]))
            pv = int(np.floor((r[1, 0] * x + r[1, 1] * y + r[1, 2] * d + t[1]) / z * k[1] + k[3]))
            if pu < 0 or pu >= width or pv < 0 or pv >= height:
                continue
            seen = other[pv, pu]
            if seen <= 0.0:
                continue
            if abs(seen - z) < AGREE_SHARE * min(d, z):
                total[v, u] += d * seen / z
                agreeing[v, u] += 1
            elif seen > z * (1.0 + THROUGH_SHARE):
                through[v, u] += 1


_check = numba.njit(nogil=True, cache=True)(_check_pixels)


def points_camera(depth: Map, camera: Camera) -> NDArray[np.float32]:
    """(height, width, 3) float32 points in camera axes."""
    return np.asarray(camera.rays_camera().astype(np.float32) * depth[..., None])


def normals_camera(points: NDArray[np.float32], depth: Map) -> NDArray[np.float32]:
    """(height, width, 3) unit normals towards the camera, from differences over NORMAL_STEP_PX pixels.

    Beside a hole or a depth edge, where no difference can be trusted, the normal is the direction to the camera.
    """
    s = NORMAL_STEP_PX
    towards = -points / np.maximum(np.linalg.norm(points, axis=-1, keepdims=True), 1e-6)
    normals = towards.copy()
    across = points[s:-s, 2 * s:] - points[s:-s, :-2 * s]
    down = points[2 * s:, s:-s] - points[:-2 * s, s:-s]
    normal = np.cross(down, across)
    length = np.linalg.norm(normal, axis=-1)
    centre = depth[s:-s, s:-s]
    ends = (depth[s:-s, 2 * s:], depth[s:-s, :-2 * s], depth[2 * s:, s:-s], depth[:-2 * s, s:-s])
    smooth = (centre > 0) & (length > 0)
    for end in ends:
        smooth &= np.abs(end - centre) < 0.05 * centre
    normal /= np.maximum(length, 1e-12)[..., None]
    inner = normals[s:-s, s:-s]
    normal *= np.where(np.sum(normal * towards[s:-s, s:-s], axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    inner[smooth] = normal[smooth]
    return np.asarray(normals)
