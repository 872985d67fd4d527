"""What the referee leaves behind in the run folder: the true surface, and the numbers that were judged by it."""

from __future__ import annotations

import json

import numpy as np
import trimesh

from missions.errors import UserError
from missions.frames import Array
from missions.messages import SiteBrief
from missions.run_folder import RunFolder
from sim_bridge.scenes.exposure import exposed_surface
from sim_bridge.scenes.scene import Scene

COVERAGE_POINTS = 20_000
REFERENCE_POINTS = 100_000
"""At most one per 4 cm square; a share measured with them is within 0.3 % of the true one (95 %)."""
REFERENCE_SPACING_M = 0.04


def reference_points(scene: Scene, site: SiteBrief, count: int) -> tuple[Array, Array]:
    """Points (n, 3) ENU metres and unit normals (n, 3): samples, uniform by area, of the object's exposed surface
    inside the operator's box. Raises UserError where the box holds nothing of it."""
    surface = exposed_surface(scene, count)
    points = surface.points_enu_m
    inside = ((points >= site.object_min_enu_m) & (points <= site.object_max_enu_m)).all(axis=1)
    if not inside.any():
        raise UserError("site.object_min_enu_m, object_max_enu_m: nothing of the object can be seen in this box; "
                        "give the object's bounds in ENU metres or leave them out.")
    return points[inside], surface.normals[inside]


def write_reference(folder: RunFolder, scene: Scene, site: SiteBrief) -> None:
    """The object's mesh (for C2M) and evenly spread points with normals on its exposed surface (for C2C)."""
    mesh = trimesh.Trimesh(*scene.object_mesh(), process=False)
    mesh.export(folder.truth_mesh)
    count = min(REFERENCE_POINTS, int(mesh.area / REFERENCE_SPACING_M**2))
    points, normals = reference_points(scene, site, count)
    np.savez(folder.truth_samples, points=points.astype(np.float32), normals=normals.astype(np.float32))


def write_verdict(folder: RunFolder, verdict: dict[str, object]) -> None:
    """referee.json."""
    folder.referee.write_text(json.dumps(verdict, indent=1), encoding="utf-8")
