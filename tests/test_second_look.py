"""Pictures that hang together badly are looked at closer, beside those that see the same from no farther away."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from missions.camera import Camera, Pose
from perception.reconstruct import second_look as module
from perception.reconstruct.bundle import Adjusted
from perception.reconstruct.features import Features
from perception.reconstruct.optics import Optics
from perception.reconstruct.pairs import overlapping, overlapping_mutually
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.second_look import Look, second_look

CAMERA = Camera.from_diagonal_fov(1920, 1080, 84.0)
DISTANCE_M = 6.0
POINTS, COARSE = 80, 5


def taken_from(view_id: int, east_m: float, north_m: float = -6.0, camera: Camera = CAMERA) -> SurveyPicture:
    """A picture that looks north."""
    pose = Pose((east_m, north_m, 0.0), np.pi / 2.0, 0.0)
    return SurveyPicture(view_id, Path("none.jpg"), camera, pose.enu_from_camera, np.array(pose.position_enu_m))


def coarse(view_id: int) -> Features:
    """Nothing that another picture has."""
    rng = np.random.default_rng(100 + view_id)
    return Features(rng.uniform(0.0, 1000.0, (COARSE, 2)).astype(np.float32),
                    rng.integers(0, 255, (COARSE, 128)).astype(np.uint8), np.ones(COARSE, np.float32))


@pytest.fixture
def pictures() -> list[SurveyPicture]:
    return [taken_from(i, 0.7 * i) for i in range(4)]


@pytest.fixture
def orders(monkeypatch: pytest.MonkeyPatch, pictures: list[SurveyPicture]) -> dict[int, np.ndarray]:
    """Which point each picture's features at twice the width show; asked for by view id once it was looked at."""
    rng = np.random.default_rng(1)
    points = rng.uniform([-2.0, -1.5, -1.5], [3.0, 1.5, 1.5], (POINTS, 3))
    raw = rng.gamma(0.6, 1.0, (POINTS, 128))
    descriptors = np.rint(512.0 * np.sqrt(raw / raw.sum(axis=1, keepdims=True))).clip(0, 255).astype(np.uint8)
    true = {p.view_id: p for p in pictures}
    looked: dict[int, np.ndarray] = {}

    def fine(picture: SurveyPicture) -> Features:
        there = true[picture.view_id]
        local = (points - there.position_enu_m) @ there.enu_from_camera
        at = local[:, :2] / local[:, 2:] * CAMERA.fx_px + [CAMERA.cx_px, CAMERA.cy_px]
        order = np.random.default_rng(picture.view_id).permutation(POINTS)
        looked[picture.view_id] = order
        return Features(at[order].astype(np.float32), descriptors[order], np.ones(POINTS, np.float32))

    monkeypatch.setattr(module, "fine_features", fine)
    return looked


@pytest.fixture
def pool() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(2) as pool:
        yield pool


def adjusted(pictures: list[SurveyPicture], points_seen: list[int]) -> Adjusted:
    """As bundle adjustment would have left them, so many points seen by each."""
    picture_of = np.repeat(np.arange(len(pictures)), points_seen)
    n = len(picture_of)
    return Adjusted(np.array([p.enu_from_camera for p in pictures]), np.array([p.position_enu_m for p in pictures]),
                    np.zeros((n, 3)), picture_of, np.arange(n), np.zeros(n, np.int64), np.zeros((n, 2)), Optics(CAMERA))


def test_a_picture_in_no_group_is_found_at_twice_the_width(pictures: list[SurveyPicture],
                                                          orders: dict[int, np.ndarray],
                                                          pool: ThreadPoolExecutor) -> None:
    turn = Rotation.from_rotvec([0.003, -0.004, 0.002]).as_matrix()
    measured = [*pictures[:3], replace(pictures[3], enu_from_camera=pictures[3].enu_from_camera @ turn)]
    # alone, it was adjusted to a place a metre beside where it was measured
    wrong = [*pictures[:3], replace(pictures[3], position_enu_m=pictures[3].position_enu_m + np.array([0.0, 0.0, 1.0]))]
    look = Look(adjusted(wrong, [500, 500, 500, 0]), np.array([True, True, True, False]), DISTANCE_M, 20.0, 20)
    seen = [coarse(i) for i in range(4)]
    found = second_look(measured, 4, seen, {}, look, pool)
    assert sorted(found) == [(0, 3), (1, 3), (2, 3)]
    for (i, j), matches in found.items():
        assert len(matches) > 0.9 * POINTS
        np.testing.assert_array_equal(orders[i][matches[:, 0] - COARSE], orders[j][matches[:, 1] - COARSE])
    assert [len(s) for s in seen] == [COARSE + POINTS] * 4


def test_who_hangs_in_the_group_by_few_points_is_looked_at_closer(pictures: list[SurveyPicture],
                                                                  orders: dict[int, np.ndarray],
                                                                  pool: ThreadPoolExecutor) -> None:
    look = Look(adjusted(pictures, [500, 30, 500, 500]), np.ones(4, np.bool_), DISTANCE_M, 20.0, 20)
    found = second_look(pictures, 4, [coarse(i) for i in range(4)], {}, look, pool)
    assert sorted(found) == [(0, 1), (1, 2), (1, 3)]


def test_nobody_is_looked_at_closer_without_need(pictures: list[SurveyPicture], orders: dict[int, np.ndarray],
                                                 pool: ThreadPoolExecutor) -> None:
    look = Look(adjusted(pictures, [500] * 4), np.ones(4, np.bool_), DISTANCE_M, 20.0, 20)
    assert second_look(pictures, 4, [coarse(i) for i in range(4)], {}, look, pool) == {}
    assert orders == {}


def test_pictures_that_stand_by_and_small_ones_are_not(orders: dict[int, np.ndarray],
                                                       pool: ThreadPoolExecutor) -> None:
    small = [taken_from(i, 0.7 * i, camera=CAMERA.scaled(960, 540)) for i in range(3)]
    look = Look(adjusted(small, [500, 0, 0]), np.array([True, False, False]), DISTANCE_M, 20.0, 20)
    second_look(small, 3, [coarse(i) for i in range(3)], {}, look, pool)
    assert orders == {}
    beside = [taken_from(i, 0.7 * i) for i in range(3)]
    look = Look(adjusted(beside, [500, 0, 0]), np.array([True, False, False]), DISTANCE_M, 20.0, 20)
    second_look(beside, 2, [coarse(i) for i in range(3)], {}, look, pool)
    assert sorted(orders) == [0, 1]


def test_who_stands_far_behind_is_no_close_partner() -> None:
    beside, far = taken_from(1, 3.0), taken_from(2, 0.0, -30.0)
    pictures = [taken_from(0, 0.0), beside, far]
    assert overlapping(pictures, DISTANCE_M, 1)[0] == [2]
    assert overlapping_mutually(pictures, DISTANCE_M, 1)[0] == [1]


def test_what_was_matched_before_is_matched_anew_and_never_forgotten(pictures: list[SurveyPicture],
                                                                     orders: dict[int, np.ndarray],
                                                                     pool: ThreadPoolExecutor) -> None:
    seen = [module.fine_features(p) for p in pictures]
    look = Look(adjusted(pictures, [500] * 4), np.ones(4, np.bool_), DISTANCE_M, 20.0, 1)
    apart = (0, 3)
    assert apart not in second_look(pictures, 4, list(seen), {}, look, pool), "not each other's best partners"
    found = second_look(pictures, 4, list(seen), {apart: np.zeros((1, 2), np.uint32)}, look, pool)[apart]
    assert len(found) > 0.9 * POINTS
    np.testing.assert_array_equal(orders[0][found[:, 0]], orders[3][found[:, 1]])
