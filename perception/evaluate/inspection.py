"""Inspection quality: how well the best picture shows each place of the surface, on the scale of CARIC.

q = q_seen * q_blur * q_res (Cooperative Aerial Robots Inspection Challenge, 2023): a place counts as seen when it is in
the picture, faces it and nothing hides it; q_blur falls with its motion over the exposure beyond a pixel; q_res falls
where a pixel covers more of the surface than was asked for, obliquely seen surface more than surface seen from the
front. Below LEAST a picture is worth nothing. Of several pictures the best counts.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from perception.evaluate.ray_scene import hidden, ray_scene
from perception.evaluate.reference import Reference

LEAST = 0.2
SHARP_PX = 1.0
"""Motion over the exposure that costs nothing."""
STEREO_PICTURES = 3
"""A place needs this many pictures to be reconstructed with confidence."""


@dataclass(frozen=True)
class Shot:
    """A picture as it was taken."""

    camera: Camera
    enu_from_camera: Array
    """(3, 3)"""
    position_enu_m: Array
    speed_m_s: float


@dataclass(frozen=True)
class Asked:
    """What pictures are judged by."""

    gsd_m: float
    """Ground sampling distance that is wanted, metres of surface per pixel."""
    exposure_s: float
    range_m: float = 60.0
    """Pictures from farther away count as not showing a place."""


@dataclass(frozen=True)
class Inspection:
    """Per sample of the reference: the best picture's quality, the best resolution and how many pictures show it."""

    quality: Array
    """(n,) 0-1."""
    gsd_m: Array
    """(n,) metres of surface per pixel along its coarser direction; inf where no picture shows it."""
    pictures: NDArray[np.int64]
    """(n,)"""

    def numbers(self, asked: Asked) -> dict[str, float | None]:
        """Shares (0-1) of the surface, and the mean quality."""
        if not len(self.quality):
            return dict.fromkeys(("mean_quality", "inspected", "at_gsd", "seen", "seen_by_3"))
        return {"mean_quality": float(self.quality.mean()), "inspected": float(np.mean(self.quality >= LEAST)),
                "at_gsd": float(np.mean(self.gsd_m <= asked.gsd_m)), "seen": float(np.mean(self.pictures > 0)),
                "seen_by_3": float(np.mean(self.pictures >= STEREO_PICTURES))}


def inspect(reference: Reference, shots: Iterable[Shot], asked: Asked) -> Inspection:
    """Cost: a projection per sample and picture, and a ray for each sample that is in a picture and faces it.

    Speed counts as if it all went across the picture: a bound, since it is not known in which direction a vehicle flew.
    """
    scene = ray_scene(reference.vertices_enu_m, reference.triangles)
    n = len(reference.samples_enu_m)
    quality, best_gsd = np.zeros(n), np.full(n, np.inf)
    count = np.zeros(n, dtype=np.int64)
    for shot in shots:
        there, gsd, motion = _in_picture(reference, shot, asked)
        clear = ~hidden(scene, shot.position_enu_m, reference.samples_enu_m[there])
        there, gsd, motion = there[clear], gsd[clear], motion[clear]
        q = np.minimum(SHARP_PX / np.maximum(motion, 1e-9), 1.0) * np.minimum(asked.gsd_m / gsd, 1.0)
        quality[there] = np.maximum(quality[there], np.where(q >= LEAST, q, 0.0))
        best_gsd[there] = np.minimum(best_gsd[there], gsd)
        count[there] += 1
    return Inspection(quality, best_gsd, count)


def surface_per_pixel(points_camera_m: Array, normals_camera: Array, camera: Camera) -> Array:
    """(n,) metres that a step of one pixel, along the row or the column, moves over the surface at each point, the
    larger of the two: |dP/du| of the picture ray's intersection with the tangent plane."""
    depth = points_camera_m[:, 2]
    ray = points_camera_m / depth[:, None]
    facing = np.sum(normals_camera * ray, axis=1)
    steps = []
    for axis, focal in ((0, camera.fx_px), (1, camera.fy_px)):
        unit = np.eye(3)[axis]
        along = unit - ray * (normals_camera[:, axis] / facing)[:, None]
        steps.append(depth / focal * np.linalg.norm(along, axis=1))
    return np.asarray(np.maximum(steps[0], steps[1]))


def _in_picture(reference: Reference, shot: Shot, asked: Asked) -> tuple[NDArray[np.int64], Array, Array]:
    """Rows of the samples in a picture that face it, metres per pixel there, and motion in pixels over the exposure."""
    local = (reference.samples_enu_m - shot.position_enu_m) @ shot.enu_from_camera
    normals = reference.normals @ shot.enu_from_camera
    camera, ahead = shot.camera, np.maximum(local[:, 2], 1e-6)
    u = camera.fx_px * local[:, 0] / ahead + camera.cx_px
    v = camera.fy_px * local[:, 1] / ahead + camera.cy_px
    shown = (local[:, 2] > 0.0) & (u >= 0) & (u < camera.width_px) & (v >= 0) & (v < camera.height_px)
    shown &= (np.sum(local * normals, axis=1) < 0.0) & (np.linalg.norm(local, axis=1) <= asked.range_m)
    there = np.flatnonzero(shown)
    gsd = surface_per_pixel(local[there], normals[there], camera)
    motion = shot.speed_m_s * asked.exposure_s * max(camera.fx_px, camera.fy_px) / local[there, 2]
    return there, gsd, motion

