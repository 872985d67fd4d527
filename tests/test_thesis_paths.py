"""The thesis's collision detection and replanning against a mesh."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from trimesh.intersections import planes_lines

from planning.paths import NoPath
from planning.paths.thesis import NO_VIEW, repair_route, way_round
from planning.paths.thesis_boxes import Box, clipped, halves, hit_triangles
from planning.paths.thesis_rrt import clear, connect

Floats = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)
LOWER, UPPER = np.array([-15.0, -15.0, 0.5]), np.array([15.0, 15.0, 20.0])


def wall(thickness: float = 0.5, edge: float = 100.0) -> Floats:
    """Triangles of a wall 12 m long and 8 m high across the East axis, cut to edges of at most `edge` metres."""
    box = trimesh.creation.box((thickness, 12.0, 8.0))
    box.apply_translation((0.0, 0.0, 4.0))
    return np.asarray(box.subdivide_to_size(edge).triangles, dtype=np.float64)


def crossings(points: Floats, triangles: Floats) -> list[int]:
    return [leg for leg, (a, b) in enumerate(pairwise(points)) if len(hit_triangles(a, b, triangles))]


@given(seeds)
@settings(deadline=None, max_examples=100)
def test_moeller_trumbore_finds_what_planes_and_barycentric_coordinates_find(seed: int) -> None:
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-4.0, 4.0, (200, 3, 3))
    a, b = rng.uniform(-5.0, 5.0, (2, 3))
    normals, _ = trimesh.triangles.normals(triangles)
    places, crossing, along = planes_lines(triangles[:, 0], normals, np.tile(a, (200, 1)), np.tile(b - a, (200, 1)),
                                           return_distance=True)
    inside = (trimesh.triangles.points_to_barycentric(triangles[crossing], places) >= 0.0).all(axis=1)
    met = np.flatnonzero(crossing)[inside & (along >= 0.0) & (along <= 1.0)]
    assert list(hit_triangles(a, b, triangles)) == list(met)


def test_a_leg_hits_a_triangle_that_is_larger_than_the_leg() -> None:
    triangle = np.array([[[0.0, -99.0, -99.0], [0.0, 99.0, -99.0], [0.0, 0.0, 99.0]]])
    assert list(hit_triangles(np.array([-0.1, 0.0, 0.0]), np.array([0.1, 0.0, 0.0]), triangle)) == [0]
    assert not len(hit_triangles(np.array([-0.2, 0.0, 0.0]), np.array([-0.1, 0.0, 0.0]), triangle))
    assert not len(hit_triangles(np.array([-0.2, 0.0, 0.0]), np.array([-0.2, 0.0, 0.0]), triangle))


@given(seeds, st.floats(1.0, 4.0))
@settings(deadline=None)
def test_expansion_keeps_the_axis_of_flight_and_scales_the_others(seed: int, alpha: float) -> None:
    lower, upper = np.sort(np.random.default_rng(seed).uniform(-9.0, 9.0, (2, 3)), axis=0)
    for axis in range(3):
        for sign in (-1.0, 1.0):
            grown = Box(lower, upper).expanded(sign * np.eye(3)[axis], alpha)
            factor = np.where(np.arange(3) == axis, 1.0, alpha)
            assert np.allclose(grown.upper - grown.lower, factor * (upper - lower))
            assert np.allclose(grown.upper + grown.lower, upper + lower)


@given(seeds)
@settings(deadline=None)
def test_expansion_in_any_direction_holds_the_box_and_alpha_1_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lower, upper = np.sort(rng.uniform(-9.0, 9.0, (2, 3)), axis=0)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    grown, same = Box(lower, upper).expanded(direction, 1.5), Box(lower, upper).expanded(direction, 1.0)
    assert np.all(grown.lower <= lower + 1e-9)
    assert np.all(grown.upper >= upper - 1e-9)
    assert np.allclose(same.lower, lower)
    assert np.allclose(same.upper, upper)


@given(seeds)
@settings(deadline=None, max_examples=50)
def test_clipping_keeps_exactly_what_lies_in_the_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-4.0, 4.0, (10, 3, 3))
    box = Box(*np.sort(rng.uniform(-4.0, 4.0, (2, 3)), axis=0))
    part = clipped(triangles, box)
    assert box.grown(1e-9).contains(part).all()
    samples = np.einsum("mki,mij->mkj", rng.dirichlet(np.ones(3), (10, 20)), triangles).reshape(-1, 3)
    for sample in samples[box.contains(samples)]:
        assert gap_m(part, sample) < 1e-9
    for middle in part.mean(axis=1):
        assert gap_m(triangles, middle) < 1e-9


def gap_m(triangles: Floats, point: Floats) -> float:
    nearest = trimesh.triangles.closest_point(triangles, np.tile(point, (len(triangles), 1)))
    return float(np.linalg.norm(nearest - point, axis=1).min())


def test_halves_are_the_same_surface_in_quarters() -> None:
    triangles = np.random.default_rng(1).uniform(size=(5, 3, 3))
    areas = trimesh.triangles.area(halves(triangles)).reshape(4, 5)
    assert np.allclose(areas, trimesh.triangles.area(triangles) / 4.0)


@given(seeds)
@settings(deadline=None, max_examples=40)
def test_the_trees_join_the_ends_outside_all_boxes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-6.0, 6.0, (4, 3))
    boxes = np.stack([centres - rng.uniform(0.5, 2.0, (4, 3)), centres + rng.uniform(0.5, 2.0, (4, 3))], axis=1)
    start, goal = np.array([-9.0, 0.0, 0.0]), np.array([9.0, 0.0, 0.0])
    lower, upper = np.full(3, -10.0), np.full(3, 10.0)
    path = connect(start, goal, boxes, lower, upper, 6.0, 400, seed)
    assert path is not None
    assert np.array_equal(path[[0, -1]], [start, goal])
    assert np.all((path >= lower) & (path <= upper))
    assert all(clear(a, b, boxes) for a, b in pairwise(path))
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= 6.0 * 3.0 + 1e-9
    again = connect(start, goal, boxes, lower, upper, 6.0, 400, seed)
    assert again is not None
    assert np.array_equal(path, again)


def test_no_way_out_of_a_closed_room() -> None:
    room = np.array([[[-2.0, -9.0, -9.0], [-1.0, 9.0, 9.0]]])
    bounds = np.full(3, -9.0), np.full(3, 9.0)
    assert connect(np.array([-5.0, 0, 0]), np.array([5.0, 0, 0]), room, *bounds, 5.0, 200, 1) is None


@given(seeds, st.sampled_from([0.6, 2.0, 100.0]), st.sampled_from([0.0, 0.5]))
@settings(deadline=None, max_examples=25)
def test_a_repaired_route_never_meets_the_mesh_and_keeps_every_view(seed: int, edge: float, thickness: float) -> None:
    triangles = wall(max(thickness, 1e-6), edge)
    route = np.random.default_rng(seed).uniform(LOWER, UPPER, (8, 3))
    route[:, 0] += np.where(route[:, 0] > 0.0, 1.0, -1.0)
    route = np.clip(route, LOWER, UPPER)
    repaired = repair_route(triangles, route, LOWER, UPPER, seed)
    assert repaired.refused == {}
    assert crossings(repaired.points_enu_m, triangles) == []
    flown = repaired.view != NO_VIEW
    assert np.array_equal(repaired.points_enu_m[flown], route)
    assert list(repaired.view[flown]) == list(range(len(route)))
    assert np.all((repaired.points_enu_m >= LOWER) & (repaired.points_enu_m <= UPPER))
    assert (~flown).any() == bool(crossings(route, triangles))


def test_a_view_inside_the_first_box_is_still_reached() -> None:
    ring = np.concatenate([wall(), wall() + np.array([6.0, 0.0, 0.0])])
    between, beyond = np.array([3.0, 0.0, 4.0]), np.array([-4.0, 0.0, 4.0])
    path = way_round(ring, between, beyond, LOWER, UPPER, 1)
    assert crossings(path, ring) == []


def test_a_view_in_a_closed_box_is_refused_and_named() -> None:
    cell = np.asarray(trimesh.creation.box((6.0, 6.0, 6.0)).triangles) + np.array([0.0, 0.0, 6.0])
    route = np.array([[-9.0, 0.0, 6.0], [0.0, 0.0, 6.0], [-9.0, 5.0, 6.0]])
    repaired = repair_route(cell, route, LOWER, UPPER, 1)
    assert set(repaired.refused) == {0, 1}
    assert np.array_equal(repaired.points_enu_m, route)
    with pytest.raises(NoPath):
        way_round(cell, route[0], route[1], LOWER, UPPER, 1)


def test_a_view_outside_the_scene_is_refused_only_when_its_leg_is_blocked() -> None:
    triangles = wall()
    outside, inside = np.array([-30.0, 0.0, 4.0]), np.array([5.0, 0.0, 4.0])
    assert repair_route(triangles, np.stack([outside, inside]), LOWER, UPPER, 1).refused == {0: "outside"}
    over = np.array([[-30.0, 0.0, 15.0], [5.0, 0.0, 15.0]])
    assert repair_route(triangles, over, LOWER, UPPER, 1).refused == {}


def test_a_route_of_one_view_or_none_needs_no_repair() -> None:
    assert len(repair_route(wall(), np.zeros((0, 3)), LOWER, UPPER, 1).points_enu_m) == 0
    assert list(repair_route(wall(), np.ones((1, 3)), LOWER, UPPER, 1).view) == [0]
