"""Ways between all places at once: clear, symmetric, hardly longer than searched ones, and none is missed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.grid import FREE, OCCUPIED, VoxelGrid
from planning.paths import NoPath, VoxelField, reachable
from planning.paths.roadmap import Roadmap, build_roadmap

SIZE_M = np.array([20.0, 16.0, 12.0])
NEED_M = 1.0
SLACK_M = 0.03
"""Segments are walked in steps between which the clearance may be this much less."""
WALL = (slice(18, 22), slice(0, 22), slice(0, 24))
CLOSED = (slice(18, 22), slice(0, 32), slice(0, 24))
seeds = st.integers(0, 2**32 - 1)


def field_with(*boxes: tuple[slice, slice, slice]) -> VoxelField:
    """A free field of 0.5 m voxels with solid boxes."""
    grid = VoxelGrid.unknown(np.zeros(3), SIZE_M, 0.5)
    grid.state[:] = FREE
    for box in boxes:
        grid.state[box] = OCCUPIED
    return VoxelField.from_grid(grid)


def places_in(field: VoxelField, seed: int, count: int = 30) -> np.ndarray:
    """Random places that keep the clearance."""
    points = np.random.default_rng(seed).uniform(0.0, SIZE_M, (400, 3))
    return points[field.clearance_m(points) >= NEED_M][:count]


def walked_m(path: np.ndarray) -> float:
    """Length of a path (k, 3)."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_ways_are_clear_symmetric_and_no_longer_than_they_say(seed: int) -> None:
    field = field_with(WALL).with_spheres(np.random.default_rng(seed).uniform(0.0, SIZE_M, (3, 3)), 1.0)
    places = places_in(field, seed)
    roadmap = build_roadmap(field, places, NEED_M)
    straight = np.linalg.norm(places[:, None] - places, axis=2)
    seen = field.segments_clear(np.repeat(places, len(places), axis=0), np.tile(places, (len(places), 1)), NEED_M)
    clear = seen.reshape(straight.shape) & seen.reshape(straight.shape).T
    np.testing.assert_array_equal(roadmap.lengths_m, roadmap.lengths_m.T)
    np.testing.assert_allclose(roadmap.lengths_m[clear], straight[clear], atol=1e-6)
    assert np.all(roadmap.lengths_m >= straight - 1e-6)
    for i, j in np.random.default_rng(seed).integers(0, len(places), (20, 2)):
        path = roadmap.path(i, j)
        np.testing.assert_array_equal(path[[0, -1]], places[[i, j]])
        assert field.segments_clear(path[:-1], path[1:], NEED_M - SLACK_M).all()
        assert walked_m(path) <= roadmap.lengths_m[i, j] + 1e-6
        corners = roadmap.corners_enu_m[i, j]
        raw = np.concatenate([places[[i]], corners[np.isfinite(corners[:, 0])], places[[j]]])
        assert walked_m(raw) == pytest.approx(roadmap.lengths_m[i, j])


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_ways_are_hardly_longer_than_searched_voxel_by_voxel(seed: int) -> None:
    field = field_with(WALL)
    places = places_in(field, seed)
    lengths = build_roadmap(field, places, NEED_M).lengths_m
    reach = reachable(field, places[0], NEED_M)
    searched = np.array([walked_m(reach.path_to(p)) for p in places[1:]])
    assert np.mean(lengths[0, 1:] / searched) < 1.06


def test_what_the_graph_misses_is_searched_and_what_is_walled_off_is_not_connected() -> None:
    hole = VoxelGrid.unknown(np.zeros(3), SIZE_M, 0.5)
    hole.state[:] = FREE
    hole.state[CLOSED] = OCCUPIED
    hole.state[18:22, 20:25, 10:15] = FREE
    places = np.array([[3.0, 3, 3], [5.0, 12, 9], [16.0, 4, 4], [17.0, 13, 8]])
    lengths = build_roadmap(VoxelField.from_grid(hole), places, NEED_M).lengths_m
    assert np.isfinite(lengths).all()
    assert lengths[0, 2] > 1.15 * np.linalg.norm(places[2] - places[0])
    closed = build_roadmap(field_with(CLOSED), places, NEED_M)
    assert np.isfinite(closed.lengths_m).tolist() == [[True, True, False, False]] * 2 + [[False, False, True, True]] * 2
    with pytest.raises(NoPath):
        closed.path(0, 3)


def test_a_vehicle_in_a_narrow_place_is_led_out_and_a_view_there_is_not() -> None:
    field = field_with(WALL)
    places = np.array([[8.2, 5.0, 6.0], [3.0, 3.0, 3.0], [16.0, 5.0, 6.0]])
    assert 0.4 < field.clearance_m(places[:1])[0] < NEED_M
    as_start = build_roadmap(field, places, NEED_M, starts=1)
    assert np.isfinite(as_start.lengths_m).all()
    out = as_start.path(0, 2)
    assert field.segments_clear(out[1:-1], out[2:], NEED_M - SLACK_M).all()
    assert np.isinf(build_roadmap(field, places, NEED_M).lengths_m[0, 1:]).all()


def test_places_may_coincide_and_one_alone_is_a_roadmap() -> None:
    places = np.array([[3.0, 3, 3], [3.0, 3, 3], [5.0, 6, 7]])
    roadmap = build_roadmap(field_with(), places, NEED_M)
    assert roadmap.lengths_m[0, 1] == pytest.approx(0.0, abs=1e-6)
    assert isinstance(roadmap, Roadmap)
    assert build_roadmap(field_with(), places[:1], NEED_M).lengths_m.tolist() == [[0.0]]


def test_equal_arguments_give_equal_ways() -> None:
    field = field_with(WALL)
    places = places_in(field, 7)
    one, other = (build_roadmap(field, places, NEED_M) for _ in range(2))
    assert one.lengths_m.tobytes() == other.lengths_m.tobytes()
    assert one.corners_enu_m.tobytes() == other.corners_enu_m.tobytes()
