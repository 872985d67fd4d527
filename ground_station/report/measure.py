"""The reconstruction of a run against the truth that the referee left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from ground_station.report.run_data import RunData, read_views
from missions.run_folder import RunFolder
from perception.evaluate.comparison import RESAMPLE_M, Comparison, compare
from perception.evaluate.inspection import Asked, Inspection, Shot, inspect
from perception.evaluate.reference import Reference
from perception.reconstruct.cloud import read_cloud


@dataclass(frozen=True)
class Measured:
    """The cloud beside the truth, and how well the survey's pictures show the true surface."""

    comparison: Comparison
    inspection: Inspection
    asked: Asked


def measure(data: RunData) -> Measured | None:
    """What lies in the run's region against the exposed surface. None, with a note, when cloud or truth is missing."""
    run = data.run
    absent = [p.relative_to(run.root).as_posix() for p in (run.cloud, run.truth_samples, run.truth_mesh)
              if not p.is_file()]
    if absent:
        data.notes.append(f"{', '.join(absent)} missing: the reconstruction was not measured.")
        return None
    cloud = read_cloud(run.cloud)
    truth = read_truth(run)
    found = compare(cloud.select(data.region().contains(cloud.points_enu_m)), truth,
                    max(RESAMPLE_M, data.mission.reconstruct.cloud_spacing_m))
    asked = Asked(data.mission.survey.gsd_m, data.mission.camera.exposure_s)
    return Measured(found, inspect(truth, _shots(data), asked), asked)


def _shots(data: RunData) -> list[Shot]:
    """From where the pictures were really taken, where that is known."""
    camera = data.mission.camera.survey_camera()
    views = read_views(data.run.truth_views) or data.views
    return [Shot(camera, v.enu_from_camera, v.position_enu_m, v.speed_m_s) for v in views if v.phase == "survey"]


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
