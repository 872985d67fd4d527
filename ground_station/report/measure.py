"""The reconstruction of a run against the truth that the referee left."""

from __future__ import annotations

import numpy as np
import trimesh

from ground_station.report.run_data import RunData
from missions.run_folder import RunFolder
from perception.evaluate.comparison import RESAMPLE_M, Comparison, compare
from perception.evaluate.reference import Reference
from perception.reconstruct.cloud import read_cloud


def measure(data: RunData) -> Comparison | None:
    """What lies in the run's region against the exposed surface. None, with a note, when cloud or truth is missing."""
    run = data.run
    absent = [p.relative_to(run.root).as_posix() for p in (run.cloud, run.truth_samples, run.truth_mesh)
              if not p.is_file()]
    if absent:
        data.notes.append(f"{', '.join(absent)} missing: the reconstruction was not measured.")
        return None
    cloud = read_cloud(run.cloud)
    return compare(cloud.select(data.region().contains(cloud.points_enu_m)), read_truth(run),
                   max(RESAMPLE_M, data.mission.reconstruct.cloud_spacing_m))


def read_truth(run: RunFolder) -> Reference:
    """The true object, its parts as the scene names them; a run that kept no parts has one."""
    mesh = trimesh.load_mesh(run.truth_mesh, process=False)
    with np.load(run.truth_samples) as stored:
        points, normals = (stored[name].astype(np.float64) for name in ("points", "normals"))
        named = "parts" in stored
        parts = tuple(str(name) for name in stored["parts"]) if named else ("object",)
        sample_part = stored["sample_part"].astype(np.int64) if named else np.zeros(len(points), np.int64)
        triangle_part = stored["triangle_part"].astype(np.int64) if named else np.zeros(len(mesh.faces), np.int64)
    return Reference(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64), points, normals, parts,
                     triangle_part, sample_part)
