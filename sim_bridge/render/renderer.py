"""The camera of the simulated world: one interface, two backends."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Protocol

from missions.camera import Camera, Pose
from missions.errors import UserError
from missions.mission import CameraSpec, RenderSpec
from sim_bridge.render.egl import EglRenderer, EglUnavailableError
from sim_bridge.render.geometry import Box
from sim_bridge.render.light import Bytes
from sim_bridge.render.raycast import RaycastRenderer
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


def make_renderer(scene: Scene, spec: RenderSpec, camera_spec: CameraSpec, seed: int) -> Renderer:
    """The renderer that spec.backend asks for; 'auto' takes EGL where a context can be had, else ray casting.

    Raises UserError when EGL is demanded and cannot be had.
    """
    if spec.backend == "raycast":
        return RaycastRenderer(scene, spec, camera_spec, seed)
    try:
        return EglRenderer(scene, spec, camera_spec, seed)
    except EglUnavailableError as e:
        if spec.backend == "egl":
            raise UserError(f"render.backend = \"egl\": no EGL context can be made ({e}); install libegl1 libgl1 "
                            f"libgl1-mesa-dri or set render.backend to \"auto\".") from e
        log.warning("no EGL context can be made (%s); pictures are ray-cast, which is slower", e)
        return RaycastRenderer(scene, spec, camera_spec, seed)
