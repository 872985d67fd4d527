"""Pictures by OpenGL on an EGL context without a window (Mesa's llvmpipe where there is no GPU)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.mission import CameraSpec
from sim_bridge.render import shaders
from sim_bridge.render.geometry import Box, Geometry, boxes_geometry, geometry_of
from sim_bridge.render.light import GRAIN_PERIODS_M, Bytes, Light, land_irradiance, wave_drift
from sim_bridge.render.sensor import SensorNoise
from sim_bridge.render.shadow import fit_shadow
from sim_bridge.scenes.scene import Scene

NEAR_M, FAR_M = 0.2, 1500.0
SUPERSAMPLING, SUPERSAMPLING_LARGE = 2.0, 1.5
"""Drawn pixels per picture pixel along each axis, up to LARGE_WIDTH_PX and above it. On llvmpipe both cost less than 4x
multisampling; 1.5 leaves the same error at edges, 2.0 leaves a quarter less."""
LARGE_WIDTH_PX = 1024

PICTURE_UNIT, GRAIN_UNIT, SHADOW_UNIT, SKY_UNIT = range(4)


class EglUnavailableError(Exception):
    """No EGL context can be made on this machine."""


@dataclass(frozen=True)
class _Draw:
    """Part of a vertex array and the texture it needs."""

    vertex_array: Any
    first: int
    count: int
    texture: Any


@dataclass(frozen=True)
class _Uploaded:
    """Geometry on the driver's side: draw calls, the vertex array that casts shadows, and all there is to free."""

    draws: list[_Draw]
    caster: Any
    owned: list[Any]


@dataclass(frozen=True)
class _Target:
    """Where a picture is drawn, the same as a texture, and where it is averaged down to its size."""

    drawn: Any
    picture: Any
    averaged: Any


class EglRenderer:
    """Renderer of one scene; see renderer.Renderer."""

    def __init__(self, scene: Scene, light: Light, camera_spec: CameraSpec, seed: int) -> None:
        """Raises EglUnavailableError."""
        self._context = _make_context()
        self._ground_up_m, self._seed = scene.ground_up_m, seed
        self._noise = SensorNoise(camera_spec.noise_dn, seed)
        self._light = light
        self._shadow_frame = fit_shadow(scene, self._light.to_sun_enu)
        self._make_programs()
        self._scene = self._upload(geometry_of(scene.parts))
        self._boxes: tuple[Box, ...] = ()
        self._obstacles = self._upload(boxes_geometry(()))
        self._targets: dict[tuple[int, int], _Target] = {}
        self._draw_shadow()

    @property
    def backend_name(self) -> str:
        """Backend and driver."""
        return f"egl ({self._context.info['GL_RENDERER']})"

    def render(self, camera: Camera, pose: Pose, boxes: Sequence[Box], noise_key: int) -> Bytes:
        """(height, width, 3) uint8 RGB."""
        with self._context:
            self._set_boxes(boxes)
            self._set_camera(camera, pose)
            self._water_program["drift"].write(wave_drift(self._seed, noise_key))
            rgb = self._draw(self._target(camera.width_px, camera.height_px))
        self._noise.add_to(rgb, noise_key)
        return rgb

    def _draw(self, target: _Target) -> Bytes:
        target.drawn.use()
        target.drawn.clear(depth=1.0)
        for draw in [*self._scene.draws, *self._obstacles.draws]:
            if draw.texture is not None:
                draw.texture.use(PICTURE_UNIT)
            draw.vertex_array.render(first=draw.first, vertices=draw.count)
        self._sky.render(vertices=3)
        target.picture.use(PICTURE_UNIT)
        target.averaged.use()
        self._average.render(vertices=3)
        width, height = target.averaged.size
        rgb = np.empty((height, width, 3), np.uint8)
        target.averaged.read_into(rgb, components=3, alignment=1)
        return rgb

    def close(self) -> None:
        """Free the context and all that lives in it."""
        self._context.release()

    def _make_programs(self) -> None:
        c, frame = self._context, self._shadow_frame
        c.enable(moderngl.DEPTH_TEST)
        c.disable(moderngl.CULL_FACE)
        c.depth_func = "<="
        self._programs = [c.program(shaders.SURFACE_VERTEX, shaders.surface_fragment(t)) for t in (False, True)]
        self._shadow_program = c.program(shaders.SHADOW_VERTEX, shaders.SHADOW_FRAGMENT)
        self._shadow_program["shadow_clip_from_enu"].write(_gl(frame.clip_from_enu))
        grain_from_enu = self._light.grain_from_enu / np.array(GRAIN_PERIODS_M, np.float32)[:, None, None]
        for program in self._programs:
            program["grain_from_enu"].write(np.ascontiguousarray(grain_from_enu.transpose(0, 2, 1)))
            program["to_sun_enu"].value = tuple(self._light.to_sun_enu)
            program["shadow_from_enu"].write(_gl(frame.texture_from_enu))
            program["shadow_offset_m"].value = frame.offset_m
            program["grain"].value, program["shadow"].value = GRAIN_UNIT, SHADOW_UNIT
        self._programs[1]["picture"].value = PICTURE_UNIT
        self._water_program = c.program(shaders.WATER_VERTEX, shaders.water_fragment())
        self._water_program["sky"].value, self._water_program["grain"].value = SKY_UNIT, GRAIN_UNIT
        self._water_program["land_irradiance"].value = tuple(land_irradiance(self._light.to_sun_enu))
        self._make_shared_textures()

    def _make_shared_textures(self) -> None:
        c, grain, sky = self._context, self._light.grain, self._light.sky
        volume = c.texture3d(grain.shape[:3], 2, grain.tobytes())
        volume.build_mipmaps()
        volume.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        volume.use(GRAIN_UNIT)
        dome = c.texture(sky.shape[1::-1], 3, sky.tobytes(), alignment=1)
        dome.repeat_x = dome.repeat_y = False
        dome.use(SKY_UNIT)
        sky_program = c.program(shaders.SKY_VERTEX, shaders.sky_fragment())
        sky_program["sky"].value, sky_program["grain"].value = SKY_UNIT, GRAIN_UNIT
        sky_program["land_irradiance"].value = tuple(land_irradiance(self._light.to_sun_enu))
        self._sky_program, self._sky = sky_program, c.vertex_array(sky_program, [])
        average_program = c.program(shaders.AVERAGE_VERTEX, shaders.AVERAGE_FRAGMENT)
        average_program["picture"].value = PICTURE_UNIT
        self._average = c.vertex_array(average_program, [])
        self._shadow_map = c.depth_texture(self._shadow_frame.size_px)
        self._shadow_map.compare_func = "<="
        self._shadow_map.filter = (moderngl.LINEAR, moderngl.LINEAR)
        self._shadow_map.repeat_x = self._shadow_map.repeat_y = False
        self._shadow_map.use(SHADOW_UNIT)
        self._shadow_target = c.framebuffer(depth_attachment=self._shadow_map)
        self._shared = (volume, dome)

    def _upload(self, geometry: Geometry) -> _Uploaded:
        if not len(geometry.faces):
            return _Uploaded([], None, [])
        c = self._context
        buffers = [c.buffer(np.ascontiguousarray(array))
                   for array in (geometry.positions_enu_m, geometry.color, geometry.uv, geometry.faces)]
        positions, color, uv, faces = buffers
        plain = [(positions, "3f", "in_position"), (color, "4f1", "in_color")]
        arrays = [c.vertex_array(self._programs[0], plain, faces),
                  c.vertex_array(self._programs[1], [*plain, (uv, "2f", "in_uv")], faces),
                  c.vertex_array(self._water_program, plain[:1], faces)]
        caster = c.vertex_array(self._shadow_program, plain[:1], faces)
        draws = [_Draw(arrays[2 if batch.water else int(batch.texture is not None)],
                       3 * batch.first_face, 3 * batch.face_count,
                       None if batch.texture is None else self._upload_texture(batch.texture))
                 for batch in geometry.batches]
        textures = [draw.texture for draw in draws if draw.texture is not None]
        return _Uploaded(draws, caster, [caster, *arrays, *buffers, *textures])

    def _upload_texture(self, texture: Bytes) -> Any:
        h, w = texture.shape[:2]
        uploaded = self._context.texture((w, h), 3, np.ascontiguousarray(texture[::-1]), alignment=1)
        uploaded.build_mipmaps()
        uploaded.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        return uploaded

    def _draw_shadow(self) -> None:
        self._shadow_target.use()
        self._shadow_target.clear(depth=1.0)
        for uploaded in (self._scene, self._obstacles):
            if uploaded.caster is not None:
                uploaded.caster.render()

    def _set_boxes(self, boxes: Sequence[Box]) -> None:
        wanted = tuple((tuple(center), tuple(size)) for center, size in boxes)
        if wanted != self._boxes:
            self._boxes = wanted
            for owned in self._obstacles.owned:
                owned.release()
            self._obstacles = self._upload(boxes_geometry(wanted))
            self._draw_shadow()

    def _set_camera(self, camera: Camera, pose: Pose) -> None:
        clip_from_camera = projection(camera)
        clip_from_enu = clip_from_camera @ pose.camera_from_enu
        for program in (*self._programs, self._water_program):
            program["clip_from_enu"].write(_gl(clip_from_enu))
            program["eye_enu_m"].value = pose.position_enu_m
        enu_from_clip = pose.enu_from_camera @ np.linalg.inv(clip_from_camera[[0, 1, 3], :3])
        east, north, up = pose.position_enu_m
        self._sky_program["eye_above_ground_m"].value = (east, north, up - self._ground_up_m)
        self._sky_program["enu_from_clip"].write(_gl(enu_from_clip))

    def _target(self, width: int, height: int) -> _Target:
        """Framebuffers of one picture size, made once."""
        if (width, height) not in self._targets:
            c, factor = self._context, SUPERSAMPLING if width <= LARGE_WIDTH_PX else SUPERSAMPLING_LARGE
            fine = round(width * factor), round(height * factor)
            picture = c.texture(fine, 4)
            picture.repeat_x = picture.repeat_y = False
            drawn = c.framebuffer([picture], c.depth_renderbuffer(fine))
            averaged = c.framebuffer([c.renderbuffer((width, height))])
            self._targets[width, height] = _Target(drawn, picture, averaged)
        return self._targets[width, height]


def projection(camera: Camera) -> NDArray[np.float64]:
    """(4, 4) clip_from_camera; clip y points down, so that the first row read back is the top of the picture."""
    w, h = camera.width_px, camera.height_px
    depth = (FAR_M + NEAR_M) / (FAR_M - NEAR_M), -2 * FAR_M * NEAR_M / (FAR_M - NEAR_M)
    return np.array([[2 * camera.fx_px / w, 0, 2 * camera.cx_px / w - 1, 0],
                     [0, 2 * camera.fy_px / h, 2 * camera.cy_px / h - 1, 0],
                     [0, 0, *depth],
                     [0, 0, 1, 0]])


def _make_context() -> Any:
    try:
        settings: dict[str, Any] = {"backend": "egl", "libgl": "libGL.so.1", "libegl": "libEGL.so.1"}
        return moderngl.create_context(require=330, standalone=True, **settings)
    except Exception as e:  # moderngl raises bare Exception, glcontext its own and ImportError
        raise EglUnavailableError(str(e)) from e


def _gl(matrix: NDArray[np.float64]) -> bytes:
    """Column-major float32 bytes."""
    return matrix.T.astype(np.float32).tobytes()
