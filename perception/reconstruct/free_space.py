"""What pictures look through is not there: every point of the cloud before the depth maps of all pictures.

When depth maps are fused each is checked by those of a few pictures that stand alike. Where texture repeats and
pictures stand in rows they may be wrong in the same way, and agree. Pictures from elsewhere see what is behind.
"""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from perception.depth.compiled import compiled
from perception.reconstruct.cloud import Cloud
from perception.reconstruct.fusion import THROUGH_SHARE, PosedDepth

METHOD = 1
"""Raised whenever other points are left out of the same cloud."""
SEEN_SHARE = 0.02
"""A picture has a point where its depth differs by less than this share of the distance."""
FARTHEST_DISTANCES = 2.5
"""Pictures from farther off, in usual distances, have no say."""
MOST_THROUGH = 0.7
"""Pictures that look through a point, for each that has it there."""


def not_looked_through(cloud: Cloud, seen: Iterable[PosedDepth], camera: Camera, farthest_m: float,
                       threads: int = 1) -> Cloud:
    """The points that no more than MOST_THROUGH times as many pictures look through as have them, in order."""
    there, through = votes(cloud.points_enu_m, seen, camera, farthest_m, threads)
    return cloud.select(through <= MOST_THROUGH * there)


def votes(points_enu_m: NDArray[np.float32], seen: Iterable[PosedDepth], camera: Camera, farthest_m: float,
          threads: int = 1) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """(n,) pictures that have a point where it is, and pictures that look through it; of those no farther away."""
    there, through = np.zeros(len(points_enu_m), np.uint16), np.zeros(len(points_enu_m), np.uint16)
    bounds = np.linspace(0, len(points_enu_m), threads + 1).astype(np.int64)
    intrinsics = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
    with ThreadPoolExecutor(threads) as pool:
        for picture in seen:
            def count(k: int, picture: PosedDepth = picture) -> None:
                part = slice(bounds[k], bounds[k + 1])
                _count(points_enu_m[part], picture.depth, picture.enu_from_camera, picture.position_enu_m, intrinsics,
                       farthest_m, there[part], through[part])

            list(pool.map(count, range(threads)))
    return there, through


@compiled
def _count(points: NDArray[np.float32], depth: NDArray[np.float32], r: Array, t: Array, k: Array, farthest_m: float,
           there: NDArray[np.uint16], through: NDArray[np.uint16]) -> None:
    height, width = depth.shape
    for i in range(len(points)):
        x, y, z = points[i, 0] - t[0], points[i, 1] - t[1], points[i, 2] - t[2]
        ahead = r[0, 2] * x + r[1, 2] * y + r[2, 2] * z
        if ahead < 0.3 or ahead > farthest_m:
            continue
        u = int(np.floor((r[0, 0] * x + r[1, 0] * y + r[2, 0] * z) / ahead * k[0] + k[2]))
        v = int(np.floor((r[0, 1] * x + r[1, 1] * y + r[2, 1] * z) / ahead * k[1] + k[3]))
        if u < 0 or u >= width or v < 0 or v >= height:
            continue
        seen = depth[v, u]
        if seen <= 0.0:
            continue
        if abs(seen - ahead) < SEEN_SHARE * ahead:
            there[i] += 1
        elif seen > ahead * (1.0 + THROUGH_SHARE):
            through[i] += 1
