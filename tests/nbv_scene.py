"""A cube of six metres on a plain, whose visible points are known in closed form."""

from __future__ import annotations

import numpy as np
import trimesh

from missions.mission import CameraSpec
from sim_bridge.nbv.arena import Arena, arena_of
from sim_bridge.nbv.rules import Rules
from sim_bridge.scenes.scene import Part, Scene

HALF_M = 3.0
RULES = Rules(poses=9, positions=40, points=1500, camera=CameraSpec(explore_px=(152, 86)))


def cube_scene() -> Scene:
    """The cube stands on the plain, its middle over the origin."""
    box = trimesh.creation.box(bounds=[[-HALF_M, -HALF_M, 0.0], [HALF_M, HALF_M, 2.0 * HALF_M]])
    plain = 60.0 * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    cube = Part("cube", np.asarray(box.vertices), np.asarray(box.faces, np.int32), None, None, (180, 150, 120), True,
                True)
    ground = Part("ground", plain, np.array([[0, 1, 2], [0, 2, 3]], np.int32), None, None, (110, 120, 80), False, True)
    return Scene("cube", [cube, ground], (-HALF_M, -HALF_M, 0.0), (HALF_M, HALF_M, 2.0 * HALF_M), 0.0)


def cube_arena(rules: Rules = RULES) -> Arena:
    """The cube made ready for trials."""
    return arena_of(cube_scene(), "cube", rules)
