"""Lattice, rays, gain and joint search."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.grid import FREE, OCCUPIED, UNKNOWN, SurfaceVoxels, VoxelGrid
from missions.lattice import MOST_POSITIONS, lattice_positions, view_positions
from missions.mission import ExploreSpec
from missions.sensors import fibonacci_directions
from planning.nbv.gain import (
    INSIDE,
    GainField,
    GainSpec,
    count_looks,
    gain_field,
    lattice_gains,
    visible_voxels,
    with_claims,
)
from planning.nbv.lattice import Lattice, build_lattice, in_view
from planning.nbv.rays import segment_blocked
from planning.nbv.search import SearchSpec, VehicleQuery, next_views

CAMERA = Camera.from_diagonal_fov(114, 64, 84.0)
NOTHING = SurfaceVoxels(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.int64))
LOWER, UPPER = np.array([-20.0, -20.0, 0.0]), np.array([20.0, 20.0, 16.0])


def wall_field(distance_m: float, half_width_m: float = 2.0, spec: GainSpec | None = None) -> GainField:
    """Free space, with known wall whose nearest layer of voxels, in a square, is unknown: pure frontier."""
    grid = VoxelGrid.unknown(LOWER, UPPER, 0.5)
    grid.state[:] = FREE
    x, y, z = np.moveaxis(grid.centers(np.stack(np.indices(grid.state.shape), axis=-1)), -1, 0)
    square = (abs(y) < half_width_m) & (abs(z - 8) < half_width_m)
    grid.state[square & (x > distance_m + 0.5)] = OCCUPIED
    grid.state[square & (x > distance_m) & (x < distance_m + 0.5)] = UNKNOWN
    return gain_field(grid, NOTHING, LOWER, UPPER, spec or GainSpec())


def looking_east(x: float = 0.0) -> Lattice:
    return Lattice(np.array([[x, 0.0, 8.0]]), np.array([0.0]), np.array([0.0]))


def house_field(looks: NDArray[np.uint8] | None = None) -> GainField:
    grid = VoxelGrid.unknown(LOWER, UPPER, 0.5)
    grid.state[:, :, 0] = OCCUPIED
    grid.state[:30, :, 1:] = FREE
    grid.state[30:34, 30:40, 1:12] = OCCUPIED
    return gain_field(grid, NOTHING, np.array([-6.0, -6.0, 0.5]), np.array([6.0, 6.0, 10.0]), GainSpec(), looks)


def house_lattice() -> Lattice:
    return build_lattice(np.array([-18.0, -18.0, 2.0]), np.array([18.0, 18.0, 14.0]), ExploreSpec(lattice_step_m=6.0))


def straight(lattice: Lattice, position: tuple[float, float, float], vehicle_id: int = 0) -> VehicleQuery:
    here = np.array(position)
    return VehicleQuery(vehicle_id, here, np.linalg.norm(lattice.positions_enu_m - here, axis=1))


def test_lattice_is_made_of_cell_centres() -> None:
    positions = lattice_positions(np.array([0.0, 0.0, 2.0]), np.array([10.0, 1.0, 8.0]), 4.0)
    assert np.allclose(np.unique(positions[:, 0]), [2.5, 7.5])
    assert np.allclose(np.unique(positions[:, 1]), [0.5])
    assert np.allclose(np.unique(positions[:, 2]), [3.5, 6.5])


@given(st.floats(3.0, 300.0), st.floats(3.0, 300.0), st.floats(3.0, 200.0), st.floats(0.5, 12.0))
@settings(deadline=None)
def test_lattice_of_views_keeps_the_step_until_there_are_too_many(x: float, y: float, z: float, step: float) -> None:
    lower, upper = np.zeros(3), np.array([x, y, z])
    positions = view_positions(lower, upper, ExploreSpec(lattice_step_m=step))
    asked = lattice_positions(lower, upper, step) if x * y * z < 1e5 * step**3 else None
    assert 0 < len(positions) <= MOST_POSITIONS
    if asked is not None and len(asked) <= MOST_POSITIONS:
        assert np.array_equal(positions, asked)
    else:
        assert len(positions) > MOST_POSITIONS / 3


def test_lattice_has_every_elevation_with_every_azimuth() -> None:
    lattice = build_lattice(LOWER, UPPER, ExploreSpec())
    degrees = np.round(np.degrees([lattice.elevation_rad, lattice.yaw_enu_rad]))
    pairs = set(zip(*degrees, strict=True))
    assert pairs == {(e, a) for e in (-60, -30, 0, 30, 60) for a in (-180, -144, -108, -72, -36, 0, 36, 72, 108, 144)}


@given(st.floats(-math.pi, math.pi), st.floats(-1.2, 1.2))
@settings(deadline=None)
def test_in_view_agrees_with_projection(yaw: float, elevation: float) -> None:
    directions = fibonacci_directions(200)
    in_camera = directions @ Pose((0.0, 0.0, 0.0), yaw, elevation).enu_from_camera
    half_h, half_v = CAMERA.half_fov_rad
    expected = (in_camera[:, 2] > 0) & (abs(np.arctan2(in_camera[:, 0], in_camera[:, 2])) < half_h) & (
        abs(np.arctan2(in_camera[:, 1], in_camera[:, 2])) < half_v)
    assert np.array_equal(in_view(directions, np.array([yaw]), np.array([elevation]), CAMERA)[:, 0], expected)


points = st.tuples(*[st.floats(0.01, 7.99)] * 3).map(np.array)


@given(st.integers(0, 2**32 - 1), points, points)
@settings(max_examples=100, deadline=None)
def test_segment_blocked_agrees_with_dense_samples(seed: int, start: NDArray[np.float64],
                                                   end: NDArray[np.float64]) -> None:
    state = (np.random.default_rng(seed).random((8, 8, 8)) < 0.95).astype(np.uint8)
    samples = np.floor(start + np.linspace(0.0, 1.0, 5000)[:, None] * (end - start)).astype(int)
    blocked = bool((state[tuple(samples.T)] != 1).any())
    if blocked != segment_blocked(state, 1, start, end, 0.0):
        chords = [chord_m(start, end, cell) for cell in np.argwhere(state != 1)]
        assert any(-1e-9 <= chord < 5e-3 for chord in chords), "they may differ over a grazed corner only"


def chord_m(start: NDArray[np.float64], end: NDArray[np.float64], cell: NDArray[np.int64]) -> float:
    """Length of the segment within a voxel; negative when it misses."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.sort((np.stack([cell, cell + 1]) - start) / (end - start), axis=0)
    t = np.clip([np.nanmax(bounds[0]), np.nanmin(bounds[1])], 0.0, 1.0)
    return float((t[1] - t[0]) * np.linalg.norm(end - start))


@pytest.mark.parametrize("distance_m", [4.0, 6.0, 9.0, 11.0])
def test_gain_is_area_whatever_the_distance(distance_m: float) -> None:
    spec = GainSpec(frontier_chance=1.0)
    gain = lattice_gains(wall_field(distance_m, spec=spec), looking_east(), CAMERA, rays=20000)[0, 0]
    assert gain == pytest.approx(16.0, rel=0.2)


def test_gain_falls_with_the_square_beyond_full_resolution() -> None:
    spec = GainSpec(frontier_chance=1.0, full_value_m=5.0)
    near, far = (lattice_gains(wall_field(d, 1.0, spec), looking_east(), CAMERA, rays=60000)[0, 0] for d in (7.0, 14.0))
    assert near / far == pytest.approx((14.25 / 7.25) ** 2, rel=0.15)


def test_nothing_is_gained_outside_the_box_or_behind_the_camera() -> None:
    area = wall_field(6.0)
    away = Lattice(np.array([[0.0, 0.0, 8.0]]), np.array([math.pi]), np.array([0.0]))
    assert lattice_gains(area, away, CAMERA)[0, 0] == 0.0
    small = gain_field(area.grid, NOTHING, np.array([-9.0, -9.0, 0.0]), np.array([0.0, 9.0, 16.0]), GainSpec())
    assert lattice_gains(small, looking_east(), CAMERA)[0, 0] == 0.0


def test_opening_the_way_is_worth_a_little_where_cameras_may_stand() -> None:
    grid = VoxelGrid.unknown(LOWER, UPPER, 0.5)
    grid.state[:60] = FREE
    box, cameras = (np.array([14.0, 14.0, 0.0]), np.array([19.0, 19.0, 8.0])), (LOWER, UPPER - 2.0)
    closed = gain_field(grid, NOTHING, *box, GainSpec())
    opened = gain_field(grid, NOTHING, *box, GainSpec(), camera_bounds_enu_m=cameras)
    worthless = gain_field(grid, NOTHING, *box, GainSpec(passage_value=0.0), camera_bounds_enu_m=cameras)
    before, after, none = (lattice_gains(a, looking_east(), CAMERA)[0, 0] for a in (closed, opened, worthless))
    assert none == pytest.approx(before, rel=0.05)
    assert before < after < before + 5.0


def test_gain_needs_a_line_of_sight() -> None:
    area = wall_field(10.0)
    area.grid.state[50, :, :] = OCCUPIED
    hidden = gain_field(area.grid, SurfaceVoxels(*seen_often(area.grid)), LOWER, UPPER, GainSpec())
    assert lattice_gains(hidden, looking_east(), CAMERA)[0, 0] == 0.0


def seen_often(grid: VoxelGrid) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    index = np.argwhere(grid.state == OCCUPIED)
    return grid.centers(index), np.zeros((len(index), 3)), np.full(len(index), 3)


def test_surface_seen_less_often_is_worth_more() -> None:
    gains = []
    for pictures in (1, 2, 3):
        grid = wall_field(6.0).grid
        grid.state[grid.state == UNKNOWN] = OCCUPIED
        centers, normals, count = seen_often(grid)
        seen = SurfaceVoxels(centers, normals, np.minimum(count, pictures))
        gains.append(lattice_gains(gain_field(grid, seen, LOWER, UPPER, GainSpec()), looking_east(), CAMERA)[0, 0])
    assert gains[0] > gains[1] > gains[2] == 0.0


def test_a_claimed_view_is_worth_nothing_to_anybody_else() -> None:
    area = wall_field(6.0, spec=GainSpec(frontier_chance=1.0))
    pose = looking_east().pose(0, 0)
    assert lattice_gains(with_claims(area, [pose], CAMERA), looking_east(1.0), CAMERA)[0, 0] == 0.0
    assert lattice_gains(area, looking_east(1.0), CAMERA)[0, 0] > 5.0


def test_a_look_that_settled_nothing_halves_the_gain() -> None:
    area = wall_field(6.0, spec=GainSpec(frontier_chance=1.0))
    looks = count_looks(area, np.zeros(area.label.shape, dtype=np.uint8), looking_east().pose(0, 0), CAMERA)
    again = gain_field(area.grid, NOTHING, LOWER, UPPER, area.spec, looks)
    before, after = (lattice_gains(a, looking_east(), CAMERA)[0, 0] for a in (area, again))
    assert after == pytest.approx(0.5 * before, rel=1e-6)


@given(st.floats(-math.pi, math.pi), st.floats(-1.0, 1.0), st.floats(-15.0, -6.0))
@settings(max_examples=20, deadline=None)
def test_claims_never_raise_a_gain(yaw: float, elevation: float, x: float) -> None:
    area, lattice = house_field(), house_lattice()
    claimed = with_claims(area, [Pose((x, 1.0, 5.0), yaw, elevation)], CAMERA)
    before, after = (lattice_gains(a, lattice, CAMERA, rays=300) for a in (area, claimed))
    assert (after <= before + 1e-9).all()


def test_visible_voxels_stop_at_the_wall() -> None:
    area = wall_field(6.0, half_width_m=20.0, spec=GainSpec(frontier_chance=1.0))
    seen = visible_voxels(area, looking_east().pose(0, 0), CAMERA)
    x = area.grid.centers(np.argwhere(seen))[:, 0]
    assert 6.0 < x.max() < 7.0


def test_gains_do_not_depend_on_threads() -> None:
    area, lattice = house_field(), house_lattice()
    threads = numba.get_num_threads()
    many = lattice_gains(area, lattice, CAMERA)
    numba.set_num_threads(1)
    one = lattice_gains(area, lattice, CAMERA)
    numba.set_num_threads(threads)
    assert np.array_equal(one, many)


@given(st.integers(1, 6), st.integers(0, 5))
@settings(max_examples=12, deadline=None)
def test_goals_keep_apart_and_lie_within_range(vehicles: int, seed: int) -> None:
    area, lattice, spec = house_field(), house_lattice(), SearchSpec(separation_m=7.0)
    rng = np.random.default_rng(seed)
    busy = [Pose((-9.0, 9.0, 5.0), 0.0, 0.0)]
    asking = []
    for v in range(vehicles):
        position = np.array([-15.0, -12.0 + 5.0 * v, 4.0])
        way = np.linalg.norm(lattice.positions_enu_m - position, axis=1)
        way[rng.random(len(way)) < 0.3] = np.inf
        asking.append(VehicleQuery(v, position, way, affordable=2.0 * way <= 50.0))
    given_views = next_views(area, lattice, CAMERA, asking, busy, spec).assignments
    goals = np.array([a.pose.position_enu_m for a in given_views] + [busy[0].position_enu_m])
    apart = np.linalg.norm(goals[:, None] - goals[None], axis=-1)[~np.eye(len(goals), dtype=bool)]
    assert (apart >= 7.0).all()
    assert len({a.vehicle_id for a in given_views}) == len(given_views)
    assert all(2.0 * asking[a.vehicle_id].distance_m[a.position_index] <= 50.0 for a in given_views)


def test_two_vehicles_share_the_work() -> None:
    area, lattice = house_field(), house_lattice()
    asking = [straight(lattice, (-15.0, y, 5.0), i) for i, y in enumerate((-9.0, 9.0))]
    decision = next_views(area, lattice, CAMERA, asking, [], SearchSpec())
    first, second = (visible_voxels(area, a.pose, CAMERA) & (area.label == INSIDE) for a in decision.assignments)
    assert (first & second).sum() < 0.5 * min(first.sum(), second.sum())


def test_the_first_view_is_the_best_by_plain_search() -> None:
    area, lattice, spec = house_field(), house_lattice(), SearchSpec()
    asking = straight(lattice, (-15.0, 0.0, 5.0))
    chosen = next_views(area, lattice, CAMERA, [asking], [], spec).assignments[0]
    gains = lattice_gains(area, lattice, CAMERA)
    utility = gains * np.exp(-spec.decay_per_m * asking.distance_m)[:, None]
    assert utility[chosen.position_index, chosen.orientation_index] == utility.max()
    assert chosen.gain_m2 == gains[chosen.position_index, chosen.orientation_index]


def test_no_view_below_the_stop_gain() -> None:
    area, lattice = house_field(), house_lattice()
    asking = [straight(lattice, (-15.0, 0.0, 5.0))]
    best = next_views(area, lattice, CAMERA, asking, [], SearchSpec()).best_gain_m2
    assert next_views(area, lattice, CAMERA, asking, [], SearchSpec(stop_gain=0.5), None, 2.1 * best).assignments == []
    assert next_views(area, lattice, CAMERA, asking, [], SearchSpec(stop_gain=0.5), None, 1.9 * best).assignments != []


def test_taken_views_are_not_given_again() -> None:
    area, lattice = house_field(), house_lattice()
    asking = [straight(lattice, (-15.0, 0.0, 5.0))]
    taken = np.zeros((len(lattice.positions_enu_m), len(lattice.yaw_enu_rad)), dtype=np.bool_)
    first = next_views(area, lattice, CAMERA, asking, [], SearchSpec(), taken).assignments[0]
    taken[first.position_index, first.orientation_index] = True
    second = next_views(area, lattice, CAMERA, asking, [], SearchSpec(), taken).assignments[0]
    assert (first.position_index, first.orientation_index) != (second.position_index, second.orientation_index)
