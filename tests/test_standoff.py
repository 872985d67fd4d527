"""How near the nearest surface in a picture is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missions.camera import Camera, Pose
from missions.grid import FREE, OCCUPIED, VoxelGrid
from planning.nbv.standoff import nearest_depth_m

CAMERA = Camera.from_diagonal_fov(1920, 1080, 84.0)


def walled(first_m: float) -> VoxelGrid:
    """Free space up to a wall across East at first_m."""
    grid = VoxelGrid.unknown(np.zeros(3), np.array([30.0, 20.0, 20.0]), 0.5)
    grid.state[:] = FREE
    grid.state[round(first_m / 0.5):] = OCCUPIED
    return grid


@given(st.floats(1.0, 14.0), st.floats(-0.4, 0.4), st.floats(-0.3, 0.3))
def test_depth_is_that_of_the_wall_in_the_direction_in_which_it_is_nearest(away_m: float, yaw: float,
                                                                           elevation: float) -> None:
    pose = Pose((15.0 - away_m, 10.0, 10.0), yaw, elevation)
    towards = CAMERA.rays_camera()[::60, ::60].reshape(-1, 3) @ pose.enu_from_camera.T
    depths = away_m / towards[towards[:, 0] > 0, 0]
    [depth] = nearest_depth_m(walled(15.0), [pose], CAMERA)
    assert depth == pytest.approx(depths.min(), rel=0.12)


def test_nothing_in_sight_is_infinitely_far() -> None:
    away, into = Pose((10.0, 10.0, 10.0), np.pi, 0.0), Pose((14.9, 10.0, 10.0), 0.0, 0.0)
    assert nearest_depth_m(walled(15.0), [away, into], CAMERA) == pytest.approx([np.inf, 0.1], rel=0.01)
