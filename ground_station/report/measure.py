"""The reconstruction of a run against the truth that the referee left."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
import trimesh
from numpy.typing import NDArray

from ground_station.report.run_data import RunData, read_views
from missions.lattice import lattice_positions
from missions.messages import SiteBrief
from missions.pads import camera_bounds
from missions.run_folder import RunFolder
from perception.evaluate.comparison import RESAMPLE_M, Comparison, compare
from perception.evaluate.ground import without_ground
from perception.evaluate.inspection import STEREO_PICTURES, Asked, Inspection, Shot, inspect
from perception.evaluate.reachable import Stand, reachable_pictures
from perception.evaluate.reference import Reference
from perception.reconstruct.cloud import read_cloud
from planning.nbv.survey import SurveyViewSpec

STEP_M = 2.0
"""Between the places that are asked whether the surface can be seen from them."""


@dataclass(frozen=True)
class Measured:
    """The cloud beside the truth, and how well the survey's pictures show the true surface."""

    comparison: Comparison
    inspection: Inspection
    asked: Asked
    reachable: NDArray[np.bool_] | None
    """(n,) the samples of the reference that enough pictures from within reach could show; None where the camera bounds
    are unknown."""


def measure(data: RunData) -> Measured | None:
    """What lies in the run's region against the exposed surface. None, with a note, when cloud or truth is missing."""
    run = data.run
    absent = [p.relative_to(run.root).as_posix() for p in (run.cloud, run.truth_samples, run.truth_mesh)
              if not p.is_file()]
    if absent:
        data.notes.append(f"{', '.join(absent)} missing: the reconstruction was not measured.")
        return None
    cloud = read_cloud(run.cloud)
    cloud, truth = cloud.select(data.region().contains(cloud.points_enu_m)), read_truth(run)
    if data.ground_up_m is not None:
        cloud = without_ground(cloud, truth, data.ground_up_m)
    found = compare(cloud, truth, max(RESAMPLE_M, data.mission.reconstruct.cloud_spacing_m))
    asked = Asked(data.mission.survey.gsd_m, data.mission.camera.exposure_s)
    return Measured(found, inspect(truth, _shots(data), asked), asked, _reachable(data, truth))


def _reachable(data: RunData, truth: Reference) -> NDArray[np.bool_] | None:
    """Whether three places of the camera bounds with the mission's clearance from the true surface, as near as the
    survey's views stand, see a sample."""
    told = data.flight.get("site") or data.referee.get("site")
    if not told:
        return None
    places = lattice_positions(*camera_bounds(data.mission, msgspec.convert(told, SiteBrief)), STEP_M)
    range_m = SurveyViewSpec.of(data.mission.survey).sight.farthest_m
    stand = Stand(data.mission.fleet.clearance_m, range_m)
    return reachable_pictures(truth, places, stand, STEREO_PICTURES) >= STEREO_PICTURES


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
