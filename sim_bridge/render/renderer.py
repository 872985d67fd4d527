"""The camera of the simulated world: one interface, two backends."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Protocol

import msgspec

from missions.camera import Camera, Pose
from missions.errors import UserError
from missions.lens import NONE, Distortion
from missions.mission import CameraSpec
from missions.simulation import RenderSpec
from sim_bridge.render.egl import EglRenderer, EglUnavailableError
from sim_bridge.render.geometry import Box
from sim_bridge.render.lens import through_lens, wide_camera
from sim_bridge.render.light import Bytes, Light, make_light
from sim_bridge.render.sensor import SensorNoise
from sim_bridge.scenes.scene import Scene

log = logging.getLogger(__name__)


class Renderer(Protocol):
    """Takes pictures of one scene. Not to be shared between threads."""

    @property
    def backend_name(self) -> str:
        """What renders, e.g. 'egl (llvmpipe ...)'."""

    def render(self, camera: Camera, pose: Pose, boxes: Sequence[Box], noise_key: int) -> Bytes:
        """(height, width, 3) uint8 RGB. boxes: obstacles present now. noise_key seeds this picture's sensor noise."""

    def close(self) -> None:
        """Free what the backend holds."""


class LensRenderer:
    """Pictures of another renderer, which adds no noise, through a lens that distorts; see Renderer."""

    def __init__(self, pinhole: Renderer, lens: Distortion, noise: SensorNoise) -> None:
        self._pinhole, self._lens, self._noise = pinhole, lens, noise

    @property
    def backend_name(self) -> str:
        """Of the renderer behind."""
        return self._pinhole.backend_name

    def render(self, camera: Camera, pose: Pose, boxes: Sequence[Box], noise_key: int) -> Bytes:
        """(height, width, 3) uint8 RGB."""
        drawn = self._pinhole.render(wide_camera(camera, self._lens), pose, boxes, noise_key)
        rgb = through_lens(drawn, camera, self._lens)
        self._noise.add_to(rgb, noise_key)
        return rgb

    def close(self) -> None:
        """Free what the renderer behind holds."""
        self._pinhole.close()


class LateRenderer:
    """A renderer that is made when the first picture is asked for; see Renderer."""

    def __init__(self, make: Callable[[], Renderer]) -> None:
        self._make = make
        self._made: Renderer | None = None

    @property
    def backend_name(self) -> str:
        """Of the renderer, which is made for it."""
        return self._renderer().backend_name

    def render(self, camera: Camera, pose: Pose, boxes: Sequence[Box], noise_key: int) -> Bytes:
        """(height, width, 3) uint8 RGB."""
        return self._renderer().render(camera, pose, boxes, noise_key)

    def close(self) -> None:
        """Free what there is."""
        if self._made is not None:
            self._made.close()

    def _renderer(self) -> Renderer:
        self._made = self._made or self._make()
        return self._made


def make_renderer(scene: Scene, spec: RenderSpec, camera_spec: CameraSpec, seed: int,
                  light: Light | None = None) -> Renderer:
    """The renderer that spec.backend asks for; 'auto' takes EGL where a context can be had, else ray casting. With a
    lens that distorts if camera_spec has one. light: that of spec and seed, where it has been made before.

    Raises UserError when EGL is demanded and cannot be had.
    """
    light = light or make_light(spec, seed)
    if camera_spec.distortion == NONE:
        return _pinhole_renderer(scene, spec, light, camera_spec, seed)
    without_noise = msgspec.structs.replace(camera_spec, noise_dn=0.0)
    return LensRenderer(_pinhole_renderer(scene, spec, light, without_noise, seed), camera_spec.distortion,
                        SensorNoise(camera_spec.noise_dn, seed))


def _pinhole_renderer(scene: Scene, spec: RenderSpec, light: Light, camera_spec: CameraSpec, seed: int) -> Renderer:
    if spec.backend == "raycast":
        return _raycast_renderer(scene, light, camera_spec, seed)
    try:
        return EglRenderer(scene, light, camera_spec, seed)
    except EglUnavailableError as e:
        if spec.backend == "egl":
            raise UserError(f"render.backend = \"egl\": no EGL context can be made ({e}); install libegl1 libgl1 "
                            f"libgl1-mesa-dri or set render.backend to \"auto\".") from e
        log.warning("no EGL context can be made (%s); pictures are ray-cast, which is slower", e)
        return _raycast_renderer(scene, light, camera_spec, seed)


def _raycast_renderer(scene: Scene, light: Light, camera_spec: CameraSpec, seed: int) -> Renderer:
    from sim_bridge.render.raycast import RaycastRenderer  # half a second of imports that EGL does without
    return RaycastRenderer(scene, light, camera_spec, seed)
