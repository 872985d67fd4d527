"""What the referee leaves behind in the run folder: the true surface, and the numbers that were judged by it."""

from __future__ import annotations

import json
from collections.abc import Sequence

import msgspec
import numpy as np
import trimesh

from missions.errors import UserError
from missions.lattice import view_positions
from missions.messages import PictureMeta, SiteBrief
from missions.mission import Mission
from missions.pads import camera_bounds
from missions.run_folder import RunFolder, write_views
from sim_bridge.coverage import Coverage
from sim_bridge.scenes.exposure import Surface, exposed_surface
from sim_bridge.scenes.scene import Scene
from sim_bridge.truth import BEFORE_FLIGHT_NS, Truth
from sim_bridge.world import World

EXPLORE = "explore"

COVERAGE_POINTS = 20_000
REFERENCE_POINTS = 100_000
"""At most one per 4 cm square; a share measured with them is within 0.3 % of the true one (95 %)."""
REFERENCE_SPACING_M = 0.04


def reference_surface(scene: Scene, site: SiteBrief, count: int) -> Surface:
    """Samples, uniform by area, of the object's exposed surface inside the operator's box. Raises UserError where the
    box holds nothing of it."""
    surface = exposed_surface(scene, count)
    points = surface.points_enu_m
    inside = ((points >= site.object_min_enu_m) & (points <= site.object_max_enu_m)).all(axis=1)
    if not inside.any():
        raise UserError("site.object_min_enu_m, object_max_enu_m: nothing of the object can be seen in this box; "
                        "give the object's bounds in ENU metres or leave them out.")
    return Surface(points[inside], surface.normals[inside], surface.faces[inside])


def write_reference(folder: RunFolder, scene: Scene, site: SiteBrief) -> None:
    """The object's mesh (for C2M) and evenly spread points with normals on its exposed surface (for C2C), both with
    the scene's part that each triangle and each sample belongs to."""
    mesh = trimesh.Trimesh(*scene.object_mesh(), process=False)
    mesh.export(folder.truth_mesh)
    count = min(REFERENCE_POINTS, int(mesh.area / REFERENCE_SPACING_M**2))
    surface = reference_surface(scene, site, count)
    parts = [p for p in scene.parts if p.is_object]
    part = np.repeat(np.arange(len(parts), dtype=np.int32), [len(p.faces) for p in parts])
    np.savez(folder.truth_samples, points=surface.points_enu_m.astype(np.float32),
             normals=surface.normals.astype(np.float32), parts=np.array([p.name for p in parts], dtype=np.str_),
             sample_part=part[surface.faces], triangle_part=part)


def leave_verdict(mission: Mission, folder: RunFolder, scene: Scene, site: SiteBrief, truth: Truth, world: World,
                  renderer_name: str) -> None:
    """referee.json and the table of true poses; then nobody needs to take this world up any more."""
    coverage = judge_coverage(mission, scene, site, truth, world.true_pictures)
    verdict = {**world.referee.summary(), "coverage": coverage.summary(), "pictures": len(world.true_pictures),
               "renderer": renderer_name, "notes": scene.notes, "site": msgspec.to_builtins(site)}
    folder.referee.write_text(json.dumps(verdict, indent=1), encoding="utf-8")
    write_views(folder.truth_views, [folder.view_row(m) for m in world.true_pictures])
    folder.world_kept.unlink(missing_ok=True)


def judge_coverage(mission: Mission, scene: Scene, site: SiteBrief, truth: Truth,
                   pictures: Sequence[PictureMeta]) -> Coverage:
    """What of the object exploration's pictures have seen, and what of it could be seen from where the mission's views
    may stand. pictures: with their true poses."""
    points = reference_surface(scene, site, COVERAGE_POINTS).points_enu_m
    coverage = Coverage(truth, points, mission.explore.sensing_range_m)
    for picture in pictures:
        if picture.phase == EXPLORE:
            coverage.add(picture)
    positions = view_positions(*camera_bounds(mission, site), mission.explore)
    clearance = truth.distance(positions, np.full(len(positions), BEFORE_FLIGHT_NS))
    coverage.reach(positions[clearance >= mission.fleet.clearance_m], mission.explore, mission.camera.explore_camera())
    return coverage
