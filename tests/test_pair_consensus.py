"""A wall of equal bricks: one pair of pictures matched one course aside is outvoted by all others."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from missions.camera import Camera, Pose
from perception.reconstruct.bundle import Accuracy, adjust
from perception.reconstruct.features import Features
from perception.reconstruct.matching import ByPair
from perception.reconstruct.optics import Optics
from perception.reconstruct.pair_consensus import adjust_agreeing
from perception.reconstruct.pictures import SurveyPicture

pytestmark = pytest.mark.xdist_group("alignment")

CAMERA = Camera.from_diagonal_fov(1920, 1080, 84.0)
ACCURACY = Accuracy(0.02, np.radians(0.3))
FIRST_PX = 40.0
COLUMNS, COURSES = 25, 20
COURSE_M = 0.08


def corners_enu_m() -> np.ndarray:
    """(500, 3) of the bricks, course by course; the wall is not quite flat."""
    east, up = np.meshgrid(0.25 * np.arange(COLUMNS), COURSE_M * np.arange(COURSES))
    rng = np.random.default_rng(1)
    return np.column_stack([east.ravel() - 3.0, rng.uniform(0.0, 0.4, east.size), up.ravel() - 0.8])


def picture(view_id: int, east_m: float, up_m: float) -> SurveyPicture:
    """It looks north at the wall, four metres away."""
    pose = Pose((east_m, -4.0, up_m), np.pi / 2.0, 0.0)
    return SurveyPicture(view_id, Path("none.jpg"), CAMERA, pose.enu_from_camera, np.array(pose.position_enu_m))


def features(of: SurveyPicture) -> Features:
    """All corners in order, seen to a fifth of a pixel."""
    rng = np.random.default_rng(10 + of.view_id)
    local = (corners_enu_m() - of.position_enu_m) @ of.enu_from_camera
    at = local[:, :2] / local[:, 2:] * CAMERA.fx_px + [CAMERA.cx_px, CAMERA.cy_px]
    at += rng.normal(0.0, 0.2, at.shape)
    return Features(at.astype(np.float32), np.zeros((len(at), 128), np.uint8), np.ones(len(at), np.float32))


def matched(courses_aside: int = 0, every: int = 5) -> np.ndarray:
    """Every fifth corner with the one so many courses above it."""
    first = np.arange(0, COLUMNS * (COURSES - courses_aside), every)
    return np.column_stack([first, first + courses_aside * COLUMNS]).astype(np.uint32)


@pytest.fixture
def true() -> list[SurveyPicture]:
    return [picture(i, 0.8 * (i % 3) - 0.8, 0.5 * (i // 3) - 0.5) for i in range(9)]


@pytest.fixture
def measured(true: list[SurveyPicture]) -> list[SurveyPicture]:
    rng = np.random.default_rng(2)
    return [replace(p, position_enu_m=p.position_enu_m + ACCURACY.position_m * rng.standard_normal(3),
                    enu_from_camera=p.enu_from_camera @ Rotation.from_rotvec(
                        ACCURACY.attitude_rad * rng.standard_normal(3)).as_matrix()) for p in true]


def error_m(position_enu_m: np.ndarray, true: list[SurveyPicture], i: int) -> float:
    return float(np.linalg.norm(position_enu_m[i] - true[i].position_enu_m))


def test_a_pair_one_course_aside_is_outvoted(true: list[SurveyPicture], measured: list[SurveyPicture]) -> None:
    """Two of the last picture's pairs are, each with more matches than any of the six others."""
    seen = [features(p) for p in true]
    matches: ByPair = {pair: matched() for pair in combinations(range(9), 2)}
    matches |= {(i, 8): matched(courses_aside=1, every=3) for i in (6, 7)}
    optics = Optics(CAMERA)
    believed, found = adjust_agreeing(measured, seen, matches, ACCURACY, FIRST_PX, optics)
    assert set(matches) - set(believed) == {(6, 8), (7, 8)}
    alone = adjust(measured, seen, matches, ACCURACY, FIRST_PX, optics)
    assert error_m(found.position_enu_m, true, 8) < error_m(alone.position_enu_m, true, 8)


def test_nothing_changes_where_nothing_is_denied(true: list[SurveyPicture], measured: list[SurveyPicture]) -> None:
    seen = [features(p) for p in true]
    matches: ByPair = {pair: matched() for pair in combinations(range(9), 2)}
    believed, found = adjust_agreeing(measured, seen, matches, ACCURACY, FIRST_PX, Optics(CAMERA))
    once = adjust(measured, seen, matches, ACCURACY, FIRST_PX, Optics(CAMERA))
    assert list(believed) == list(matches)
    assert np.array_equal(found.position_enu_m, once.position_enu_m)


def test_a_picture_is_not_left_without_matches(true: list[SurveyPicture], measured: list[SurveyPicture]) -> None:
    """One whose only pairs contradict each other may stand elsewhere: its best pairs stay, and it is not cut off."""
    seen = [features(p) for p in true]
    matches: ByPair = {pair: matched() for pair in combinations(range(8), 2)}
    matches |= {(0, 8): matched(every=9), (1, 8): matched(courses_aside=1, every=9)}
    believed, _ = adjust_agreeing(measured, seen, matches, ACCURACY, FIRST_PX, Optics(CAMERA))
    assert {pair for pair in believed if 8 in pair} == {(0, 8), (1, 8)}
