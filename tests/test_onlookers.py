"""A depth map is checked by pictures that really look at what it shows."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.camera import Camera, Pose
from perception.reconstruct.fusion import PosedDepth
from perception.reconstruct.onlookers import Onlookers

CAMERA = Camera.from_diagonal_fov(160, 90, 84.0)
WALL_Y_M = 16.0


def before_the_wall(east_m: float, north_m: float = 0.0, yaw_rad: float = np.pi / 2,
                    depth_m: float | None = None) -> PosedDepth:
    """The true depth of a wall in the plane y = WALL_Y_M; depth_m: something before it fills the whole picture."""
    pose = Pose((east_m, north_m, 0.0), yaw_rad, 0.0)
    north = CAMERA.rays_camera() @ pose.enu_from_camera.T[:, 1]
    depth = (WALL_Y_M - north_m) / np.maximum(north, 1e-3) if depth_m is None else np.full(north.shape, depth_m)
    return PosedDepth(depth.astype(np.float32), pose.enu_from_camera, np.array(pose.position_enu_m))


def test_who_looks_at_the_wall_from_across_is_asked_before_who_stands_nearby_and_sees_something_else() -> None:
    own = before_the_wall(-8.0, yaw_rad=np.radians(60.0))
    across = before_the_wall(8.0, yaw_rad=np.radians(120.0))
    hidden, turned = before_the_wall(-7.0, depth_m=3.0), before_the_wall(-8.0, yaw_rad=np.radians(160.0))
    behind = before_the_wall(0.0, WALL_Y_M + 5.0)
    blind = PosedDepth(np.zeros((90, 160), np.float32), own.enu_from_camera, own.position_enu_m)
    assert Onlookers([own, hidden, turned, behind, blind, across], CAMERA).of(0, 3) == [5]


def test_a_crowd_before_one_half_leaves_nobody_out_who_shows_the_other() -> None:
    crowd = [before_the_wall(-14.0 - 0.1 * i) for i in range(10)]
    alone = before_the_wall(14.0)
    seen = Onlookers([before_the_wall(0.0), *crowd, alone], CAMERA)
    assert 11 in seen.of(0, 2)
    assert seen.of(11, 1) == [0], "whose frame reaches farthest to the East"


def test_who_contradicts_is_asked_as_well() -> None:
    through = before_the_wall(0.5, depth_m=40.0)
    into_the_sky = before_the_wall(-0.5, depth_m=float("inf"))
    assert sorted(Onlookers([before_the_wall(0.0), through, into_the_sky], CAMERA).of(0, 5)) == [1, 2]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 12), st.integers(1, 6))
def test_no_picture_is_asked_twice_nor_itself_and_more_are_the_same_and_others(seed: int, n: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    seen = Onlookers([before_the_wall(float(e), float(b), float(y)) for e, b, y in
                      rng.uniform((-10, -5, 1.0), (10, 5, 2.1), (n, 3))], CAMERA)
    few, more = seen.of(0, count), seen.of(0, count + 3)
    assert 0 not in more
    assert len(set(more)) == len(more) <= min(count + 3, n - 1)
    assert more[:len(few)] == few
    assert len(few) == min(count, len(more))
