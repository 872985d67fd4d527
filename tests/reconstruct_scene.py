"""A textured wall with a box before it, photographed by exact ray casting: small enough for fast tests."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import cv2
import numpy as np

from missions.camera import Camera, Pose
from missions.frames import Array, yaw_elevation_from_forward
from perception.reconstruct.pictures import SurveyPicture

CAMERA = Camera.from_diagonal_fov(640, 360, 84.0)


@dataclass(frozen=True, eq=False)
class Rectangle:
    """Corner, two perpendicular edges (m), and a texture of 1 cm texels."""

    corner: Array
    a: Array
    b: Array
    seed: int

    @property
    def normal(self) -> Array:
        n = np.cross(self.a, self.b)
        return n / np.linalg.norm(n)

    def hit(self, origin: Array, rays: Array) -> tuple[Array, Array, Array]:
        """Distance along each ray (inf where missed), and where on the rectangle, in metres along a and b."""
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((self.corner - origin) @ self.normal) / (rays @ self.normal)
            local = origin + rays * t[..., None] - self.corner
            la, lb = np.linalg.norm(self.a), np.linalg.norm(self.b)
            s, r = local @ (self.a / la), local @ (self.b / lb)
            hit = (t > 0.1) & (s >= 0) & (s <= la) & (r >= 0) & (r <= lb)
        return np.where(hit, t, np.inf), s, r

    @cached_property
    def texture(self) -> np.ndarray:
        rng = np.random.default_rng(self.seed)
        h, w = int(np.linalg.norm(self.b) * 100) + 2, int(np.linalg.norm(self.a) * 100) + 2
        out = np.full((h, w, 3), 120.0, np.float32)
        for size in (2, 5, 12, 40):
            noise = rng.normal(0.0, 22.0, (h // size + 2, w // size + 2, 3)).astype(np.float32)
            out += cv2.resize(noise, (w, h), interpolation=cv2.INTER_CUBIC)
        return np.clip(out, 0, 255)


@cache
def wall_and_box() -> list[Rectangle]:
    """A 10 x 6 m wall in the plane y = 0, facing south, and a 2 m box standing 1 m out of it."""
    x, y, z = np.eye(3)
    box = np.array([-1.0, -1.0, 2.0])
    return [
        Rectangle(np.array([-5.0, 0.0, 0.0]), 10 * x, 6 * z, 1),
        Rectangle(box, 2 * x, 2 * z, 2),
        Rectangle(box, y, 2 * z, 3),
        Rectangle(box + 2 * x, y, 2 * z, 4),
        Rectangle(box + 2 * z, 2 * x, y, 5),
        Rectangle(box, 2 * x, y, 6),
    ]


def photograph(surfaces: list[Rectangle], pose: Pose, camera: Camera = CAMERA, seed: int = 0) -> np.ndarray:
    """(height, width, 3) uint8 BGR with sensor noise; bare grey where nothing is hit. 2x2 samples per pixel."""
    fine = camera.scaled(camera.width_px * 2, camera.height_px * 2)
    rays = fine.rays_camera() @ pose.enu_from_camera.T
    origin = np.array(pose.position_enu_m)
    nearest = np.full(rays.shape[:2], np.inf)
    picture = np.full(rays.shape, 200.0, np.float32)
    for surface in surfaces:
        t, s, r = surface.hit(origin, rays)
        seen = t < nearest
        colour = cv2.remap(surface.texture, (np.where(seen, s, 0) * 100).astype(np.float32),
                           (np.where(seen, r, 0) * 100).astype(np.float32), cv2.INTER_LINEAR)
        picture[seen], nearest[seen] = colour[seen], t[seen]
    small = cv2.resize(picture, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA)
    noisy = small + np.random.default_rng(seed).normal(0.0, 1.0, small.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def looking_at(position: tuple[float, float, float], target: tuple[float, float, float]) -> Pose:
    """A pose at a point, turned to another."""
    yaw, elevation = yaw_elevation_from_forward(np.subtract(target, position))
    return Pose(position, yaw, elevation)


def survey(folder: Path) -> list[SurveyPicture]:
    """Nine pictures of wall_and_box on a 3 x 3 raster 5 m before the wall, baselines along and across."""
    surfaces = wall_and_box()
    pictures = []
    for i, (x, z) in enumerate((x, z) for z in (1.8, 3.0, 4.2) for x in (-1.4, 0.0, 1.4)):
        pose = looking_at((x, -5.0, z), (0.6 * x, 0.0, 3.0))
        path = folder / f"UAV_1_{i}.jpg"
        cv2.imwrite(str(path), photograph(surfaces, pose, seed=i), [cv2.IMWRITE_JPEG_QUALITY, 95])
        pictures.append(SurveyPicture(i, path, CAMERA, pose.enu_from_camera, np.array(pose.position_enu_m)))
    return pictures
