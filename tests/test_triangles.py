"""Long thin triangles: cut so that single precision does not lose the nearest point on them."""

from __future__ import annotations

import numpy as np
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from missions.triangles import without_slivers
from sim_bridge.truth import BEFORE_FLIGHT_NS, Truth


@given(st.integers(0, 10_000))
def test_what_is_cut_keeps_its_area_and_its_triangle(seed: int) -> None:
    corners = np.random.default_rng(seed).normal(size=(5, 3, 3)) * [30.0, 0.5, 0.05]
    pieces, of = without_slivers(corners)
    area = 0.5 * np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    whole = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    np.testing.assert_allclose(np.bincount(of, area, minlength=5), whole, rtol=1e-6, atol=1e-9)


@given(st.integers(0, 10_000))
def test_the_referee_measures_to_a_long_thin_ledge(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    ledge = np.array([[-25.0, 0, 0], [25, 0, 0], [25, 0.12, 0], [-25, 0.12, 0]])
    points = np.column_stack([rng.uniform(-25, 25, 200), rng.uniform(-1.5, 1.5, 200), rng.uniform(-1.5, 1.5, 200)])
    beside = np.maximum(np.maximum(-points[:, 1], points[:, 1] - 0.12), 0.0)
    truth = Truth(ledge @ turn.T + 20.0, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    distance = truth.distance(points @ turn.T + 20.0, np.full(len(points), BEFORE_FLIGHT_NS))
    np.testing.assert_allclose(distance, np.hypot(beside, points[:, 2]), atol=2e-4)
