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
from missions.lens import NONE, border, distorted
from perception.reconstruct.aligned_poses import Alignment
from perception.reconstruct.alignment import align
from perception.reconstruct.bundle import Accuracy
from perception.reconstruct.features import Features
from perception.reconstruct.matching import fundamental, nearest_anywhere
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.straighten import straightened
from sim_bridge.render.lens import through_lens, wide_camera
from tests.reconstruct_scene import CAMERA, photograph, survey, wall_and_box

pytestmark = pytest.mark.xdist_group("alignment")

ACCURACY = Accuracy(0.02, np.radians(0.3))
DISTANCE_M = 5.0
LENS = (-0.08, 0.02, 0.001, -0.001)


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


def test_explorations_pictures_stand_by_where_no_other_overlaps(true: list[SurveyPicture], tmp_path: Path) -> None:
    east = np.array([100.0, 0.0, 0.0])
    pictures = disturbed([*true, replace(true[0], view_id=100, position_enu_m=true[0].position_enu_m + east)])
    explored = []
    for p in (true[1], true[3], true[4], true[8]):
        path = tmp_path / f"{p.view_id}.jpg"
        cv2.imwrite(str(path), cv2.resize(cv2.imread(str(p.path)), (320, 180), interpolation=cv2.INTER_AREA))
        explored.append(replace(p, path=path, camera=CAMERA.scaled(320, 180), position_enu_m=p.position_enu_m + east))
    alone = align(pictures, ACCURACY, DISTANCE_M, tmp_path / "alone")
    assert list(alone.numbers["kept"]) == ["100"]
    found = align(pictures, ACCURACY, DISTANCE_M, tmp_path / "beside", explored=explored)
    assert found.numbers["registered"] == len(pictures)
    assert len(found.poses) == len(pictures)
    before, after = (np.linalg.norm(p.position_enu_m - true[0].position_enu_m - east)
                     for p in (pictures[-1], found.pictures[-1]))
    assert after < before
    assert errors(found.pictures[:9], alone.pictures[:9])[0].max() < 0.001


@pytest.fixture(scope="module")
def through_a_lens(tmp_path_factory: pytest.TempPathFactory) -> list[SurveyPicture]:
    """The same survey through a lens that puts the corners 14 pixels off."""
    folder, pictures = tmp_path_factory.mktemp("lens"), []
    for p in survey(folder):
        drawn = photograph(wall_and_box(), p.pose, wide_camera(CAMERA, LENS), seed=p.view_id)
        cv2.imwrite(str(p.path), through_lens(drawn, CAMERA, LENS), [cv2.IMWRITE_JPEG_QUALITY, 95])
        pictures.append(p)
    return pictures


@pytest.mark.parametrize("told", [True, False])
def test_a_lens_is_taken_into_account_or_found(through_a_lens: list[SurveyPicture], told: bool, tmp_path: Path) -> None:
    found = align(disturbed(through_a_lens), ACCURACY, DISTANCE_M, tmp_path / "alignment", calibrate=not told,
                  lens=LENS if told else NONE)
    assert found.numbers["registered"] == len(through_a_lens)
    assert errors(found.pictures, through_a_lens)[0].mean() < 0.02
    edge = 0.9 * border(CAMERA)
    off_px = CAMERA.fx_px * np.linalg.norm(distorted(edge, found.optics.lens) * found.optics.camera.fx_px / CAMERA.fx_px
                                           - distorted(edge, LENS), axis=1)
    assert off_px.max() < (1e-9 if told else 3.0)
    straight = straightened(found.pictures, found.optics, tmp_path / "straightened")
    seen, true = (cv2.imread(str(p.path))[40:-40, 60:-60].astype(float) for p in (straight[4], survey(tmp_path)[4]))
    assert np.median(np.abs(seen - true)) < 12.0


def test_products_find_the_same_matches_as_differences() -> None:
    rng = np.random.default_rng(3)
    one = rng.integers(0, 120, (300, 128)).astype(np.uint8)
    other = np.clip(one[rng.permutation(300)[:250]] + rng.integers(-9, 10, (250, 128)), 0, 255).astype(np.uint8)
    a, b = (Features(np.zeros((len(d), 2), np.float32), d, np.ones(len(d), np.float32)) for d in (one, other))
    apart = ((one[:, None].astype(np.int64) - other[None]) ** 2).sum(axis=2)
    i, j = apart.argmin(axis=1), apart.argmin(axis=0)
    mutual = {(k, int(i[k])) for k in range(300) if j[i[k]] == k}
    found = {(int(k), int(m)) for k, m in nearest_anywhere(a, b)}
    assert found <= mutual
    assert len(found) > 200
    assert len(nearest_anywhere(a, Features(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8),
                                            np.zeros(0, np.float32)))) == 0
