"""Pictures by casting rays with Embree and shading in numpy: slower, but needs no graphics driver."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.ray.ray_pyembree import RayMeshIntersector

from missions.camera import Camera, Pose
from missions.mission import CameraSpec
from sim_bridge.render import light as look
from sim_bridge.render.geometry import Box, Geometry, boxes_geometry, geometry_of, merged
from sim_bridge.render.light import Bytes, Floats, Light
from sim_bridge.render.sampling import Pyramid, Volume, sample_dome
from sim_bridge.render.sensor import SensorNoise
from sim_bridge.scenes.scene import Scene

SUBPIXELS = 2
"""Rays per pixel along each axis up to SUPERSAMPLED_WIDTH_PX; above, one ray per pixel, because four take too long."""
SUPERSAMPLED_WIDTH_PX = 640
_CHUNK_RAYS = 1 << 16
_SHADOW_OFFSET_M = 0.005


@dataclass(frozen=True)
class _World:
    """Geometry ready for casting; edge vectors and normals per face, texture index per face (-1: none)."""

    geometry: Geometry
    caster: RayMeshIntersector
    corner: NDArray[np.float64]
    edges: NDArray[np.float64]
    normal: NDArray[np.float64]
    pyramid_of_face: NDArray[np.int32]
    pyramids: list[Pyramid]
    uv_per_m: Floats
    water: NDArray[np.bool_]


class RaycastRenderer:
    """Renderer of one scene; see renderer.Renderer."""

    def __init__(self, scene: Scene, light: Light, camera_spec: CameraSpec, seed: int) -> None:
        self._ground_up_m, self._seed = scene.ground_up_m, seed
        self._noise = SensorNoise(camera_spec.noise_dn, seed)
        self._light = light
        self._grain = Volume(self._light.grain)
        self._static = geometry_of(scene.parts)
        self._boxes: tuple[Box, ...] = ()
        self._world = _make_world(self._static)
        self._pool = ThreadPoolExecutor(os.cpu_count())

    @property
    def backend_name(self) -> str:
        """Backend and driver."""
        return "raycast (Embree)"

    def render(self, camera: Camera, pose: Pose, boxes: Sequence[Box], noise_key: int) -> Bytes:
        """(height, width, 3) uint8 RGB."""
        self._set_boxes(boxes)
        n = SUBPIXELS if camera.width_px <= SUPERSAMPLED_WIDTH_PX else 1
        fine = camera.scaled(camera.width_px * n, camera.height_px * n)
        rays = fine.rays_camera().reshape(-1, 3)
        eye, turn = np.array(pose.position_enu_m), pose.enu_from_camera.T
        chunks = [rays[start:start + _CHUNK_RAYS] for start in range(0, len(rays), _CHUNK_RAYS)]
        drift = look.wave_drift(self._seed, noise_key)
        color = np.concatenate(list(self._pool.map(
            lambda chunk: self._shade(chunk @ turn, eye, fine.fx_px, drift), chunks)))
        color = color.reshape(camera.height_px, n, camera.width_px, n, 3).mean(axis=(1, 3))
        rgb = np.asarray(np.clip(color, 0, 1) * 255 + 0.5, np.uint8)
        self._noise.add_to(rgb, noise_key)
        return rgb

    def close(self) -> None:
        """Stop the threads."""
        self._pool.shutdown()

    def _set_boxes(self, boxes: Sequence[Box]) -> None:
        wanted = tuple((tuple(center), tuple(size)) for center, size in boxes)
        if wanted != self._boxes:
            self._boxes = wanted
            self._world = _make_world(merged(self._static, boxes_geometry(wanted)))

    def _shade(self, rays_enu: NDArray[np.float64], eye: NDArray[np.float64], focal_px: float,
               drift: Floats) -> Floats:
        """(n, 3) display colours 0-1 along rays whose depth component is 1. drift: (2, 3) of the waves."""
        world = self._world
        face = world.caster.intersects_first(np.broadcast_to(eye, rays_enu.shape), rays_enu)
        color = np.empty((len(rays_enu), 3), np.float32)
        missed, hit = np.flatnonzero(face < 0), np.flatnonzero(face >= 0)
        color[missed] = self._background(rays_enu[missed], eye, focal_px)
        face, ray = face[hit], rays_enu[hit]
        normal = world.normal[face]
        slope = np.einsum("ij,ij->i", ray, normal)
        normal = np.where(slope[:, None] > 0, -normal, normal)
        slope = np.maximum(np.abs(slope), 1e-9)
        depth = np.abs(np.einsum("ij,ij->i", world.corner[face] - eye, normal)) / slope
        point = eye + ray * depth[:, None]
        footprint_m = depth / focal_px * np.sqrt(np.linalg.norm(ray, axis=1) / slope)
        albedo = self._albedo(face, point, footprint_m)
        color[hit] = look.developed(albedo * self._irradiance(point, normal))
        wet = world.water[face]
        color[hit[wet]] = self._water(ray[wet], point[wet], footprint_m[wet], drift)
        return color

    def _water(self, rays_enu: NDArray[np.float64], point: NDArray[np.float64], footprint_m: NDArray[np.float64],
               drift: Floats) -> Floats:
        """(n, 3) display colours of water at points (n, 3) that mirrors the sky."""
        slope = np.zeros((len(point), 2), np.float32)
        flat = point * (1.0, 1.0, 0.0)
        for tilt, period_m, start in zip(look.WAVE_SLOPES, look.WAVE_PERIODS_M, drift, strict=True):
            slope += tilt * (self._grain.sample(flat / period_m + start, footprint_m / period_m) - 0.5)
        normal = np.column_stack([-slope, np.ones(len(slope))])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        direction = rays_enu / np.linalg.norm(rays_enu, axis=1, keepdims=True)
        facing = np.einsum("ij,ij->i", direction, normal)[:, None]
        mirrored = look.WATER_MIRROR + (1.0 - look.WATER_MIRROR) * (1.0 - np.clip(-facing, 0.0, 1.0)) ** 5
        up = direction - 2.0 * facing * normal
        up[:, 2] = np.abs(up[:, 2])
        out_of_it = look.developed(np.array(look.WATER_COLOR) ** 2 * look.land_irradiance(self._light.to_sun_enu))
        return np.asarray(out_of_it * (1.0 - mirrored) + sample_dome(self._light.sky, up) * mirrored, np.float32)

    def _background(self, rays_enu: NDArray[np.float64], eye: NDArray[np.float64], focal_px: float) -> Floats:
        """(n, 3) display colours of the sky and of the plain under it."""
        direction = rays_enu / np.linalg.norm(rays_enu, axis=1, keepdims=True)
        color = sample_dome(self._light.sky, direction)
        down = np.flatnonzero(direction[:, 2] < 0)
        falling = np.maximum(-direction[down, 2], 1e-5)
        range_m = max(eye[2] - self._ground_up_m, 0.1) / falling
        land_m = np.column_stack([eye[:2] + direction[down, :2] * range_m[:, None], np.zeros(len(down))])
        stain = np.zeros((len(down), 2), np.float32)
        for weight, period_m, layer in zip(look.LAND_GRAIN, look.LAND_PERIODS_M, (0.37, 0.11), strict=True):
            grain = self._grain.sample(land_m / period_m + [0, 0, layer], range_m / falling / focal_px / period_m)
            stain += np.float32(weight) * (grain - 0.5)
        pattern = np.maximum(1 + stain[:, :1] + stain[:, 1:] * look.LAND_HUE, look.GRAIN_FLOOR)
        lit = look.developed(np.array(look.LAND_COLOR) ** 2 * pattern * look.land_irradiance(self._light.to_sun_enu))
        near = np.exp(-range_m / look.HAZE_M)[:, None]
        color[down] = color[down] * (1 - near) + lit * near
        return color

    def _albedo(self, face: NDArray[np.int64], point: NDArray[np.float64], footprint_m: NDArray[np.float64]) -> Floats:
        world, geometry = self._world, self._world.geometry
        tint = geometry.color[geometry.faces[face, 0]].astype(np.float32) / 255
        albedo = tint[:, :3] ** 2
        uv = _uv_at(world, face, point)
        for i, pyramid in enumerate(world.pyramids):
            mine = np.flatnonzero(world.pyramid_of_face[face] == i)
            if len(mine):
                albedo[mine] *= pyramid.sample(uv[mine], footprint_m[mine] * world.uv_per_m[face[mine]]) ** 2
        stain = np.zeros((len(face), 2), np.float32)
        scales = zip(look.GRAIN_WEIGHTS, look.GRAIN_PERIODS_M, self._light.grain_from_enu, strict=True)
        for weight, period_m, rotation in scales:
            stain += weight * (self._grain.sample(point @ rotation.T / period_m, footprint_m / period_m) - 0.5)
        hue = np.array(look.GRAIN_HUE, np.float32)
        grain = 1 + tint[:, 3:] * (look.GRAIN_LUMA * stain[:, :1] + stain[:, 1:] * hue)
        return np.asarray(albedo * np.maximum(grain, look.GRAIN_FLOOR), np.float32)

    def _irradiance(self, point: NDArray[np.float64], normal: NDArray[np.float64]) -> Floats:
        to_sun = self._light.to_sun_enu
        facing = normal @ to_sun
        lit = np.maximum(facing, 0)
        sunny = np.flatnonzero(facing > 0)
        if len(sunny):
            origin = point[sunny] + normal[sunny] * _SHADOW_OFFSET_M
            blocked = self._world.caster.intersects_any(origin, np.broadcast_to(to_sun, origin.shape))
            lit[sunny[blocked]] = 0
        up = 0.5 + 0.5 * normal[:, 2:]
        ambient = (1 - up) * look.GROUND_AMBIENT + up * look.SKY_AMBIENT
        ambient = ambient * (1 - look.AMBIENT_TURN * facing[:, None])
        return np.asarray(np.array(look.SUN_COLOR) * lit[:, None] + ambient, np.float32)


def _make_world(geometry: Geometry) -> _World:
    triangles = geometry.positions_enu_m[geometry.faces].astype(np.float64)
    edges = triangles[:, 1:] - triangles[:, :1]
    cross = np.cross(edges[:, 0], edges[:, 1])
    length = np.maximum(np.linalg.norm(cross, axis=1), 1e-20)
    uv = geometry.uv[geometry.faces]
    uv_edges = uv[:, 1:] - uv[:, :1]
    uv_area = np.abs(uv_edges[:, 0, 0] * uv_edges[:, 1, 1] - uv_edges[:, 0, 1] * uv_edges[:, 1, 0])
    pyramid_of_face = np.full(len(geometry.faces), -1, np.int32)
    water = np.zeros(len(geometry.faces), np.bool_)
    for batch in geometry.batches:
        water[batch.first_face:batch.first_face + batch.face_count] = batch.water
    textured = [batch for batch in geometry.batches if batch.texture is not None]
    for i, batch in enumerate(textured):
        pyramid_of_face[batch.first_face:batch.first_face + batch.face_count] = i
    mesh = trimesh.Trimesh(geometry.positions_enu_m, geometry.faces, process=False, validate=False)
    pyramids = [Pyramid(batch.texture) for batch in textured if batch.texture is not None]
    return _World(geometry, RayMeshIntersector(mesh), triangles[:, 0], edges, cross / length[:, None],
                  pyramid_of_face, pyramids, np.sqrt(uv_area / length).astype(np.float32), water)


def _uv_at(world: _World, face: NDArray[np.int64], point: NDArray[np.float64]) -> Floats:
    """(n, 2) texture coordinates by barycentric weights."""
    a, b = world.edges[face, 0], world.edges[face, 1]
    d = point - world.corner[face]
    aa, ab, bb = (np.einsum("ij,ij->i", x, y) for x, y in ((a, a), (a, b), (b, b)))
    da, db = np.einsum("ij,ij->i", d, a), np.einsum("ij,ij->i", d, b)
    area = np.maximum(aa * bb - ab * ab, 1e-30)
    v, w = (bb * da - ab * db) / area, (aa * db - ab * da) / area
    uv = world.geometry.uv[world.geometry.faces[face]]
    return np.asarray(uv[:, 0] + v[:, None] * (uv[:, 1] - uv[:, 0]) + w[:, None] * (uv[:, 2] - uv[:, 0]), np.float32)
