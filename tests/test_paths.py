"""Clearance never exceeds the truth, paths keep it, equal seeds give equal paths."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from planning.paths import NoPath, VoxelField, plan_path, reachable, search_kernels, shortcut

LOWER, UPPER = np.zeros(3), np.array([20.0, 16.0, 12.0])
seeds = st.integers(0, 2**32 - 1)


def grid_with(*boxes: tuple[slice, slice, slice], voxel: float = 0.5) -> VoxelGrid:
    """A free grid with solid boxes of voxels."""
    grid = VoxelGrid.unknown(LOWER, UPPER, voxel)
    grid.state[:] = FREE
    for box in boxes:
        grid.state[box] = OCCUPIED
    return grid


WALL = (slice(18, 22), slice(0, 22), slice(0, 24))
"""x 9 to 11, leaving y > 11 open."""
CLOSED = (slice(18, 22), slice(0, 32), slice(0, 24))


def true_clearance(grid: VoxelGrid, points: np.ndarray) -> np.ndarray:
    """Distance to the nearest cube that is not free, or to the outside, by brute force."""
    lower = grid.origin_enu_m + np.argwhere(grid.state != FREE) * grid.voxel_m
    top = grid.origin_enu_m + np.array(grid.state.shape) * grid.voxel_m
    out = np.minimum(points - grid.origin_enu_m, top - points).min(axis=1)
    for n, p in enumerate(points):
        gap = np.maximum(np.maximum(lower - p, p - lower - grid.voxel_m), 0.0)
        out[n] = min(out[n], np.sqrt((gap**2).sum(axis=1).min(initial=np.inf)))
    return np.maximum(out, 0.0)


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_clearance_is_below_the_truth_and_near_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = grid_with()
    solid = rng.integers(0, grid.state.shape, (rng.integers(1, 60), 3))
    grid.state[tuple(solid.T)] = rng.choice([UNKNOWN, OCCUPIED], len(solid))
    points = rng.uniform(LOWER - 1.0, UPPER + 1.0, (100, 3))
    truth = np.minimum(true_clearance(grid, points), 8.0)
    got = VoxelField.from_grid(grid).clearance_m(points)
    assert np.all(got <= truth + 1e-5)
    assert np.all(got >= truth - grid.voxel_m * np.sqrt(3.0))
    assert np.mean(truth - got) < 0.4 * grid.voxel_m


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_spheres_take_their_share(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centers, radii = rng.uniform(LOWER, UPPER, (5, 3)), rng.uniform(0.1, 3.0, 5)
    plain = VoxelField.from_grid(grid_with(WALL))
    points = rng.uniform(LOWER, UPPER, (50, 3))
    gap = np.linalg.norm(points[:, None] - centers, axis=2) - radii
    wanted = np.maximum(0.0, np.minimum(plain.clearance_m(points), gap.min(axis=1)))
    np.testing.assert_allclose(plain.with_spheres(centers, radii).clearance_m(points), wanted, atol=1e-9)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_a_clear_segment_is_clear_everywhere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = grid_with(WALL)
    field = VoxelField.from_grid(grid)
    a, b = rng.uniform(LOWER, UPPER, (2, 20, 3))
    clear = field.segments_clear(a, b, 1.0)
    f = np.linspace(0.0, 1.0, 100)[:, None]
    truth = np.array([true_clearance(grid, p + f * (q - p)).min() for p, q in zip(a, b, strict=True)])
    assert np.all(truth[clear] >= 1.0)
    assert np.all(clear[truth > 1.0 + 0.5 * grid.voxel_m])


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_points_are_connected_that_lie_in_one_piece(seed: int) -> None:
    rng = np.random.default_rng(seed)
    room = (rng.random(rng.integers(1, 9, 3)) < rng.uniform(0.1, 0.9)).astype(np.float32)
    starts, ends = (np.unique(rng.integers(0, room.size, rng.integers(1, 4))) for _ in range(2))
    pieces = ndimage.label(room >= 1.0, np.ones((3, 3, 3)))[0].reshape(-1)
    shared = np.intersect1d(pieces[starts], pieces[ends])
    assert search_kernels.connected(room, 1.0, starts, ends) == bool(shared.any() or np.isin(starts, ends).any())


def test_unknown_and_outside_are_solid_unless_told_otherwise() -> None:
    grid = grid_with()
    grid.state[20, 16, 12] = UNKNOWN
    inside = grid.centers(np.array([[20, 16, 12]]))
    assert VoxelField.from_grid(grid).clearance_m(inside)[0] == 0.0
    assert VoxelField.from_grid(grid, unknown_is_solid=False).clearance_m(inside)[0] > 5.0
    assert VoxelField.from_grid(grid).clearance_m(np.array([[-1.0, 5.0, 5.0], [1e9, 0.0, 0.0]])).tolist() == [0.0, 0.0]


def test_a_clear_line_is_returned_as_it_is() -> None:
    field = VoxelField.from_grid(grid_with())
    path = plan_path(field, np.array([3.0, 3, 3]), np.array([17.0, 12, 9]), 1.2, LOWER, UPPER)
    assert path.tolist() == [[3, 3, 3], [17, 12, 9]]


def test_a_path_leads_around_the_wall_and_repeats_itself() -> None:
    field = VoxelField.from_grid(grid_with(WALL))
    a, b = np.array([4.0, 5.0, 6.0]), np.array([16.0, 5.0, 6.0])
    path = plan_path(field, a, b, 1.2, LOWER, UPPER)
    plan_path(field, a, b, 1.3, LOWER, UPPER)
    again = plan_path(field, a, b, 1.2, LOWER, UPPER)
    assert path.tobytes() == again.tobytes()
    assert path[0].tolist() == a.tolist()
    assert path[-1].tolist() == b.tolist()
    assert field.segments_clear(path[:-1], path[1:], 1.2).all()
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() < 26.0  # about 20.5 m is shortest


@pytest.mark.parametrize(("start", "goal", "reason"), [
    ((9.5, 5, 6), (16, 5, 6), "start"), ((4, 5, 6), (10, 5, 6), "goal"), ((4, 5, 6), (40, 5, 6), "outside"),
    ((4, 5, 6), (16, 5, 6), "search")])
def test_refusals_say_why(start: tuple[float, ...], goal: tuple[float, ...], reason: str) -> None:
    field = VoxelField.from_grid(grid_with(CLOSED))
    with pytest.raises(NoPath) as refusal:
        plan_path(field, np.array(start, float), np.array(goal, float), 1.2, LOWER, UPPER)
    assert refusal.value.reason == reason


def test_shortcut_removes_what_is_not_needed() -> None:
    field = VoxelField.from_grid(grid_with())
    zigzag = np.array([[3.0, 3, 3], [5, 8, 3], [9, 3, 8], [16, 12, 8]])
    assert len(shortcut(field, zigzag, 1.2)) == 2


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_reach_finds_clear_paths_of_the_length_it_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    field = VoxelField.from_grid(grid_with(WALL)).with_spheres(rng.uniform(LOWER, UPPER, (2, 3)), 1.0)
    start = np.array([3.0, 3.0, 3.0])
    reach = reachable(field, start, 1.2)
    goals = rng.uniform(LOWER, UPPER, (20, 3))
    for goal, far in zip(goals, reach.distance_to(goals), strict=True):
        if not np.isfinite(far):
            with pytest.raises(NoPath):
                reach.path_to(goal)
            continue
        path = reach.path_to(goal)
        assert np.array_equal(path[0], start)
        assert np.array_equal(path[-1], goal)
        first = int(reach.narrow)
        assert field.segments_clear(path[first:-1], path[first + 1:], 1.2 - 1e-3).all()
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        assert np.linalg.norm(goal - start) - 1e-6 <= length <= far * 1.02 + 1e-6


def test_what_is_walled_off_is_not_reached() -> None:
    reach = reachable(VoxelField.from_grid(grid_with(CLOSED)), np.array([4.0, 5, 6]), 1.2)
    assert np.isinf(reach.distance_to(np.array([[16.0, 5, 6]]))[0])
    assert np.isinf(reachable(VoxelField.from_grid(grid_with(CLOSED)), np.array([10.0, 5, 6]), 1.2).distance_m).all()


def test_many_goals_cost_hardly_more_than_few() -> None:
    state = np.full((160, 70, 60), FREE, np.uint8)
    state[60:100, 30:40, :40] = OCCUPIED
    field = VoxelField.from_grid(VoxelGrid(np.zeros(3), 0.5, state))
    goals = np.random.default_rng(1).uniform([2, 2, 2], [78, 33, 28], (500, 3))

    def work_s(count: int) -> float:
        began = time.process_time()
        reachable(field, np.array([40.0, 5.0, 5.0]), 1.7).distance_to(goals[:count])
        return time.process_time() - began

    work_s(1)
    assert min(work_s(500) for _ in range(3)) < 5.0 * min(work_s(5) for _ in range(3))


def test_a_start_that_became_narrow_is_left_for_a_wide_place_nearby() -> None:
    field = VoxelField.from_grid(grid_with(WALL))
    start, goal = np.array([8.0, 5.0, 6.0]), np.array([16.0, 5.0, 6.0])
    assert 0.5 < field.clearance_m(start)[0] < 1.2
    path = reachable(field, start, 1.2).path_to(goal)
    assert path[0].tolist() == start.tolist()
    assert field.clearance_m(path[1:]).min() >= 1.2
    assert field.segments_clear(path[1:-1], path[2:], 1.2).all()
    assert np.linalg.norm(path[1] - start) <= 3.0
    assert path[1][0] < start[0]


def test_nothing_is_reached_from_deep_inside_a_wall() -> None:
    thick = VoxelField.from_grid(grid_with((slice(10, 30), slice(0, 32), slice(0, 24))))
    assert np.isinf(reachable(thick, np.array([10.0, 8.0, 6.0]), 1.2).distance_m).all()
