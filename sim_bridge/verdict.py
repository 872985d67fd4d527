"""What the referee leaves behind in the run folder: the true surface, and the numbers that are judged by it."""

from __future__ import annotations

import json

import numpy as np
import trimesh

from missions.frames import Array
from missions.run_folder import RunFolder
from sim_bridge.scenes.scene import Scene

COVERAGE_POINTS = 20_000
REFERENCE_SPACING_M = 0.04
REFERENCE_POINTS = 400_000


def exposed_points(scene: Scene, count: int) -> tuple[Array, Array]:
    vertices, faces = scene.object_mesh()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    points, index = trimesh.sample.sample_surface(mesh, count, seed=1)
    return np.asarray(points), np.asarray(mesh.face_normals)[index]


def write_reference(folder: RunFolder, scene: Scene) -> None:
    """The object's mesh for C2M and evenly spread points with normals on its exposed surface for C2C."""
    vertices, faces = scene.object_mesh()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.export(folder.truth_mesh)
    points, normals = exposed_points(scene, min(REFERENCE_POINTS, int(mesh.area / REFERENCE_SPACING_M**2)))
    np.savez(folder.truth_samples, points=points.astype(np.float32), normals=normals.astype(np.float32))


def write_verdict(folder: RunFolder, verdict: dict[str, object]) -> None:
    """referee.json."""
    folder.referee.write_text(json.dumps(verdict, indent=1), encoding="utf-8")
