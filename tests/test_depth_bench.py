"""The depth benchmark walks a given file, judges honestly, and shows where depth fails."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ground_station.bench.depth import main
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
    row = summary("wall", 1, judged(ours, true, count, count), ghosts(ours, true, RAYS_M, 25.0), 0.1)
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
    row = summary("wall", 1, judged(None, true, count, count), np.zeros(2, np.int64), 0.1)
    assert (row.answered, row.abs_rel_all, row.delta_1_25_all) == (0.0, 1.0, 0.0)


def test_surface_claimed_in_the_sky_is_a_ghost(wall: tuple[np.ndarray, DepthMap]) -> None:
    true, ours = wall
    bold = replace(ours, depth_m=np.full_like(ours.depth_m, 10.0), valid=np.ones_like(ours.valid))
    wrong, claimed = ghosts(bold, true, RAYS_M, 25.0)
    assert claimed == true.size
    assert wrong == np.isinf(true).sum()


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
                    count)
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
    assert "data:image/jpeg" in page.read_text(encoding="utf-8")
