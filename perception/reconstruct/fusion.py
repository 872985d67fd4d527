"""Consistency between depth maps: which points other pictures confirm, and which they look through."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from perception.reconstruct.stereo import Map

AGREE_SHARE = 0.006
"""Two depth maps agree on a point when their depths differ by less than this share of the distance."""
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


def support(own: PosedDepth, others: list[PosedDepth], camera: Camera) -> Support:
    """Check every pixel of a depth map against other depth maps; its depth becomes the mean of those that agree."""
    shape = own.depth.shape
    result = Support(np.zeros(shape, np.float32), np.zeros(shape, np.uint8), np.zeros(shape, np.uint8))
    rotation = np.array([o.enu_from_camera.T @ own.enu_from_camera for o in others]).reshape(-1, 3, 3)
    shift = np.array([o.enu_from_camera.T @ (own.position_enu_m - o.position_enu_m) for o in others]).reshape(-1, 3)
    stack = np.stack([o.depth for o in others]) if others else np.zeros((0, *shape), np.float32)
    intrinsics = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
    _check(np.ascontiguousarray(own.depth), stack, rotation, shift, intrinsics,
           result.depth, result.agreeing, result.through)
    return result


def _check_pixels(own: NDArray[np.float32], others: NDArray[np.float32], rotation: Array, shift: Array, k: Array,
                  depth: NDArray[np.float32], agreeing: NDArray[np.uint8], through: NDArray[np.uint8]) -> None:
    count, height, width = others.shape
    for v in range(own.shape[0]):
        for u in range(own.shape[1]):
            d = own[v, u]
            if d <= 0.0 or d == np.inf:
                continue
            x, y = (u + 0.5 - k[2]) / k[0] * d, (v + 0.5 - k[3]) / k[1] * d
            total, agree, behind = d, 1, 0
            for i in range(count):
                r, t = rotation[i], shift[i]
                z = r[2, 0] * x + r[2, 1] * y + r[2, 2] * d + t[2]
                if z < 0.3:
                    continue
                pu = int(np.floor((r[0, 0] * x + r[0, 1] * y + r[0, 2] * d + t[0]) / z * k[0] + k[2]))
                pv = int(np.floor((r[1, 0] * x + r[1, 1] * y + r[1, 2] * d + t[1]) / z * k[1] + k[3]))
                if pu < 0 or pu >= width or pv < 0 or pv >= height:
                    continue
                seen = others[i, pv, pu]
                if seen <= 0.0:
                    continue
                if abs(seen - z) < AGREE_SHARE * z:
                    total += d * seen / z
                    agree += 1
                elif seen > z * (1.0 + THROUGH_SHARE):
                    behind += 1
            depth[v, u] = total / agree
            agreeing[v, u] = agree
            through[v, u] = behind


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
