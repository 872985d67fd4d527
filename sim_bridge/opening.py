"""A world opened for the first time: made, checked, and kept for whoever takes the place of a bridge that dies.

Apart from `sim_bridge.__main__`, so that such a successor does not import what makes scenes.
"""

from __future__ import annotations

import numpy as np

from missions.disk import Disk
from missions.errors import UserError
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import takeoff_columns, takeoff_points
from missions.run_folder import RunFolder
from sim_bridge.kept_world import world_bytes
from sim_bridge.render.light import Light, make_light
from sim_bridge.scenes.export import export_mesh
from sim_bridge.scenes.load import load_scene
from sim_bridge.scenes.scene import Scene
from sim_bridge.truth import BEFORE_FLIGHT_NS, Truth
from sim_bridge.verdict import write_reference

COLUMN_SAMPLE_M = 0.5
ABOVE_GROUND_M = 0.75
"""Columns are judged from here up; the ground itself, and grass, are no obstacle to a take-off."""


def make_world(mission: Mission) -> tuple[Scene, Light]:
    """The true scene and its light, from the mission file. Raises UserError."""
    return load_scene(mission.scene, mission.site), make_light(mission.render, mission.seed)


def check_and_keep(mission: Mission, folder: RunFolder, scene: Scene, light: Light, site: SiteBrief,
                   truth: Truth) -> None:
    """Before anybody joins: whether the mission can be flown here, and what others read of it. Raises UserError."""
    check_columns(mission, site, truth)
    write_reference(folder, scene, site)
    if mission.knowledge == "mesh" and not mission.prior_path:
        export_mesh(scene, folder.prior)
    Disk(folder.truth).write(folder.world_kept, world_bytes(scene, light))


def check_columns(mission: Mission, site: SiteBrief, truth: Truth) -> None:
    """The operator's word that vehicles take off through free space, held against the truth. Raises UserError."""
    for k, (lower, upper) in enumerate(takeoff_columns(mission, site)):
        bottom = np.array([lower[0], lower[1], site.ground_up_m + ABOVE_GROUND_M])
        axes = [np.arange(a, b + 1e-6, COLUMN_SAMPLE_M) for a, b in zip(bottom, upper, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        room = truth.distance(points, np.full(len(points), BEFORE_FLIGHT_NS))
        if room.min() < 0.5 * COLUMN_SAMPLE_M:
            east, north, up = points[room.argmin()]
            x, y, _ = takeoff_points(mission, site)[k]
            raise UserError(f"mission: the take-off column of vehicle {k + 1}, over ({x:.1f}, {y:.1f}) m, is not free: "
                            f"the scene has something at ({east:.1f}, {north:.1f}, {up:.1f}) m; give "
                            "fleet.takeoff_enu_m points on open ground.")
