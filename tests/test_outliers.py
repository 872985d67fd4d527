"""Leaving out points that their neighbours' surfaces pass by."""

from __future__ import annotations

import numpy as np
import pytest

from perception.reconstruct.cloud import Cloud
from perception.reconstruct.outliers import without_outliers

SPACING_M = 0.03


def cloud_of(points: np.ndarray, normals: np.ndarray, confidence: int = 4) -> Cloud:
    n = len(points)
    return Cloud(points.astype(np.float32), np.zeros((n, 3), np.uint8),
                 np.broadcast_to(normals, (n, 3)).astype(np.float32), np.full(n, confidence, np.uint8))


def sheet(seed: int, noise_m: float = 0.003) -> np.ndarray:
    """Two metres square in the plane z = 0, a point per voxel."""
    rng = np.random.default_rng(seed)
    across, along = np.meshgrid(np.arange(-1.0, 1.0, SPACING_M), np.arange(-1.0, 1.0, SPACING_M))
    flat = np.column_stack([across.ravel(), along.ravel(), np.zeros(across.size)])
    return flat + rng.normal(0.0, noise_m, flat.shape)


@pytest.mark.parametrize("threads", [1, 3])
def test_points_beside_a_wall_go_and_the_wall_stays(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perception.reconstruct.outliers.AT_ONCE_CELLS", 50)
    rng = np.random.default_rng(2)
    off = rng.choice([-1, 1], 300) * rng.uniform(0.03, 0.06, 300)
    beside = np.column_stack([rng.uniform(-0.9, 0.9, (300, 2)), off])
    wall = cloud_of(sheet(1), np.array([0.0, 0.0, 1.0]))
    tilted = rng.normal([0.0, 0.0, 1.0], 0.3, (300, 3))
    wrong = cloud_of(beside, tilted / np.linalg.norm(tilted, axis=1, keepdims=True), 3)
    kept = without_outliers(Cloud.concatenate([wrong, wall]), SPACING_M, threads)
    height = np.abs(kept.points_enu_m[:, 2])
    assert np.sum(height > 0.03) <= 6
    assert np.sum(height < 0.02) >= 0.995 * len(wall)
    assert np.array_equal(kept.points_enu_m[-100:], wall.points_enu_m[-100:]), "in the order they came"


def test_both_sides_of_a_plate_edges_and_single_points_stay() -> None:
    up, east = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    top, below = cloud_of(sheet(1), up), cloud_of(sheet(2) - [0.0, 0.0, 0.04], -up)
    end = cloud_of(sheet(3)[:, [2, 1, 0]] + [1.0, 0.0, -1.0], east)
    alone = cloud_of(np.array([[5.0, 5.0, 5.0]]), up, 1)
    whole = Cloud.concatenate([top, below, end, alone])
    assert len(without_outliers(whole, SPACING_M)) > 0.98 * len(whole)
    assert len(without_outliers(alone, SPACING_M)) == 1
    assert len(without_outliers(alone.select(np.zeros(1, bool)), SPACING_M)) == 0
