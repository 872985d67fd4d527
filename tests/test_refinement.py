"""Refining depth maps on pictures of a wall, whose true depth is known for every pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from missions.camera import Pose
from perception.reconstruct.refinement import refined
from perception.reconstruct.stereo import Eye, Map
from tests.reconstruct_scene import CAMERA, looking_at, photograph, wall_and_box

INNER = slice(60, -60)
PLACES = [(0.0, -5.0, 3.0), (0.9, -5.0, 3.0), (-0.5, -5.2, 2.4)]


def eye(place: tuple[float, float, float], target: tuple[float, float, float], gain: float = 1.0) -> Eye:
    pose = looking_at(place, target)
    grey = cv2.cvtColor(photograph(wall_and_box()[:1], pose), cv2.COLOR_BGR2GRAY)
    return Eye(np.rint(grey * gain).astype(np.uint8), np.zeros(grey.shape, bool), CAMERA, pose.enu_from_camera,
               np.array(pose.position_enu_m))


def true_depth(seen: Eye) -> Map:
    """Of the plane y = 0."""
    return (-seen.position_enu_m[1] / (CAMERA.rays_camera() @ seen.enu_from_camera.T)[..., 1]).astype(np.float32)


@pytest.mark.parametrize("target", [(0.0, 0.0, 3.0), (2.0, 0.0, 3.5)])
@pytest.mark.parametrize("gain", [1.0, 0.7])
def test_a_wall_is_found_between_the_steps_of_matching(target: tuple[float, float, float], gain: float) -> None:
    eyes = [eye(PLACES[0], target), *(eye(place, target, gain) for place in PLACES[1:])]
    truth = true_depth(eyes[0])
    step = truth**2 / (CAMERA.fx_px * 0.9)
    rng = np.random.default_rng(1)
    stairs = 0.45 * np.sign(np.sin(np.arange(CAMERA.width_px) / 9.0)).astype(np.float32)
    start = (truth + (stairs + 0.3 * rng.standard_normal(truth.shape)) * step).astype(np.float32)
    found = refined(eyes[0], eyes[1:], start)
    on_wall = (np.abs(CAMERA.rays_camera() @ eyes[0].enu_from_camera.T * truth[..., None]
                      + eyes[0].position_enu_m - [0.0, 0.0, 3.0]) < [4.5, 1.0, 2.5]).all(axis=-1)
    inner = np.zeros_like(on_wall)
    inner[INNER, INNER] = on_wall[INNER, INNER]
    off = np.abs(found - truth)[inner] / step[inner]
    assert np.median(np.abs(start - truth)[inner] / step[inner]) > 0.4
    assert np.median(off) < 0.05
    assert np.mean(off < 0.2) > 0.98


def test_what_no_partner_shows_and_what_was_unknown_stays_unknown() -> None:
    seen, partner = eye(PLACES[0], (0.0, 0.0, 3.0)), eye(PLACES[1], (0.0, 0.0, 3.0))
    start = true_depth(seen)
    start[100:150], start[200:250] = 0.0, np.inf
    found = refined(seen, [partner], start)
    assert np.all(found[100:150] == 0.0)
    assert np.all(found[200:250] == 0.0)
    assert np.mean(found[260:300, INNER] > 0.0) > 0.99
    assert np.mean(refined(seen, [partner], np.full_like(start, 3.0))[INNER, INNER] == 0.0) > 0.95, "wrong matches"
    away = looking_at(PLACES[1], (0.9, -9.0, 3.0))
    turned = Eye(partner.grey, partner.sky, CAMERA, away.enu_from_camera, partner.position_enu_m)
    assert not np.any(refined(seen, [turned], start))


def test_no_partner_or_nothing_known_changes_nothing() -> None:
    pose = Pose(PLACES[0], 0.0, 0.0)
    seen = Eye(np.zeros((360, 640), np.uint8), np.zeros((360, 640), bool), CAMERA, pose.enu_from_camera,
               np.array(pose.position_enu_m))
    assert np.array_equal(refined(seen, [], np.full((360, 640), 5.0, np.float32)), np.full((360, 640), 5.0))
    assert not np.any(refined(seen, [seen], np.zeros((360, 640), np.float32)))
