"""The map that survey pictures complete: where poses are measured, it is made at the aligned ones."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ground_station.ingest import Picture
from ground_station.survey_map import AlignedSurveyMap, rolled_pose
from missions.camera import Camera, Pose
from missions.messages import PictureMeta
from missions.mission import CameraSpec, Mission, SurveySpec
from missions.run_folder import RunFolder
from perception.reconstruct.pictures import SurveyPicture
from tests.reconstruct_scene import CAMERA, survey
from tests.test_alignment import DISTANCE_M, disturbed, errors

MISSION = Mission(title="t", survey=SurveySpec(refine=5, distance_m=DISTANCE_M),
                  camera=CameraSpec(survey_px=(CAMERA.width_px, CAMERA.height_px), explore_px=(320, 180),
                                    focal_px=CAMERA.fx_px, position_sigma_m=0.02, attitude_sigma_deg=0.3))


@dataclass
class Placed:
    """A map that only remembers what it was given."""

    pictures: list[tuple[tuple[int, ...], Camera, Pose]] = field(default_factory=list)

    def place(self, rgb: np.ndarray, camera: Camera, pose: Pose) -> None:
        self.pictures.append((rgb.shape, camera, pose))

    def grid(self) -> str:
        return "grid"


def meta_of(picture: SurveyPicture) -> PictureMeta:
    return PictureMeta(vehicle_id=1, view_id=picture.view_id, phase="survey", t_capture_ns=0, pose=rolled_pose(picture),
                       position_sigma_m=0.02, speed_m_s=0.0, camera=CAMERA, sha256="", size_bytes=0)


def aligned_map(run: RunFolder) -> tuple[AlignedSurveyMap, Placed]:
    placed = Placed()
    return AlignedSurveyMap(placed, SimpleNamespace(pictured={}), MISSION, run), placed


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunFolder, list[SurveyPicture]]:
    true, run = survey(tmp_path_factory.mktemp("pictures")), RunFolder(tmp_path_factory.mktemp("run"))
    for p in true:
        shutil.copy(p.path, run.picture(1, p.view_id))
    return run, true


@pytest.mark.xdist_group("alignment")
def test_pictures_are_mapped_where_they_were_taken_and_not_where_that_was_measured(
        taken: tuple[RunFolder, list[SurveyPicture]]) -> None:
    run, true = taken
    measured = disturbed(true)
    completed, placed = aligned_map(run)
    for p in reversed(measured):
        completed.add(Picture(meta_of(p), None))
    assert completed.needs_time
    assert placed.pictures == []
    assert completed.grid() == "grid"
    assert len(placed.pictures) == len(true)
    before, turned_before = errors(measured, true)
    told = [SurveyPicture(p.view_id, Path(), CAMERA, pose.enu_from_camera, np.array(pose.position_enu_m))
            for p, (_, _, pose) in zip(true, placed.pictures, strict=True)]
    after, turned = errors(told, true)
    assert after.mean() < 0.5 * before.mean()
    assert turned.max() < 0.5 * turned_before.mean()
    assert {(shape, camera.width_px, camera.height_px) for shape, camera, _ in placed.pictures} == {
        ((180, 320, 3), 320, 180)}
    assert completed.grid() == "grid"
    assert len(placed.pictures) == len(true), "once"


def test_too_few_to_be_aligned_are_left_out(taken: tuple[RunFolder, list[SurveyPicture]]) -> None:
    run, true = taken
    completed, placed = aligned_map(run)
    for p in true[:2]:
        completed.add(Picture(meta_of(p), None))
    assert completed.grid() == "grid"
    assert placed.pictures == []


def test_a_pose_by_its_angles_is_the_whole_pose() -> None:
    rotation = Pose((1.0, 2.0, 3.0), 0.7, -0.4, 0.01).enu_from_camera @ Rotation.from_euler("x", 3e-3).as_matrix()
    picture = SurveyPicture(1, Path(), CAMERA, rotation, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(rolled_pose(picture).enu_from_camera, rotation, atol=1e-12)
