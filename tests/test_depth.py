"""Plane sweep, sources, sky, the vote of neighbours and its confidence, on pictures whose depth is known exactly."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.camera import Pose
from missions.errors import UserError
from perception.depth import torch_volume
from perception.depth.confidence import FAR_M, FEATURES, WEIGHTS, Confidence, features, right, shipped, trusted
from perception.depth.cost_volume import cost_volume
from perception.depth.depth_map import DepthMap
from perception.depth.filling import filled
from perception.depth.fusion import Consensus, consensus
from perception.depth.learning import learnt, line
from perception.depth.pictures import PictureDepths
from perception.depth.plane_sweep import Frame, SweepSettings, estimate, make_frame
from perception.depth.sky import sky_mask
from perception.depth.sources import MIN_SPACING_M, choose_sources, source_worth
from perception.depth.texture import determinacy
from tests.depth_scene import CAMERA, exact_depth_map, halved, wall_picture

NORTH = math.pi / 2


def _frames(poses: list[Pose], **wall: float) -> tuple[list[Frame], list[np.ndarray]]:
    pictures = [wall_picture(pose, noise_seed=i, **wall) for i, pose in enumerate(poses)]
    return [make_frame(rgb, CAMERA, p) for (rgb, _), p in zip(pictures, poses, strict=True)], [d for _, d in pictures]


def _sideways(distance_m: float, yaw: float = NORTH) -> list[Pose]:
    return [Pose((x, -distance_m, 5.0), yaw, 0.0) for x in (0.0, -1.5, -0.75, 0.75, 1.5)]


@pytest.mark.parametrize(("distance_m", "yaw"), [(4.0, NORTH), (6.0, NORTH), (6.0, NORTH + 0.4)])
def test_wall_depth_is_within_one_percent(distance_m: float, yaw: float) -> None:
    frames, true = _frames(_sideways(distance_m, yaw))
    depth = estimate(frames[0], frames[1:])
    error = np.abs(depth.depth_m / halved(true[0]) - 1.0)[depth.valid]
    assert depth.valid.mean() > 0.75
    assert (error < 0.01).mean() > 0.95
    assert np.median(error) < 0.004


def test_take_off_column_measures_the_wall_ahead() -> None:
    """Pure climbing, looking level at an object 12 m away: the first depth of every mission."""
    frames, true = _frames([Pose((0.0, -12.0, up), NORTH, 0.0) for up in (2.0, 4.0, 6.0, 8.0)])
    for i in range(4):
        depth = estimate(frames[i], [f for k, f in enumerate(frames) if k != i])
        error = np.abs(depth.depth_m / halved(true[i]) - 1.0)[depth.valid]
        assert depth.valid.mean() > 0.6
        assert (error < 0.03).mean() > 0.95


def test_background_at_infinity_comes_out_far() -> None:
    frames, true = _frames(_sideways(6.0), top_up_m=5.0)
    depth = estimate(frames[0], frames[1:])
    beyond = ~np.isfinite(true[0][::2, ::2]) & depth.valid
    beyond[56:] = False
    assert beyond.mean() > 0.25
    assert (depth.depth_m[beyond] > 60.0).mean() > 0.98


def test_same_pictures_give_the_same_bits() -> None:
    frames, _ = _frames(_sideways(7.0))
    first, second = (estimate(frames[0], frames[1:]) for _ in range(2))
    assert np.array_equal(first.depth_m, second.depth_m)
    assert np.array_equal(first.valid, second.valid)
    assert np.array_equal(first.confidence, second.confidence)


def test_blank_pictures_measure_nothing() -> None:
    rng = np.random.default_rng(1)
    blank = [np.clip(rng.normal(180.0, 1.0, (256, 456, 3)), 0, 255).astype(np.uint8) for _ in range(5)]
    frames = [make_frame(rgb, CAMERA, pose) for rgb, pose in zip(blank, _sideways(6.0), strict=True)]
    assert estimate(frames[0], frames[1:]).valid.mean() < 0.001


def test_sigma_covers_the_error() -> None:
    frames, true = _frames(_sideways(10.0))
    depth = estimate(frames[0], frames[1:])
    error = np.abs(depth.depth_m - halved(true[0]))[depth.valid] / depth.sigma_m()[depth.valid]
    assert np.median(error) < 0.5
    assert (error < 3.0).mean() > 0.95


def test_sweep_needs_a_source() -> None:
    frames, _ = _frames(_sideways(6.0)[:1])
    with pytest.raises(ValueError, match="source"):
        estimate(frames[0], [], SweepSettings())


def test_rotation_alone_is_no_source() -> None:
    target = Pose((0.0, 0.0, 5.0), 0.0, 0.0)
    turned = [Pose((0.0, 0.0, 5.0), yaw, 0.1) for yaw in (-0.4, 0.0, 0.3)]
    assert (source_worth(target, turned, CAMERA) == 0.0).all()
    assert len(choose_sources(target, turned, CAMERA)[0]) == 0


def test_best_source_has_parallax_and_overlap() -> None:
    target = Pose((0.0, 0.0, 5.0), NORTH, 0.0)
    near, good, wide, away = ((0.05, NORTH), (1.5, NORTH), (14.0, NORTH), (1.5, -NORTH))
    poses = [Pose((x, 0.0, 5.0), yaw, 0.0) for x, yaw in (near, good, wide, away)]
    score = source_worth(target, poses, CAMERA).mean(axis=1)
    assert int(np.argmax(score)) == 1
    assert score[1] > 0.5
    assert max(score[0], score[2], score[3]) < 0.1


coordinate = st.floats(-12.0, 12.0)
pose_strategy = st.builds(lambda x, y, z, yaw, e: Pose((x, y, z), yaw, e), coordinate, coordinate, coordinate,
                          st.floats(-math.pi, math.pi), st.floats(-1.0, 1.0))


@settings(max_examples=60, deadline=None)
@given(pose_strategy, st.lists(pose_strategy, max_size=12))
def test_chosen_sources_are_distinct_and_spaced_and_more_are_worth_more(target: Pose, candidates: list[Pose]) -> None:
    chosen, worth = choose_sources(target, candidates, CAMERA, 4)
    assert 0.0 <= worth <= 1.0
    assert len(chosen) <= 4
    assert worth >= choose_sources(target, candidates, CAMERA, 3)[1] >= choose_sources(target, candidates, CAMERA, 1)[1]
    places = np.array([candidates[i].position_enu_m for i in chosen]).reshape(-1, 3)
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2) + np.eye(len(places)) * 99.0
    assert np.all(gaps >= MIN_SPACING_M)


def _sky_picture(wall_rgb: tuple[int, int, int], rows: slice) -> np.ndarray:
    shade = np.linspace(0.0, 1.0, 128)[:, None, None]
    rgb = (1 - shade) * np.array([70.0, 120.0, 200.0]) + shade * np.array([170.0, 195.0, 225.0]) + np.zeros((1, 228, 1))
    rgb[rows, 60:160] = wall_rgb
    return np.asarray(rgb + np.random.default_rng(0).normal(0, 0.5, rgb.shape)).astype(np.uint8)


def test_sky_is_found_and_a_wall_in_it_is_not() -> None:
    camera = CAMERA.scaled(228, 128)
    rgb = _sky_picture((150, 140, 130), slice(20, 128))
    sky = sky_mask(rgb, camera, Pose((0.0, 0.0, 5.0), 0.0, 0.35))
    assert sky[:100, :56].mean() > 0.9
    assert not sky[20:, 60:160].any()


def test_blue_wall_below_the_horizon_or_cut_off_from_the_top_is_not_sky() -> None:
    camera = CAMERA.scaled(228, 128)
    blue = _sky_picture((90, 130, 210), slice(0, 128))
    assert not sky_mask(blue, camera, Pose((0.0, 0.0, 5.0), 0.0, -0.6)).any()
    framed = blue.copy()
    framed[:6] = (60, 60, 60)
    assert not sky_mask(framed, camera, Pose((0.0, 0.0, 5.0), 0.0, 0.6)).any()


def test_sources_serve_both_sides_of_the_picture() -> None:
    """A camera that turned left and one that turned right together beat two that look the same way."""
    target = Pose((0.0, 0.0, 5.0), NORTH, 0.0)
    left, again, right = (Pose((x, 0.0, 5.0), NORTH + turn, 0.0) for x, turn in ((1.0, 0.5), (1.4, 0.5), (-1.0, -0.5)))
    chosen, _ = choose_sources(target, [left, again, right], CAMERA, 2)
    assert 2 in chosen


def _wall_and_neighbours() -> tuple[list[DepthMap], list[Frame]]:
    poses = _sideways(8.0)
    pictures = [wall_picture(pose) for pose in poses]
    maps = [exact_depth_map(pose, halved(depth), 1e-3) for pose, (_, depth) in zip(poses, pictures, strict=True)]
    return maps, [make_frame(rgb, CAMERA, pose) for pose, (rgb, _) in zip(poses, pictures, strict=True)]


def _vote(own: DepthMap, maps: list[DepthMap], frames: list[Frame]) -> Consensus:
    return consensus(own, frames[0].gray, maps[1:], [frame.gray for frame in frames[1:]])


def test_neighbours_confirm_truth_and_correct_a_ghost() -> None:
    maps, frames = _wall_and_neighbours()
    true, ghost = maps[0].depth_m, maps[0].depth_m.copy()
    ghost[40:60, 100:120] = 4.0
    vote = _vote(replace(maps[0], depth_m=ghost), maps, frames)
    middle = np.s_[30:70, 90:130]
    assert np.abs(vote.depth_m[middle] / true[middle] - 1.0).max() < 0.01
    assert (vote.agree[80:, 60:170] >= 3).mean() > 0.95
    assert (vote.against[80:, 60:170] == 0).all()


def test_a_ghost_that_others_see_through_is_doubted() -> None:
    """Where no neighbour answers on the ray, the ghost stays the best guess, and only its confidence falls."""
    maps, frames = _wall_and_neighbours()
    doubtful = (0.3 * maps[0].confidence).astype(np.float32)
    ghost = replace(maps[0], depth_m=np.full_like(maps[0].depth_m, 4.0), confidence=doubtful)
    voted, true = (_vote(own, maps, frames) for own in (ghost, maps[0]))
    seen_through = (np.abs(voted.depth_m - 4.0) < 0.05) & (voted.against >= 2)
    odds, good = (shipped().log_odds(features(own, vote, frames[0])) for own, vote in ((ghost, voted), (maps[0], true)))
    assert np.median(odds[seen_through]) < 0.0
    assert np.median(good[20:-20, 40:-40]) > 3.0


def test_filling_takes_the_side_that_looks_alike() -> None:
    gray = np.full((40, 60), 50.0, np.float32)
    gray[:, 30:] = 200.0
    depth = np.where(gray < 100.0, np.float32(5.0), np.float32(20.0))
    trusted = np.ones(gray.shape, np.bool_)
    trusted[5:35, 26:34] = False
    blank = np.where(trusted, depth, np.float32(99.0)).astype(np.float32)
    assert np.allclose(filled(blank, trusted, gray), depth)
    assert np.array_equal(filled(blank, np.zeros_like(trusted), gray), blank)


def test_what_is_said_to_be_far_must_be_surer_and_what_stands_out_less_so() -> None:
    depth, odds = np.array([[2.0, 20.0, 20.0, 60.0]], np.float32), np.full((1, 4), 1.0, np.float32)
    evidence = np.zeros((len(FEATURES), 1, 4), np.float32)
    evidence[FEATURES.index("farther"), 0, 2] = 0.5
    assert trusted(odds, depth, evidence).tolist() == [[True, False, True, False]]


def test_learnt_confidence_is_calibrated_and_the_same_again() -> None:
    rng = np.random.default_rng(4)
    x = rng.normal(size=(40_000, 3)).astype(np.float32)
    odds = 0.5 + 1.2 * x[:, 0] - 2.0 * x[:, 1] * x[:, 2]
    truth = rng.uniform(size=len(x)) < 1.0 / (1.0 + np.exp(-odds))
    first, again = (learnt(x, truth, epochs=60)[0] for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(first.layers, again.layers, strict=True))
    said = first.log_odds(x.T.copy()[:, None])[0]
    for low in (-2.0, 0.0, 2.0):
        some = np.abs(said - low) < 0.5
        assert abs(truth[some].mean() - (1.0 / (1.0 + np.exp(-said[some]))).mean()) < 0.03
    assert np.corrcoef(said, odds)[0, 1] > 0.95


def test_line_through_log_odds_is_found_again() -> None:
    rng = np.random.default_rng(5)
    odds = rng.normal(0.0, 2.0, 40_000).astype(np.float32)
    truth = rng.uniform(size=len(odds)) < 1.0 / (1.0 + np.exp(-(0.6 + 0.4 * odds)))
    assert np.abs(line(odds, truth) - [0.6, 0.4]).max() < 0.04


def test_confidence_has_a_weight_for_every_feature_and_survives_its_file(tmp_path: Path) -> None:
    maps, frames = _wall_and_neighbours()
    evidence = features(maps[0], _vote(maps[0], maps, frames), frames[0])
    assert evidence.shape == (len(FEATURES), *frames[0].gray.shape)
    copy, empty = tmp_path / "copy.safetensors", tmp_path / "empty.safetensors"
    shipped().save(copy)
    assert copy.read_bytes() == WEIGHTS.read_bytes()
    assert np.array_equal(Confidence.load(copy).log_odds(evidence), shipped().log_odds(evidence))
    empty.write_bytes(b"")
    with pytest.raises(UserError, match=r"empty\.safetensors"):
        Confidence.load(empty)


@given(st.floats(0.5, 90.0), st.floats(0.5, 90.0))
def test_beyond_the_horizon_all_depths_are_right(ours: float, true: float) -> None:
    said = bool(right(np.float32([ours]), np.float32([true]))[0])
    assert said or abs(ours - true) > 0.049 * min(true, FAR_M)
    assert not said or abs(ours - true) < 0.051 * true or min(ours, true) > 0.94 * FAR_M


def test_nothing_is_seen_nearer_than_where_the_frusta_cross() -> None:
    """Two cameras 1.5 m to the right: the farther left a pixel, the farther off must be what they see of it."""
    here, *there = (make_frame(np.zeros((256, 456, 3), np.uint8), CAMERA, Pose((x, 0.0, 5.0), NORTH, 0.0))
                    for x in (0.0, 1.5, 1.5))
    sight = estimate(here, there).sight
    reach = (here.camera.cx_px / here.camera.fx_px + np.array([-60.0, -20.0, 40.0]) / here.camera.fx_px) / 1.5
    assert sight[64, [54, 94, 154]] == pytest.approx(np.minimum(reach, 1.0), abs=0.06)


def test_edge_along_the_epipolar_line_determines_nothing() -> None:
    """An upright cable seen while climbing matches at any depth; seen while moving sideways it does not."""
    camera, pose = CAMERA.scaled(228, 128), Pose((0.0, 0.0, 5.0), NORTH, 0.0)
    gray = np.full((128, 228), 120.0, np.float32)
    gray[:, 112:115] = 60.0
    climbed, moved = Pose((0.0, 0.0, 7.0), NORTH, 0.0), Pose((1.0, 0.0, 5.0), NORTH, 0.0)
    assert determinacy(gray, camera, pose, [climbed], 5)[20:100, 110:117].max() < 0.01
    assert determinacy(gray, camera, pose, [climbed, moved], 5)[20:100, 110:117].min() > 0.99


@pytest.mark.parametrize("sources", [1, 2, 4])
def test_compiled_loops_and_torch_build_the_same_volume(sources: int) -> None:
    rng = np.random.default_rng(3)
    images = rng.uniform(0.0, 255.0, (sources + 1, 24, 40)).astype(np.float32)
    a = np.stack(np.meshgrid(np.arange(40), np.arange(24)), dtype=np.float32) + 0.5
    a = np.stack([np.concatenate([a, np.ones((1, 24, 40), np.float32)])] * sources)
    b = rng.uniform(-30.0, 30.0, (sources, 3)).astype(np.float32) * np.float32([1.0, 1.0, 0.1])
    planes = np.linspace(0.0, 0.66, 20, dtype=np.float32)
    ours, theirs = (volume.astype(int) for volume in (
        cost_volume(images[0], images[1:], (a, b), planes, 0.4, 250.0),
        torch_volume.cost_volume(images[0], images[1:], (a, b), planes, 0.4, 250.0, "cpu")))
    assert np.abs(ours - theirs).max() <= 2
    assert (ours != theirs).mean() < 0.01
    assert (ours != 250).mean() > 0.3


def test_what_is_answered_is_never_called_open() -> None:
    """A wall before a textured infinity, online: the wall is measured, and nothing of it is taken for open space."""
    online = PictureDepths(workers=2)
    poses = _sideways(6.0)
    pictures = [wall_picture(pose, noise_seed=i, top_up_m=5.0) for i, pose in enumerate(poses)]
    for (rgb, _), pose in zip(pictures, poses, strict=True):
        online.add(rgb, CAMERA, pose)
    assert online.update() == list(range(len(poses)))
    for i, (_, true) in enumerate(pictures):
        depth = online.depth(i)
        assert depth is not None
        wall = np.isfinite(true[::2, ::2])
        far = depth.valid & (depth.depth_m > 50.0)
        assert not (depth.beyond & depth.valid).any()
        assert (depth.valid & wall).sum() > 0.9 * wall.sum()
        assert ((depth.beyond | far) & wall).mean() < 0.02
        assert ((depth.beyond | far) & ~wall).sum() > 0.5 * (~wall).sum()
