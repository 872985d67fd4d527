"""The depth benchmark walks a given file, judges honestly, and shows where depth fails."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ground_station.bench.depth import main
from ground_station.bench.depth_causes import (
    BEFORE,
    BEHIND,
    ELSEWHERE,
    GHOST,
    NEARLY,
    OPEN,
    PLACES,
    RIGHT_,
    SILENT,
    causes,
    places,
    verdicts,
)
from ground_station.bench.depth_scores import RIGHT, calibration_error, counted, ghosts, judged, sparsification, summary
from missions.camera import Camera, Pose
from perception.depth.depth_map import DepthMap

CAMERA = Camera.from_diagonal_fov(64, 48, 84.0)
RAYS_M = np.linalg.norm(CAMERA.rays_camera(), axis=-1)


def _map(depth_m: np.ndarray, valid: np.ndarray, confidence: np.ndarray) -> DepthMap:
    return DepthMap(CAMERA, Pose((0.0, 0.0, 5.0), 0.0, 0.0), depth_m.astype(np.float32), valid,
                    confidence.astype(np.float32), np.zeros_like(valid), 0.001)


@pytest.fixture
def wall() -> tuple[np.ndarray, DepthMap]:
    """A wall 10 m away beside the sky, and a map that has the wall right but for a tenth of it, which it doubts."""
    true = np.full((48, 64), np.inf, np.float32)
    true[:, :40] = 10.0
    ours, sure = np.where(np.isfinite(true), true, 99.0), np.ones(true.shape)
    ours[:, :4], sure[:, :4] = 20.0, 0.1
    return true, _map(ours, sure > 0.5, sure)


def test_only_surface_in_range_counts_and_silence_is_told(wall: tuple[np.ndarray, DepthMap]) -> None:
    true, ours = wall
    count = counted(true, RAYS_M, 25.0)
    assert np.array_equal(count, np.isfinite(true))
    row = summary("wall", 1, judged(ours, true, count, ~count, count), ghosts(ours, true, ~count, RAYS_M, 25.0), 0.1)
    assert row.answered == pytest.approx(0.9)
    assert (row.abs_rel, row.delta_1_25) == (0.0, 1.0)
    assert row.abs_rel_all == pytest.approx(0.1)
    assert row.delta_1_25_all == pytest.approx(0.9)
    assert row.ghosts == 0.0
    assert row.ause == pytest.approx(0.0, abs=1e-9)
    assert row.ause_random > 0.02


def test_a_picture_without_depth_is_as_wrong_as_can_be(wall: tuple[np.ndarray, DepthMap]) -> None:
    true, _ = wall
    count = np.isfinite(true)
    row = summary("wall", 1, judged(None, true, count, ~count, count), np.zeros(4, np.int64), 0.1)
    assert (row.answered, row.abs_rel_all, row.delta_1_25_all) == (0.0, 1.0, 0.0)


def test_surface_claimed_in_the_sky_is_a_ghost(wall: tuple[np.ndarray, DepthMap]) -> None:
    true, ours = wall
    bold = replace(ours, depth_m=np.full_like(ours.depth_m, 10.0), valid=np.ones_like(ours.valid))
    wrong, claimed, _, _ = ghosts(bold, true, np.zeros_like(bold.valid), RAYS_M, 25.0)
    assert claimed == true.size
    assert wrong == np.isinf(true).sum()


def test_water_claimed_elsewhere_is_false_and_silence_is_not(wall: tuple[np.ndarray, DepthMap]) -> None:
    """All of the wall is water: a tenth of it is doubted, and then claimed at twice its distance."""
    true, doubting = wall
    wet = np.isfinite(true)
    claiming = replace(doubting, valid=wet)
    for ours, false in ((doubting, 0.0), (claiming, 0.1)):
        ghost = ghosts(ours, true, wet, np.ones_like(RAYS_M), 25.0)
        row = summary("lake", 1, judged(ours, true, ~wet, wet, wet), ghost, 0.1)
        assert row.water == 1.0
        assert row.answered_water == pytest.approx(0.9 + false)
        assert row.abs_rel_water == pytest.approx(false)
        assert row.false_water == pytest.approx(false)


def test_every_pixel_gets_the_verdict_that_it_deserves() -> None:
    true = np.full((48, 64), 10.0, np.float32)
    true[:, 48:] = np.inf
    depth = np.array([10.1, 11.5, 16.0, 40.0, 5.0, 10.0, 8.0, 60.0]).repeat(8)
    valid = np.arange(8).repeat(8) != 5
    ours = _map(np.tile(depth, (48, 1)), np.tile(valid, (48, 1)), np.ones(true.shape))
    verdict = verdicts(ours, true, RAYS_M, 25.0)
    assert verdict[24, 4::8].tolist() == [RIGHT_, NEARLY, BEHIND, OPEN, BEFORE, SILENT, GHOST, ELSEWHERE]
    place = places(np.full((48, 64, 3), 90, np.uint8), true, np.zeros(true.shape, np.bool_))
    assert PLACES[place[24, 20]] == "on bare surface"
    assert PLACES[place[24, 46]] == "within 3 pixels of an edge in depth"
    summed = causes(verdict, place, ours, true)
    answered = np.isfinite(true) & np.tile(valid, (48, 1))
    assert summed.pixels.sum() == answered.sum()
    assert summed.error.sum() == pytest.approx(np.abs(ours.depth_m[answered] / 10.0 - 1.0).sum(), rel=1e-5)
    assert summed.error[BEHIND].sum() == pytest.approx(0.6 * 8 * 48, rel=1e-5)


def test_sparsification_by_the_error_itself_is_the_least() -> None:
    rng = np.random.default_rng(1)
    error = rng.exponential(size=2000).astype(np.float32)
    best = sparsification(error, error)
    assert np.all(np.diff(best) <= 1e-12)
    assert np.all(sparsification(error, rng.uniform(size=2000).astype(np.float32)) >= best - 1e-12)


def test_honest_confidence_is_calibrated_and_boasting_is_not(wall: tuple[np.ndarray, DepthMap]) -> None:
    true, ours = wall
    count = np.isfinite(true)
    honest = judged(replace(ours, confidence=np.where(ours.depth_m < 15.0, 1.0, 0.0).astype(np.float32)), true, count,
                    ~count, count)
    boast = replace(honest, confidence=np.ones_like(honest.confidence))
    assert calibration_error(honest) == 0.0
    assert calibration_error(boast) == pytest.approx(float((honest.error >= RIGHT).mean()))


def test_given_file_is_walked_judged_and_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, data, page = tmp_path / "tower.glb", tmp_path / "data", tmp_path / "page.html"
    trimesh.creation.box(bounds=[(-4.0, -4.0, 0.0), (4.0, 4.0, 14.0)]).export(scene)
    command = ["--scenes", str(scene), "--walks", "1", "--moves", "2", "--data", str(data), "--page", str(page),
               "--json"]
    assert main(command) == 0
    first = json.loads(capsys.readouterr().out)
    assert main(command) == 0
    again = json.loads(capsys.readouterr().out)
    for row in (*first, *again):
        row.pop("cpu_seconds")
    assert first == again
    assert first[0]["pictures"] == 9
    assert first[0]["answered"] > 0.5
    assert first[0]["delta_1_25"] > 0.9
    shown = page.read_text(encoding="utf-8")
    assert "data:image/jpeg" in shown
    assert "part of all error" in shown
