"""What the referee leaves behind in the run folder: the true surface, and the numbers that were judged by it."""

from __future__ import annotations

import json

import numpy as np
import trimesh

from missions.errors import UserError
from missions.messages import SiteBrief
from missions.run_folder import RunFolder
from sim_bridge.scenes.exposure import Surface, exposed_surface
from sim_bridge.scenes.scene import Scene

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


def write_verdict(folder: RunFolder, verdict: dict[str, object]) -> None:
    """referee.json."""
    folder.referee.write_text(json.dumps(verdict, indent=1), encoding="utf-8")
