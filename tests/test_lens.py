"""A lens that distorts: the model goes both ways, pictures are warped by it and straightened again."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missions.camera import Camera, Pose
from missions.errors import UserError
from missions.lens import Distortion, distorted, invertible, pixel_points, undistorted
from missions.mission import CameraSpec
from missions.mission_file import load_mission
from missions.simulation import RenderSpec
from perception.lens import redrawn
from sim_bridge.render import make_renderer
from tests.test_render import small_scene

CAMERA = Camera.from_diagonal_fov(320, 180, 84.0)
LENS: Distortion = (-0.12, 0.03, 0.001, -0.002)
lenses = st.tuples(st.floats(-0.15, 0.15), st.floats(-0.02, 0.05), st.floats(-0.003, 0.003), st.floats(-0.003, 0.003))


@given(lenses, st.floats(-0.8, 0.8), st.floats(-0.45, 0.45))
def test_there_and_back(lens: Distortion, x: float, y: float) -> None:
    if invertible(CAMERA, lens):
        point = np.array([x, y])
        np.testing.assert_allclose(undistorted(distorted(point, lens), lens), point, atol=1e-9)


@given(lenses)
def test_the_model_is_opencvs(lens: Distortion) -> None:
    points = pixel_points(CAMERA)[::30, ::30].reshape(-1, 2)
    rays = np.column_stack([points, np.ones(len(points))])
    theirs, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), np.array(lens))
    np.testing.assert_allclose(distorted(points, lens), theirs.reshape(-1, 2), atol=1e-12)


def test_a_lens_that_folds_the_picture_is_refused(tmp_path: Path) -> None:
    mission = tmp_path / "m.toml"
    mission.write_text('title = "m"\n[camera]\ndistortion = [-0.6, 0.0, 0.0, 0.0]\n')
    with pytest.raises(UserError, match=r"camera\.distortion .* folds the picture"):
        load_mission(mission)


@pytest.mark.parametrize("lens", [LENS, (0.1, -0.02, 0.0, 0.001)])
def test_a_simulated_picture_is_warped_and_straightened_again(lens: Distortion) -> None:
    pose = Pose((0.0, -8.0, 2.0), np.pi / 2, -0.1)
    pinhole, through = (make_renderer(small_scene(), RenderSpec(backend="raycast"),
                                      CameraSpec(noise_dn=0.0, distortion=d), seed=3) for d in ((0.0,) * 4, lens))
    ideal, warped = (r.render(CAMERA, pose, [], 1).astype(np.int64) for r in (pinhole, through))
    inner = (slice(30, -30), slice(50, -50))
    straight = redrawn(warped.astype(np.uint8), CAMERA, lens, CAMERA).astype(np.int64)
    assert np.abs(warped - ideal)[inner].mean() > 2.0 * np.abs(straight - ideal)[inner].mean()
    assert np.median(np.abs(straight - ideal)[inner]) <= 3


def test_quarter_turns_turn_clockwise() -> None:
    picture = np.zeros((180, 320, 3), np.uint8)
    picture[:60, :100] = 255
    upright = Camera(180, 320, CAMERA.fx_px, CAMERA.fy_px, 90.0, 160.0)
    turned = redrawn(picture, CAMERA, (0.0,) * 4, upright, 1)
    np.testing.assert_array_equal(turned, cv2.rotate(picture, cv2.ROTATE_90_CLOCKWISE))
