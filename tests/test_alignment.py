"""Alignment of pictures whose poses were measured with noise: it finds the truth again, or says where it did not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from missions.camera import Pose
from perception.reconstruct.aligned_poses import Alignment
from perception.reconstruct.alignment import align
from perception.reconstruct.bundle import Accuracy
from perception.reconstruct.matching import fundamental
from perception.reconstruct.pictures import SurveyPicture
from tests.reconstruct_scene import CAMERA, survey

pytestmark = pytest.mark.xdist_group("alignment")

ACCURACY = Accuracy(0.02, np.radians(0.3))
DISTANCE_M = 5.0


def disturbed(pictures: list[SurveyPicture], seed: int = 1) -> list[SurveyPicture]:
    """Poses as a vehicle would have measured them."""
    rng = np.random.default_rng(seed)
    return [replace(p, position_enu_m=p.position_enu_m + ACCURACY.position_m * rng.standard_normal(3),
                    enu_from_camera=p.enu_from_camera @ Rotation.from_rotvec(
                        ACCURACY.attitude_rad * rng.standard_normal(3)).as_matrix()) for p in pictures]


def errors(told: list[SurveyPicture], true: list[SurveyPicture]) -> tuple[np.ndarray, np.ndarray]:
    """(n,) metres and (n,) degrees."""
    away = [np.linalg.norm(a.position_enu_m - b.position_enu_m) for a, b in zip(told, true, strict=True)]
    turn = [Rotation.from_matrix(a.enu_from_camera.T @ b.enu_from_camera).magnitude()
            for a, b in zip(told, true, strict=True)]
    return np.array(away), np.degrees(turn)


@pytest.fixture(scope="module")
def true(tmp_path_factory: pytest.TempPathFactory) -> list[SurveyPicture]:
    return survey(tmp_path_factory.mktemp("pictures"))


@pytest.fixture(scope="module")
def aligned(true: list[SurveyPicture], tmp_path_factory: pytest.TempPathFactory) -> tuple[Alignment, Path]:
    folder = tmp_path_factory.mktemp("alignment")
    return align(disturbed(true), ACCURACY, DISTANCE_M, folder), folder


def test_the_truth_is_found_again(true: list[SurveyPicture], aligned: tuple[Alignment, Path]) -> None:
    before, turned_before = errors(disturbed(true), true)
    after, turned = errors(aligned[0].pictures, true)
    assert before.mean() > 0.025
    assert turned_before.mean() > 0.3
    # nothing tells where all nine stand together but their mean position, which noise leaves 1.2 cm off
    assert after.mean() < 0.5 * before.mean()
    assert turned.max() < 0.15
    together = np.mean([a.position_enu_m - b.position_enu_m for a, b in zip(aligned[0].pictures, true, strict=True)],
                       axis=0)
    inside = [np.linalg.norm(a.position_enu_m - together - b.position_enu_m)
              for a, b in zip(aligned[0].pictures, true, strict=True)]
    assert max(inside) < 0.01
    assert aligned[0].numbers["registered"] == len(true)
    assert aligned[0].numbers["groups"] == [len(true)]
    assert aligned[0].numbers["reprojection_px"] < 0.5


def test_equal_whatever_the_threads_and_kept_for_the_next_time(true: list[SurveyPicture], tmp_path: Path,
                                                               aligned: tuple[Alignment, Path]) -> None:
    again = align(disturbed(true), ACCURACY, DISTANCE_M, tmp_path, threads=1)
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["alignment.json", "cameras.txt", "images.txt", "points3D.txt", "poses.csv"]
    for name in names:
        assert (tmp_path / name).read_bytes() == (aligned[1] / name).read_bytes()
    stages: list[str] = []
    stored = align(disturbed(true), ACCURACY, DISTANCE_M, tmp_path, progress=lambda stage, *_: stages.append(stage))
    assert stages == []
    assert stored.poses == again.poses
    align(disturbed(true, seed=2), ACCURACY, DISTANCE_M, tmp_path, progress=lambda stage, *_: stages.append(stage))
    assert set(stages) == {"features", "match", "adjust"}


def test_others_read_the_model(aligned: tuple[Alignment, Path]) -> None:
    model = pycolmap.Reconstruction(aligned[1])
    for picture in aligned[0].pictures:
        image = model.find_image_with_name(picture.path.name)
        assert image is not None
        np.testing.assert_allclose(image.projection_center(), picture.position_enu_m, atol=1e-6)
        np.testing.assert_allclose(image.cam_from_world().rotation.matrix().T, picture.enu_from_camera, atol=1e-6)
    assert model.num_points3D() == aligned[0].numbers["points"]
    assert model.compute_num_observations() == aligned[0].numbers["observations"]
    model.update_point_3d_errors()
    error, seen = np.array([(p.error, p.track.length()) for p in model.points3D.values()]).T
    assert np.average(error, weights=seen) == pytest.approx(aligned[0].numbers["reprojection_px"], rel=0.02)


def test_a_picture_of_something_else_keeps_its_pose_and_is_named(true: list[SurveyPicture], tmp_path: Path) -> None:
    pictures = disturbed(true)
    odd = tmp_path / "odd.jpg"
    noise = np.random.default_rng(5).integers(0, 255, (CAMERA.height_px // 8, CAMERA.width_px // 8, 3), np.uint8)
    cv2.imwrite(str(odd), cv2.resize(noise, (CAMERA.width_px, CAMERA.height_px), interpolation=cv2.INTER_CUBIC))
    pictures[4] = replace(pictures[4], path=odd)
    found = align(pictures, ACCURACY, DISTANCE_M, tmp_path / "alignment")
    assert list(found.numbers["kept"]) == ["4"]
    assert found.numbers["registered"] == len(true) - 1
    np.testing.assert_allclose(found.pictures[4].position_enu_m, pictures[4].position_enu_m, atol=1e-8)
    np.testing.assert_allclose(found.pictures[4].enu_from_camera, pictures[4].enu_from_camera, atol=1e-8)
    after, turned = errors([p for p in found.pictures if p.view_id != 4], [p for p in true if p.view_id != 4])
    assert after.mean() < 0.02
    assert turned.max() < 0.2


def test_groups_that_share_nothing_are_counted_and_both_aligned(true: list[SurveyPicture], tmp_path: Path) -> None:
    east = np.array([100.0, 0.0, 0.0])
    far = [replace(p, view_id=100 + p.view_id, position_enu_m=p.position_enu_m + east) for p in true]
    found = align(disturbed([*true, *far[:6]]), ACCURACY, DISTANCE_M, tmp_path)
    assert found.numbers["groups"] == [9, 6]
    assert [p.group for p in found.poses] == [0] * 9 + [1] * 6
    assert errors(found.pictures, [*true, *far[:6]])[1].max() < 0.2


def test_pictures_in_a_row_do_not_turn_about_it(true: list[SurveyPicture], tmp_path: Path) -> None:
    """Positions on a line say nothing of a turn about that line; the measured attitudes do."""
    row = true[3:6]
    found = align(disturbed(row), ACCURACY, DISTANCE_M, tmp_path)
    assert found.numbers["registered"] == 3
    assert errors(found.pictures, row)[1].max() < 3 * np.degrees(ACCURACY.attitude_rad)


@given(st.tuples(*[st.floats(-0.4, 0.4)] * 3), st.tuples(*[st.floats(-2.0, 2.0)] * 3),
       st.tuples(st.floats(-3, 3), st.floats(8, 20), st.floats(-3, 3)))
def test_a_point_lies_on_its_epipolar_line(angles: tuple[float, float, float], position: tuple[float, float, float],
                                           point: tuple[float, float, float]) -> None:
    poses = [Pose((0.0, 0.0, 0.0), np.pi / 2, 0.0), Pose(position, np.pi / 2 + angles[0], *angles[1:])]
    views = [SurveyPicture(k, Path(), CAMERA, p.enu_from_camera, np.array(p.position_enu_m))
             for k, p in enumerate(poses)]
    pixels = [CAMERA.matrix @ v.enu_from_camera.T @ (np.array(point) - v.position_enu_m) for v in views]
    first, second = (p / p[2] for p in pixels)
    line = fundamental(*views) @ first
    assert abs(second @ line) <= 1e-6 * max(1.0, float(np.linalg.norm(line))) * float(np.linalg.norm(second))
