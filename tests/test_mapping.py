"""The voxel map: unknown is not free, walls stay, ghosts go, order does not matter."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.camera import Pose
from missions.grid import FREE, OCCUPIED, UNKNOWN
from perception.depth.depth_map import DepthMap
from perception.mapping import carving
from perception.mapping.explorer_map import ExplorerMap
from perception.mapping.voxel_map import VoxelMap
from tests.depth_scene import CAMERA, exact_depth_map, halved, wall_picture

NORTH = math.pi / 2
LOWER, UPPER = np.array([-10.0, -12.0, 0.0]), np.array([10.0, 5.0, 12.0])


def _wall_maps(places: list[tuple[float, float, float]], yaw: float = NORTH) -> list[DepthMap]:
    poses = [Pose(p, yaw, 0.0) for p in places]
    return [exact_depth_map(p, halved(wall_picture(p, wall_north_m=0.2)[1])) for p in poses]


def _row(count: int = 8) -> list[DepthMap]:
    return _wall_maps([(x, -8.0, 5.0) for x in np.linspace(-3.0, 3.0, count)])


def _mapped(maps: list[DepthMap]) -> VoxelMap:
    voxels = VoxelMap(LOWER, UPPER, 0.5)
    for depth in maps:
        voxels.integrate(depth)
    return voxels


def test_wall_is_occupied_and_nothing_behind_it_is_free() -> None:
    grid = _mapped(_row()).grid()
    north = grid.centers(np.argwhere(grid.state == FREE))[:, 1]
    assert north.max() < 0.0
    wall = np.array([[x, 0.2, z] for x in np.arange(-4.0, 4.0, 0.3) for z in np.arange(2.5, 7.5, 0.3)])
    assert (grid.state_at(wall) == OCCUPIED).all()
    assert (grid.state_at(wall + np.array([0.0, 1.0, 0.0])) == UNKNOWN).all()
    assert (grid.state_at(wall * np.array([0.5, 0.0, 0.2]) + np.array([0.0, -3.0, 4.0])) == FREE).all()


def test_empty_map_knows_nothing() -> None:
    voxels = VoxelMap(LOWER, UPPER, 0.5)
    assert (voxels.grid().state == UNKNOWN).all()
    assert len(voxels.surface().position_enu_m) == 0


@settings(max_examples=8, deadline=None)
@given(st.permutations(list(range(6))))
def test_order_does_not_matter(order: list[int]) -> None:
    maps = _row(6)
    first, second = _mapped(maps), _mapped([maps[i] for i in order])
    assert np.array_equal(first.grid().state, second.grid().state)
    assert np.array_equal(first.surface().position_enu_m, second.surface().position_enu_m)


def test_the_part_that_evidence_concerns_is_the_whole_map() -> None:
    voxels = _mapped([])
    for depth in _row(3):
        voxels.integrate(depth)
        assert np.array_equal(voxels.grid().state, voxels._state((slice(None),) * 3))
    voxels.mark_free(np.array([-9.0, -9.0, 0.0]), np.array([-8.0, -8.0, 3.0]))
    assert np.array_equal(voxels.grid().state, voxels._state((slice(None),) * 3))
    assert voxels.grid() is voxels.grid()


def test_taking_a_depth_map_out_restores_the_map() -> None:
    maps = _row(4)
    voxels, before = _mapped(maps), _mapped(maps[:-1])
    voxels.integrate(maps[-1], sign=-1)
    for name in ("free_pictures", "hit_pictures", "touched_pictures", "hit_pixels"):
        assert np.array_equal(getattr(voxels, name), getattr(before, name))
    assert np.array_equal(voxels.surface().position_enu_m, before.surface().position_enu_m)
    assert np.array_equal(voxels.grid().state, before.grid().state)


def test_cable_measured_now_and_then_survives_the_rays_beside_it() -> None:
    """A 5 cm upright cable 4 m before the wall, hit by one picture in three and never by the others."""
    maps = _row(12)
    for i in range(0, 12, 3):
        depth = maps[i].depth_m.copy()
        x = CAMERA.scaled(228, 128).fx_px * (0.1 - maps[i].pose.position_enu_m[0]) / 4.2 + 114.0
        depth[:, int(x)] = 4.2
        maps[i] = replace(maps[i], depth_m=depth)
    grid = _mapped(maps).grid()
    cable = np.array([[0.1, -3.8, z] for z in np.arange(4.0, 6.0, 0.25)])
    assert (grid.state_at(cable) == OCCUPIED).all()


def test_ghost_seen_once_is_erased_by_many_free_rays() -> None:
    maps = _row(16)
    depth = maps[8].depth_m.copy()
    depth[60:68, 110:118] = 4.0
    spot = np.array(maps[8].pose.position_enu_m) + np.array([0.0, 4.1, 0.0])
    wrong = replace(maps[8], depth_m=np.where(depth == 4.0, np.float32(4.1), depth))
    assert _mapped([wrong]).grid().state_at(spot) != FREE
    assert _mapped([*maps[:8], wrong, *maps[9:]]).grid().state_at(spot) == FREE


def test_depth_noise_widens_the_margin_before_the_surface() -> None:
    sharp, blurred = (_mapped([replace(d, sigma_per_depth2=s) for d in _row()]).grid() for s in (1e-4, 0.01))
    furthest = [g.centers(np.argwhere(g.state == FREE))[:, 1].max() for g in (sharp, blurred)]
    assert furthest[1] < furthest[0] - 0.5


def test_sky_carves_only_its_limited_range() -> None:
    pose = Pose((0.0, -40.0, 5.0), NORTH, 0.0)
    shape = (128, 228)
    sky = DepthMap(CAMERA.scaled(228, 128), pose, np.ones(shape, np.float32), np.zeros(shape, bool),
                   np.zeros(shape, np.float32), np.ones(shape, bool), 1e-3)
    voxels = VoxelMap(np.array([-10.0, -40.0, 0.0]), np.array([10.0, 5.0, 12.0]), 0.5)
    for _ in range(3):
        voxels.integrate(sky)
    grid = voxels.grid()
    far = grid.centers(np.argwhere(grid.state == FREE))[:, 1].max()
    assert -20.6 - 0.5 < far < -19.7
    assert not (grid.state == OCCUPIED).any()


def test_surface_normals_face_the_cameras() -> None:
    surface = _mapped(_row()).surface()
    inner = (np.abs(surface.position_enu_m[:, 0]) < 4) & (np.abs(surface.position_enu_m[:, 2] - 5) < 2)
    assert np.allclose(surface.position_enu_m[inner, 1], 0.2, atol=0.01)
    assert (surface.normal_enu[inner] @ [0.0, -1.0, 0.0] > 0.99).all()
    assert np.allclose(np.linalg.norm(surface.normal_enu, axis=1), 1.0)
    assert surface.seen_count.min() >= 2


def test_declared_free_space_stays_inside_the_grid() -> None:
    voxels = VoxelMap(LOWER, UPPER, 0.5)
    voxels.mark_free(np.array([-11.0, -12.5, -1.0]), np.array([-9.3, -11.3, 3.2]))
    state = voxels.grid().state
    assert (state == FREE).sum() == 2 * 2 * 7
    voxels.mark_free(np.array([50.0, 50.0, 50.0]), np.array([51.0, 51.0, 51.0]))
    assert np.array_equal(voxels.grid().state, state)


unit = st.floats(-1.0, 1.0)


@settings(max_examples=50, deadline=None)
@given(st.tuples(*[st.floats(-5.0, 15.0)] * 3), st.tuples(unit, unit, unit), st.floats(0.1, 30.0))
def test_a_ray_touches_exactly_the_voxels_it_passes_through(start: tuple[float, float, float],
                                                            towards: tuple[float, float, float], reach: float) -> None:
    length = math.sqrt(sum(c * c for c in towards))
    if length < 0.1:
        return
    direction = np.array(towards) / length
    swept, touched = np.zeros((10, 9, 8), np.int32), np.zeros(720, np.int64)
    count = carving.trace(np.array(start), direction[None], np.array([reach]), np.ones(1), swept, touched)
    reached = {tuple(int(c) for c in i) for i in np.argwhere(swept > 0)}
    assert len(reached) == count == len(set(touched[:count].tolist()))
    at = np.array(start) + np.linspace(0.0, reach, 1000)[:, None] * direction
    clear = np.all(np.abs(at - np.round(at)) > 1e-6, axis=1)
    passed = {tuple(int(c) for c in i) for i in np.floor(at[clear]) if np.all(i >= 0) and np.all(i < (10, 9, 8))}
    end = tuple(int(c) for c in np.floor(np.array(start) + reach * direction))
    assert passed - {end} <= reached
    centre = np.array(sorted(reached)).reshape(-1, 3) + 0.5 - np.array(start)
    off_axis = np.linalg.norm(centre - (centre @ direction)[:, None] * direction, axis=1)
    assert (off_axis <= math.sqrt(3) / 2 + 1e-6).all()


def _explored(workers: int) -> ExplorerMap:
    explorer = ExplorerMap(LOWER, UPPER, 0.5, 0.3, workers=workers)
    for i, up in enumerate((2.0, 4.0, 6.0, 8.0)):
        pose = Pose((0.0, -10.0, up), NORTH, 0.0)
        explorer.add_picture(wall_picture(pose, 0.2, noise_seed=i)[0], CAMERA, pose)
    return explorer


def test_take_off_column_makes_the_first_map() -> None:
    explorer = _explored(2)
    assert explorer.update() == [0, 1, 2, 3]
    assert explorer.update() == []
    grid = explorer.grid()
    free, wall = (grid.centers(np.argwhere(grid.state == s)) for s in (FREE, OCCUPIED))
    assert free[:, 1].max() < 0.0
    assert len(wall) > 300
    assert (np.abs(wall[:, 1] - 0.2) < 0.6).mean() > 0.98
    assert grid.state_at(np.array([0.0, -10.0, 6.0])) == FREE


def test_number_of_workers_does_not_change_the_map() -> None:
    one, three = _explored(1), _explored(3)
    assert one.update() == three.update()
    assert np.array_equal(one.grid().state, three.grid().state)
    assert np.array_equal(one.surface().position_enu_m, three.surface().position_enu_m)


def test_one_picture_or_a_turn_on_the_spot_maps_nothing() -> None:
    explorer = ExplorerMap(LOWER, UPPER, 0.5, 0.3, workers=1)
    for yaw in (NORTH - 0.2, NORTH, NORTH + 0.2):
        pose = Pose((0.0, -8.0, 5.0), yaw, 0.0)
        explorer.add_picture(wall_picture(pose)[0], CAMERA, pose)
    assert explorer.update() == []
    assert not (explorer.grid().state == OCCUPIED).any()
    assert explorer.depth(0) is None


def test_free_space_around_a_flown_way_stays_free_until_it_is_solid() -> None:
    maps = _row(4)
    voxels, a, b = _mapped(maps), np.array([-1.0, -4.0, 5.0]), np.array([1.0, -4.0, 5.0])
    known = voxels.grid()
    voxels.hold_free(known, a, b, 1.5)
    for depth in maps:
        voxels.integrate(depth, sign=-1)
    held = voxels.grid()
    centers = held.centers(np.argwhere(np.ones(held.state.shape, bool))).reshape(*held.state.shape, 3)
    away = np.linalg.norm(centers - np.clip(centers, a, b), axis=-1)
    assert np.array_equal(held.state == FREE, (known.state == FREE) & (away <= 1.5))
    for depth in _wall_maps([(x, -9.0, 5.0) for x in np.linspace(-2.0, 2.0, 5)]):
        voxels.integrate(replace(depth, depth_m=np.full_like(depth.depth_m, 5.0)))
    assert (voxels.grid().state_at(np.array([[0.0, -4.0, 5.0], [0.5, -4.0, 5.2]])) == OCCUPIED).all()
