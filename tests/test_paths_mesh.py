"""Clearance from a prior model: never more than true, swept bodies keep their margin, the inside is solid."""

from __future__ import annotations

import itertools

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.grid import FREE, OCCUPIED, VoxelGrid
from planning.paths import MeshField, NoPath, VoxelField, plan_path, shortcut, voxelised

LOWER, UPPER = np.zeros(3), np.array([20.0, 16.0, 12.0])
seeds = st.integers(0, 2**32 - 1)


def boxes_mesh(boxes: np.ndarray) -> trimesh.Trimesh:
    """Boxes (n, 2, 3), lower and upper corner, as one mesh."""
    return trimesh.util.concatenate([trimesh.creation.box(bounds=b) for b in boxes])


def field_of(mesh: trimesh.Trimesh, voxel: float = 0.5) -> tuple[MeshField, VoxelGrid]:
    grid = voxelised(mesh.vertices, mesh.faces, LOWER, UPPER, voxel)
    return MeshField.from_mesh(mesh.vertices, mesh.faces, grid), grid


def random_boxes(rng: np.random.Generator, count: int) -> np.ndarray:
    corner, size = rng.uniform(LOWER, UPPER, (count, 3)), rng.uniform(0.3, 4.0, (count, 3))
    return np.stack([corner, corner + size], axis=1)


def true_clearance(boxes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance to the nearest box or to the outside of the world."""
    gap = np.maximum(np.maximum(boxes[:, 0] - points[:, None], points[:, None] - boxes[:, 1]), 0.0)
    border = np.minimum(points - LOWER, UPPER - points).min(axis=1)
    return np.maximum(np.minimum(np.linalg.norm(gap, axis=2).min(axis=1), border), 0.0)


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_clearance_is_never_more_than_true_and_exact_nearby(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = random_boxes(rng, 6)
    field, grid = field_of(boxes_mesh(boxes))
    points = rng.uniform(LOWER - 1.0, UPPER + 1.0, (150, 3))
    truth = true_clearance(boxes, points)
    got = field.clearance_m(points)
    assert np.all(got <= truth + 1e-5)
    near = (grid.state_at(points) == FREE) & (truth > 0.5 * np.sqrt(3.0)) & (truth < 3.0)
    assert np.all(got[near] >= truth[near] - 1e-5)


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_a_swept_body_keeps_its_margin_and_only_that(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = random_boxes(rng, 5)
    field, _ = field_of(boxes_mesh(boxes))
    sphere = rng.uniform(LOWER, UPPER, 3)
    a, b = rng.uniform(LOWER, UPPER, (2, 30, 3))
    b[0] = a[0]
    clear = field.with_spheres(sphere, 0.7).segments_clear(a, b, 1.0)
    f = np.linspace(0.0, 1.0, 300)[:, None]
    fine = a[:, None] + f * (b - a)[:, None]
    truth = true_clearance(boxes, fine.reshape(-1, 3)).reshape(30, -1)
    truth = np.minimum(truth, np.linalg.norm(fine - sphere, axis=2) - 0.7).min(axis=1)
    assert np.all(truth[clear] >= 1.0 - 1e-5)
    assert np.all(clear[truth > 1.0 + 0.05])


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_voxels_hold_all_of_the_mesh_and_nothing_beside_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = random_boxes(rng, 4)
    _, grid = field_of(boxes_mesh(boxes))
    inside = rng.uniform(boxes[:, 0], boxes[:, 1], (200, 4, 3)).reshape(-1, 3)
    inside = inside[np.all((inside >= LOWER) & (inside < UPPER), axis=1)]
    assert np.all(grid.state_at(inside) == OCCUPIED)
    anywhere = rng.uniform(LOWER, UPPER, (300, 1, 3))
    beside = np.maximum(boxes[:, 0] - anywhere, anywhere - boxes[:, 1])[..., :2].max(axis=2) > grid.voxel_m
    assert np.all(grid.state_at(anywhere[:, 0])[beside.all(axis=1)] == FREE)


def test_the_inside_of_a_closed_mesh_is_solid() -> None:
    field, grid = field_of(boxes_mesh(np.array([[[4.0, 4, 2], [12.0, 12, 9]]])))
    middle = np.array([[8.0, 8.0, 5.0]])
    assert field.clearance_m(middle).tolist() == [0.0]
    assert not field.segments_clear(middle, middle + 0.5, 0.3).any()
    assert grid.state_at(middle)[0] == OCCUPIED
    assert grid.state_at(np.array([[2.0, 2.0, 2.0]]))[0] == FREE


def test_a_path_around_a_box_keeps_the_margin() -> None:
    boxes = np.array([[[8.0, 0, 0], [11.0, 9, 12]]])
    field, _ = field_of(boxes_mesh(boxes))
    path = plan_path(field, np.array([4.0, 4, 6]), np.array([16.0, 4, 6]), 1.2, LOWER, UPPER)
    f = np.linspace(0.0, 1.0, 400)[:, None]
    fine = np.concatenate([p + f * (q - p) for p, q in itertools.pairwise(path)])
    assert true_clearance(boxes, fine).min() >= 1.2 - 1e-5


def wall_with_a_hole(center: np.ndarray, width: float, thickness: float) -> np.ndarray:
    """Four boxes across the world around a square hole."""
    (x, y, z), half = center, 0.5 * width
    x0, x1 = x - 0.5 * thickness, x + 0.5 * thickness
    return np.array([[[x0, 0, 0], [x1, 16, z - half]], [[x0, 0, z + half], [x1, 16, 12]],
                     [[x0, 0, z - half], [x1, y - half, z + half]], [[x0, y + half, z - half], [x1, 16, z + half]]])


@given(seeds)
@settings(max_examples=8, deadline=None)
def test_a_hole_that_leaves_a_hand_on_each_side_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = wall_with_a_hole(rng.uniform([9, 4, 3], [11, 12, 9]), 2.4, rng.uniform(0.2, 2.0))
    field, _ = field_of(boxes_mesh(boxes))
    start, goal = rng.uniform([2, 2, 2], [6, 14, 10]), rng.uniform([14, 2, 2], [18, 14, 10])
    path = plan_path(field, start, goal, 1.0, LOWER, UPPER)
    assert path.tobytes() == plan_path(field, start, goal, 1.0, LOWER, UPPER).tobytes()
    f = np.linspace(0.0, 1.0, 400)[:, None]
    fine = np.concatenate([p + f * (q - p) for p, q in itertools.pairwise(path)])
    assert true_clearance(boxes, fine).min() >= 1.0 - 1e-5
    assert np.array_equal(path[[0, -1]], [start, goal])


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_the_finer_lattice_is_only_refused_where_there_is_no_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clearance, center = rng.uniform(1.0, 1.5), rng.uniform([9, 5, 4], [11, 11, 8])
    ends = center + np.array([[-5.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    for width, passable in ((2.0 * clearance + 0.01, True), (0.8, False)):
        field, _ = field_of(boxes_mesh(wall_with_a_hole(center, width, rng.uniform(0.2, 2.0))))
        assert (field.finer(ends, 8.0, clearance) is not None) == passable


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_the_lattice_decides_as_a_closer_look_does_or_not_at_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    field = field_of(boxes_mesh(random_boxes(rng, 5)))[0].with_spheres(rng.uniform(LOWER, UPPER, (2, 3)), 0.5)
    a, b = rng.uniform(LOWER, UPPER, (2, 60, 3))
    clear, undecided = field.lattice_verdicts(a, b, 1.0)
    closer = field.segments_clear(a, b, 1.0)
    assert not np.any(clear & undecided)
    assert np.array_equal(clear[~undecided], closer[~undecided])


@given(seeds)
@settings(max_examples=8, deadline=None)
def test_no_clear_chord_makes_a_straightened_path_cheaper(seed: int) -> None:
    rng = np.random.default_rng(seed)
    field, _ = field_of(boxes_mesh(random_boxes(rng, 8)))
    path = next((p for p in (answer(field, *ends)[0] for ends in rng.uniform(LOWER, UPPER, (12, 2, 3)))
                 if p is not None and len(p) > 2), None)
    if path is None:
        return
    zigzag = np.insert(path, np.arange(1, len(path)), 0.5 * (path[:-1] + path[1:]), axis=0)
    short = shortcut(field, zigzag, 1.0)
    i, j = np.triu_indices(len(short), 2)
    assert not field.segments_clear(short[i], short[j], 1.0).any()
    assert field.segments_clear(short[:-1], short[1:], 1.0).all()


def answer(field: MeshField | VoxelField, start: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray | None, str]:
    """The path, or the reason why there is none."""
    try:
        return plan_path(field, start, goal, 1.0, LOWER, UPPER), ""
    except NoPath as refusal:
        return None, refusal.reason


@given(seeds)
@settings(max_examples=8, deadline=None)
def test_paths_among_boxes_keep_the_margin_or_are_refused_with_the_reason(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = random_boxes(rng, 8)
    field, grid = field_of(boxes_mesh(boxes))
    for known in (field, VoxelField.from_grid(grid)):
        for start, goal in rng.uniform(LOWER, UPPER, (6, 2, 3)):
            path, reason = answer(known, start, goal)
            room = known.clearance_m(np.stack([start, goal]))
            if path is None:
                assert reason == ("start" if room[0] < 1.0 else "goal" if room[1] < 1.0 else "search")
                continue
            f = np.linspace(0.0, 1.0, 300)[:, None]
            fine = np.concatenate([p + f * (q - p) for p, q in itertools.pairwise(path)])
            assert true_clearance(boxes, fine).min() >= 1.0 - 1e-5


def test_a_sealed_goal_is_refused() -> None:
    walls = np.array([[[6.0, 4, 1], [14.0, 5, 8]], [[6.0, 11, 1], [14.0, 12, 8]], [[6.0, 4, 1], [7.0, 12, 8]],
                      [[13.0, 4, 1], [14.0, 12, 8]], [[6.0, 4, 1], [14.0, 12, 2]]])
    lid = np.array([[[6.0, 4, 8], [14.0, 12, 8.5]]])
    ends = np.array([[2.0, 8.0, 5.0], [10.0, 8.0, 5.0]])
    assert answer(field_of(boxes_mesh(np.concatenate([walls, lid])))[0], *ends) == (None, "goal")
    path, _ = answer(field_of(boxes_mesh(walls))[0], *ends)
    assert path is not None
    assert path[:, 2].max() > 8.0
