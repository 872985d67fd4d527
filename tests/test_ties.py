"""Pictures that share too little with any single other one are tied to the points that all others know together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from missions.camera import Camera, Pose
from perception.reconstruct.features import Features
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.ties import LEAST, Known, ties

CAMERA = Camera.from_diagonal_fov(640, 360, 84.0)
OPTICS = Optics(CAMERA)
POINTS = 40
REACH_PX = 12.0


def taken_from(east_m: float, view_id: int = 1) -> SurveyPicture:
    """A picture that looks north."""
    pose = Pose((east_m, -6.0, 0.0), np.pi / 2.0, 0.0)
    return SurveyPicture(view_id, Path("none.jpg"), CAMERA, pose.enu_from_camera, np.array(pose.position_enu_m))


def seen_at(picture: SurveyPicture, points: np.ndarray) -> np.ndarray:
    local = (points - picture.position_enu_m) @ picture.enu_from_camera
    at = local[:, :2] / local[:, 2:] * CAMERA.fx_px + [CAMERA.cx_px, CAMERA.cy_px]
    return np.asarray(at, np.float32)


def of(points_px: np.ndarray, descriptors: np.ndarray) -> Features:
    return Features(points_px, descriptors, np.ones(len(points_px), np.float32))


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(1).uniform([-2.0, -1.0, -1.5], [2.0, 1.0, 1.5], (POINTS, 3))


@pytest.fixture
def descriptors() -> np.ndarray:
    raw = np.random.default_rng(2).gamma(0.6, 1.0, (POINTS, 128))
    return np.rint(512.0 * np.sqrt(raw / raw.sum(axis=1, keepdims=True))).clip(0, 255).astype(np.uint8)


def known(points: np.ndarray, descriptors: np.ndarray) -> Known:
    """Ten pictures in a row, each of which knows four of the points alone."""
    picture_of = np.arange(POINTS) // 4
    stands = np.array([taken_from(0.2 * i).position_enu_m for i in range(10)])[picture_of]
    away = stands - points
    distance_m = np.linalg.norm(away, axis=1)
    return Known(picture_of, np.arange(POINTS) % 4, np.arange(POINTS), points, away / distance_m[:, None], distance_m,
                 descriptors)


def measured(picture: SurveyPicture) -> SurveyPicture:
    turn = Rotation.from_rotvec([0.004, -0.005, 0.003]).as_matrix()
    return replace(picture, position_enu_m=picture.position_enu_m + np.array([0.02, 0.01, -0.02]),
                   enu_from_camera=picture.enu_from_camera @ turn)


def test_points_of_many_pictures_together_tie_one(points: np.ndarray, descriptors: np.ndarray) -> None:
    picture = taken_from(1.0)
    own = of(seen_at(picture, points), descriptors)
    found = ties(measured(picture), own, known(points, descriptors), OPTICS, REACH_PX)
    assert sorted(found) == list(range(10))
    for i, matches in found.items():
        # four points of each, and the feature of the picture is the one that shows that point
        np.testing.assert_array_equal(matches[:, 0], 4 * i + matches[:, 1])
        assert len(matches) == 4


def test_what_looks_the_same_elsewhere_does_not_matter(points: np.ndarray, descriptors: np.ndarray) -> None:
    picture = taken_from(1.0)
    at = seen_at(picture, points)
    elsewhere = np.column_stack([(at[:, 0] + 150.0) % CAMERA.width_px, at[:, 1]]).astype(np.float32)
    own = of(np.concatenate([elsewhere, at]), np.concatenate([descriptors, descriptors]))
    found = ties(measured(picture), own, known(points, descriptors), OPTICS, REACH_PX)
    tied = np.concatenate([m[:, 0] for m in found.values()])
    assert len(tied) > 0.8 * POINTS
    assert (tied >= POINTS).all()


def test_no_tie_without_a_pose_that_explains_enough(points: np.ndarray, descriptors: np.ndarray) -> None:
    picture = taken_from(1.0)
    rng = np.random.default_rng(3)
    strewn = (seen_at(picture, points) + rng.uniform(-REACH_PX, REACH_PX, (POINTS, 2))).astype(np.float32)
    assert ties(picture, of(strewn, descriptors), known(points, descriptors), OPTICS, REACH_PX) == {}
    few = of(seen_at(picture, points)[:LEAST - 1], descriptors[:LEAST - 1])
    assert ties(picture, few, known(points, descriptors), OPTICS, REACH_PX) == {}


def test_points_are_not_looked_for_from_behind(points: np.ndarray, descriptors: np.ndarray) -> None:
    pose = Pose((1.0, 6.0, 0.0), -np.pi / 2.0, 0.0)
    behind = replace(taken_from(1.0), enu_from_camera=pose.enu_from_camera,
                     position_enu_m=np.array(pose.position_enu_m))
    own = of(seen_at(behind, points), descriptors)
    assert ties(behind, own, known(points, descriptors), OPTICS, REACH_PX) == {}
