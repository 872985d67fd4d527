"""The simulated LiDAR: its beams, its noise, what it hits; and coverage by clouds that come one after the other."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from ground_station.bench.lidar import points_of, sensed
from missions.camera import Camera, Pose
from perception.depth.depth_map import DepthMap
from sim_bridge.lidar import NOISE_M, REACH_M, beam_directions, enu_from_sensor, scan
from sim_bridge.truth import Truth


def test_sixteen_beams_over_thirty_degrees_and_a_fifth_of_a_degree_apart() -> None:
    beams = beam_directions()
    elevation = np.degrees(np.arcsin(beams[:, 2])).round(6)
    assert len(np.unique(elevation)) == 16
    assert (elevation.min(), elevation.max()) == (-15.0, 15.0)
    level = beams[elevation == elevation.max()]
    step = np.degrees(np.arccos(np.clip(np.sum(level[1:, :2] * level[:-1, :2], axis=1) / np.cos(math.radians(15)) ** 2,
                                        -1, 1)))
    np.testing.assert_allclose(step, 0.2, atol=1e-5)


@given(st.floats(-3, 3), st.floats(-1.4, 1.4), st.booleans())
def test_the_sensor_looks_where_the_camera_looks_or_stays_upright(yaw: float, elevation: float, tilted: bool) -> None:
    pose = Pose((0.0, 0.0, 0.0), yaw, elevation)
    axes = enu_from_sensor(pose, tilted)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    if tilted:
        np.testing.assert_allclose(axes[:, 0], pose.enu_from_camera[:, 2], atol=1e-12)
    else:
        np.testing.assert_allclose(axes[:, 2], [0, 0, 1], atol=1e-12)


def test_a_wall_is_hit_with_the_noise_of_the_data_sheet_and_nothing_beyond_reach() -> None:
    wall = trimesh.creation.box((0.2, 400.0, 400.0)).apply_translation((10.1, 0.0, 0.0))
    points = scan(Truth(wall.vertices, wall.faces), Pose((0.0, 0.0, 0.0), 0.0, 0.0), True, np.random.default_rng(1))
    assert len(points) > 10_000
    ahead = np.linalg.norm(points, axis=1) < 10.6
    assert (points[ahead, 0] - 10.0).std() == pytest.approx(NOISE_M, rel=0.1)
    assert np.linalg.norm(points, axis=1).max() < REACH_M + 6 * NOISE_M


def test_coverage_grows_to_all_that_is_near_a_point() -> None:
    samples = np.stack([np.arange(10.0), np.zeros(10), np.zeros(10)], axis=1)
    clouds = [samples[:3].astype(np.float32), np.zeros((0, 3), np.float32), samples[2:8].astype(np.float32) + 0.1]
    found = sensed("pictures", clouds, samples)
    np.testing.assert_allclose(found.curve, [0.3, 0.3, 0.8])
    np.testing.assert_allclose(found.distance_m[3:8], 0.1 * math.sqrt(3), rtol=1e-5)


def test_trusted_pixels_within_range_become_points_where_they_are() -> None:
    camera = Camera(4, 2, 2.0, 2.0, 2.0, 1.0)
    depth = np.full((2, 4), 5.0, np.float32)
    valid = np.ones((2, 4), bool)
    valid[0, 0], depth[1, 3] = False, 80.0
    map_ = DepthMap(camera, Pose((1.0, 2.0, 3.0), 0.0, 0.0), depth, valid, depth, ~valid, 0.01)
    points = points_of(map_, 25.0)
    assert len(points) == 6
    np.testing.assert_allclose(points[:, 0], 6.0, atol=1e-6)
