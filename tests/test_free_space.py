"""Points that pictures look through go, points that pictures have stay, wherever they were thought to be seen from."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from missions.camera import Camera, Pose
from perception.reconstruct.cloud import Cloud
from perception.reconstruct.free_space import not_looked_through, votes
from perception.reconstruct.fusion import PosedDepth

CAMERA = Camera.from_diagonal_fov(64, 36, 84.0)
WALL_Y_M = 10.0


def looking_north(east_m: float, y_m: float = 0.0, depth_m: float | None = None) -> PosedDepth:
    """Before a wall in the plane y = WALL_Y_M; depth_m: what it takes the wall's distance for."""
    pose = Pose((east_m, y_m, 0.0), np.pi / 2, 0.0)
    depth = np.full((36, 64), WALL_Y_M - y_m if depth_m is None else depth_m, np.float32)
    return PosedDepth(depth, pose.enu_from_camera, np.array(pose.position_enu_m))


def cloud_of(points: list[tuple[float, float, float]]) -> Cloud:
    n = len(points)
    return Cloud(np.array(points, np.float32), np.zeros((n, 3), np.uint8), np.tile(np.float32([0, -1, 0]), (n, 1)),
                 np.full(n, 3, np.uint8))


def test_what_most_look_through_goes_though_some_agree_on_it() -> None:
    wrong = [looking_north(x, depth_m=4.0) for x in (-1.0, 0.0, 1.0)]
    right = [looking_north(x) for x in (-1.5, -0.5, 0.5, 1.5)]
    cloud = cloud_of([(0.0, 4.0, 0.0), (0.2, WALL_Y_M, 0.1)])
    assert not_looked_through(cloud, [*wrong, *right], CAMERA, 25.0).points_enu_m[:, 1].tolist() == [WALL_Y_M]
    assert len(not_looked_through(cloud, [*wrong, *right[:2]], CAMERA, 25.0)) == 2, "most have it there"


def test_who_is_behind_something_or_far_away_or_looks_elsewhere_says_nothing() -> None:
    cloud = cloud_of([(0.0, 4.0, 0.0), (0.0, WALL_Y_M + 1.0, 0.0), (40.0, 4.0, 0.0), (0.0, -4.0, 0.0)])
    there, through = votes(cloud.points_enu_m, [looking_north(0.0), looking_north(0.0, -40.0)], CAMERA, 25.0)
    assert there.tolist() == [0, 0, 0, 0]
    assert through.tolist() == [1, 0, 0, 0]
    nothing = PosedDepth(np.zeros((36, 64), np.float32), np.eye(3), np.zeros(3))
    assert not any(v.any() for v in votes(cloud.points_enu_m, [nothing], CAMERA, 25.0))


@given(st.integers(1, 7), st.integers(0, 40))
def test_votes_do_not_depend_on_the_threads(threads: int, points: int) -> None:
    rng = np.random.default_rng(points)
    at = rng.uniform((-5, 1, -3), (5, 12, 3), (points, 3)).astype(np.float32)
    seen = [looking_north(float(x)) for x in range(-2, 3)]
    for one, many in zip(votes(at, seen, CAMERA, 25.0), votes(at, seen, CAMERA, 25.0, threads), strict=True):
        assert np.array_equal(one, many)
