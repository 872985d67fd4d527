"""MACARONS' settings, results and Blender's cameras become missions and views, and back."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ground_station.launcher import _parse
from ground_station.macarons_command import main, mission_of, settings_of
from ground_station.mission_setup import overrides
from ground_station.views_file import read_views, write_views
from missions.blender_poses import euler_from_pose, matrix_from_euler, pose_from_blender, read_blender
from missions.camera import Pose
from missions.errors import UserError
from missions.macarons_results import MacaronsRun, read_results
from missions.macarons_settings import (
    CameraSection,
    MacaronsSettings,
    SceneSection,
    Units,
    diagonal_fov_deg,
    read_settings,
    write_settings,
)
from missions.mission import SiteSpec
from missions.mission_file import load_mission
from missions.simulation import SceneSpec
from sim_bridge.scenes.load import load_scene

SCENE = SceneSection(grid_l=7, grid_w=3, grid_h=5, x_min=(-8.0156, -0.7179, -3.0646), x_max=(6.7536, 3.223, 2.5213))
PISA = MacaronsSettings(scene=SCENE, camera=CameraSection(
    pose_l=8, pose_w=4, pose_h=6, x_min=(-8.5, 0.0, -3.5), x_max=(7.0, 4.5, 3.0), contrast_factor=1.3,
    start_positions=[(6, 1, 5, 2, 5), (7, 2, 3, 1, 3), (7, 3, 4, 2, 7), (4, 2, 3, 2, 7), (7, 1, 3, 2, 0)]))
DUNNOTTAR = MacaronsSettings(scene=SCENE, camera=CameraSection(
    pose_l=7, pose_w=3, pose_h=10, x_min=(-6.0, -0.5, -10.0), x_max=(7.0, 3.0, 7.0)))
angles = st.floats(-math.pi + 1e-6, math.pi - 1e-6)
elevations = st.floats(-1.5, 1.5)
places = st.tuples(*[st.floats(-500.0, 500.0)] * 3)
poses = st.builds(Pose, places, angles, elevations)


@pytest.mark.parametrize(("start", "pose"), [
    (0, (41.875, 15.0, 25.0, 0.0, 180.0)), (1, (60.625, 25.0, 5.0, -30.0, 108.0)),
    (2, (60.625, 35.0, 15.0, 0.0, 252.0)), (3, (4.375, 25.0, 5.0, 0.0, 252.0)), (4, (60.625, 15.0, 5.0, 0.0, 0.0))])
def test_start_poses_are_where_the_released_runs_began(start: int, pose: tuple[float, ...]) -> None:
    np.testing.assert_allclose(PISA.pose_scaled(PISA.camera.start_positions[start]), pose)


def test_the_camera_box_is_truncated_towards_zero_as_in_the_release_only() -> None:
    np.testing.assert_allclose(DUNNOTTAR.pose_scaled((1, 0, 2, 2, 0)), (-32.142857, 5.0, -57.5, 0.0, 0.0), atol=1e-6)
    low, high = PISA.camera_box()
    np.testing.assert_array_equal((low, high), ([-80.0, 0.0, -30.0], [70.0, 40.0, 30.0]))
    np.testing.assert_array_equal(PISA.camera_box(truncated=False), ([-85.0, 0.0, -35.0], [70.0, 45.0, 30.0]))


@given(st.tuples(*[st.integers(0, n - 1) for n in (8, 4, 6, 5, 10)]), st.sampled_from([0.25, 1.0, 2.0]))
def test_lattice_poses_look_where_macarons_says(index: tuple[int, int, int, int, int], per_metre: float) -> None:
    row = PISA.pose_scaled(index)
    [pose] = Units(per_metre).poses(row[None])
    e, a = np.radians(row[3:])
    x, y, z = math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a)
    np.testing.assert_allclose(pose.enu_from_camera[:, 2], (x, -z, y), atol=1e-12)
    np.testing.assert_allclose(np.array(pose.position_enu_m) * 10.0 * per_metre, (row[0], -row[2], row[1]), atol=1e-9)


@given(st.lists(poses, min_size=1, max_size=5), st.floats(0.1, 10.0))
def test_poses_survive_macarons_units_and_back(given_poses: list[Pose], per_metre: float) -> None:
    units = Units(per_metre)
    for before, after in zip(given_poses, units.poses(units.rows_scaled(given_poses)), strict=True):
        np.testing.assert_allclose(after.position_enu_m, before.position_enu_m, atol=1e-9)
        np.testing.assert_allclose(after.enu_from_camera, before.enu_from_camera, atol=1e-9)


@given(poses)
def test_poses_survive_blender_and_back(pose: Pose) -> None:
    euler = euler_from_pose(pose)
    blender = matrix_from_euler(euler)
    ours = pose.enu_from_camera
    np.testing.assert_allclose(blender, np.stack([ours[:, 0], -ours[:, 1], -ours[:, 2]], axis=1), atol=1e-12)
    np.testing.assert_allclose(pose_from_blender(pose.position_enu_m, euler).enu_from_camera, ours, atol=1e-9)


@pytest.mark.parametrize("elevation", [-math.pi / 2.0, math.pi / 2.0])
def test_a_blender_camera_that_looks_straight_down_or_up_keeps_its_yaw(elevation: float) -> None:
    pose = Pose((1.0, 2.0, 3.0), 0.7, elevation)
    back = pose_from_blender(pose.position_enu_m, euler_from_pose(pose))
    np.testing.assert_allclose(back.enu_from_camera, pose.enu_from_camera, atol=1e-7)


@given(st.lists(st.tuples(*[st.floats(-90, 90)] * 3, st.floats(-60, 60), st.floats(0, 359.9)), min_size=1, max_size=8))
def test_key_poses_are_every_fourth_row_and_turns_take_the_short_way(rows: list[tuple[float, ...]]) -> None:
    run = MacaronsRun.of_key_poses(np.array(rows), [])
    assert len(run.X_cam_history) == 1 + 4 * len(rows)
    np.testing.assert_allclose(run.rows(), rows, atol=1e-9)
    path = np.vstack([rows[:1], run.rows(every_picture=True)[1:]])
    steps = np.abs((np.diff(path[:, 4]) + 180.0) % 360.0 - 180.0)
    assert (steps <= 45.0 + 1e-6).all()


def test_settings_survive_the_file_and_strange_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "settings.json"
    write_settings(PISA, path)
    assert read_settings(path) == PISA
    keys = json.loads(path.read_text())
    assert set(keys["camera"]) == {"pose_l", "pose_w", "pose_h", "pose_n_theta", "pose_n_azim", "x_min", "x_max",
                                   "start_positions", "contrast_factor"}
    keys["camera"]["x_max"] = keys["camera"]["x_min"]
    path.write_text(json.dumps(keys))
    with pytest.raises(UserError, match=r"camera\.x_max"):
        read_settings(path)
    path.write_text("{}")
    with pytest.raises(UserError, match="not MACARONS"):
        read_settings(path)


def test_one_command_makes_a_mission_and_views_of_macarons_files(tmp_path: Path) -> None:
    write_settings(PISA, tmp_path / "settings.json")
    run = MacaronsRun.of_key_poses(np.array([PISA.pose_scaled(i) for i in PISA.camera.start_positions]), [0.1] * 5)
    results = {"pisa rgb": {"3": run}}
    (tmp_path / "results.json").write_bytes(msgspec.json.encode(results))
    out = tmp_path / "ours"
    assert main(["import", str(tmp_path / "settings.json"), "--results", str(tmp_path / "results.json"), "--out",
                 str(out), "--units-per-metre", "0.5"]) == 0
    mission = load_mission(out / "mission.toml")
    assert mission.scene.up == "y"
    assert mission.explore.sensing_range_m == pytest.approx(14.0)
    np.testing.assert_allclose(mission.site.object_min_enu_m, (-16.0312, -5.0426, -1.4358))
    views, starts = read_views(out / "pisa_rgb_3_views.csv"), read_views(out / "starts.csv")
    assert [v.pose for v in views] == [v.pose for v in starts]
    np.testing.assert_allclose(views[0].pose.position_enu_m, (8.375, -5.0, 3.0))
    assert views[0].pose.yaw_enu_rad == pytest.approx(math.pi / 2)


def test_the_camera_box_of_the_mission_holds_that_of_macarons() -> None:
    mission = mission_of(PISA, Units(1.0), "", truncated=False)
    low, high = (np.array(c) for c in (mission.site.object_min_enu_m, mission.site.object_max_enu_m))
    margin = mission.site.camera_margin_m
    assert (low - margin <= np.array([-8.5, -3.0, 0.0]) + 1e-9).all()
    assert (high + margin >= np.array([7.0, 3.5, 4.5]) - 1e-9).all()
    assert mission.site.ground_up_m is not None
    assert mission.site.ground_up_m + mission.site.camera_floor_m <= 0.1


def test_settings_of_a_mission_of_settings_have_the_same_boxes_and_directions() -> None:
    back = settings_of(mission_of(PISA, Units(2.0), "", truncated=True), Units(2.0))
    np.testing.assert_allclose((back.scene.x_min, back.scene.x_max), (PISA.scene.x_min, PISA.scene.x_max), atol=1e-9)
    assert back.elevations_deg() == PISA.elevations_deg()
    assert 60 <= back.scene.grid_l * back.scene.grid_w * back.scene.grid_h <= 140


def test_views_become_macarons_and_blender_files_and_come_back(tmp_path: Path) -> None:
    given_poses = [Pose((1.0, 2.0, 3.0), 0.3, -0.2), Pose((4.0, -2.0, 6.0), -3.0, 0.5), Pose((0.0, 0.0, 1.0), 1.0, 0.0)]
    write_views(given_poses, tmp_path / "views.csv")
    assert main(["export", str(tmp_path / "views.csv"), "--out", str(tmp_path / "theirs"), "--name", "mine"]) == 0
    run = read_results(tmp_path / "theirs" / "results.json")["mine"]["0"]
    assert main(["import", str(tmp_path / "theirs" / "blender_cameras.csv"), "--out", str(tmp_path / "ours")]) == 0
    back = [v.pose for v in read_views(tmp_path / "ours" / "views.csv")]
    for pose, macarons, blender in zip(given_poses, Units().poses(run.rows()), back, strict=True):
        for other in (macarons, blender):
            np.testing.assert_allclose(other.position_enu_m, pose.position_enu_m, atol=1e-5)
            np.testing.assert_allclose(other.enu_from_camera, pose.enu_from_camera, atol=1e-6)


def test_a_broken_camera_file_names_the_line(tmp_path: Path) -> None:
    (tmp_path / "cameras.csv").write_text("name,location_x\nView_1,3\n")
    with pytest.raises(UserError, match="line 2"):
        read_blender(tmp_path / "cameras.csv")


def test_fly_takes_views_without_exploring(tmp_path: Path) -> None:
    options: argparse.Namespace = _parse(["bridge", "--views", str(tmp_path / "v.csv")])
    asked = overrides(options)
    assert asked["explore.enabled"] == "false"
    assert json.loads(asked["survey.views_path"]) == str(tmp_path / "v.csv")


def test_a_mesh_with_y_up_stands_upright(tmp_path: Path) -> None:
    corners = [(x, y, z) for x in (0, 2) for y in (0, 9) for z in (0, 3)]
    faces = ["1 2 4", "1 4 3", "5 7 8", "5 8 6", "1 5 6", "1 6 2", "3 4 8", "3 8 7", "1 3 7", "1 7 5", "2 6 8", "2 8 4"]
    text = [*(f"v {x} {y} {z}" for x, y, z in corners), *(f"f {f}" for f in faces)]
    (tmp_path / "tower.obj").write_text("\n".join(text) + "\n")
    scene = load_scene(SceneSpec(path=str(tmp_path / "tower.obj"), up="y", surroundings=False), SiteSpec())
    np.testing.assert_allclose(scene.object_min_enu_m, (0.0, -3.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(scene.object_max_enu_m, (2.0, 0.0, 9.0), atol=1e-12)


def test_the_field_of_view_is_pytorch3ds() -> None:
    half = math.radians(diagonal_fov_deg() / 2.0)
    assert 0.5 * math.hypot(456, 256) / math.tan(half) == pytest.approx(128.0 * math.sqrt(3.0))
