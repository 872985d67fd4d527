"""What views show of a map that is partly imagined, and the search several steps ahead."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.camera import Camera, Pose
from missions.pose_lattice import PoseLattice
from planning.nbv.horizon import HorizonSpec, best_way, promises
from planning.nbv.shown import AGAIN, ShownFaces
from planning.nbv.sight_kernels import ALIKE, _stopping
from planning.nbv.sights import ImaginedMap, Orientations, Sights, sights

CAMERA = Camera(64, 48, 40.0, 40.0, 32.0, 24.0)
LATTICE = PoseLattice((0.0, 0.0, 0.0), (12.0, 12.0, 4.0), (3, 3, 1), (0.0,), 4)
RANGE_M = 10.0


def imagined(occupancy: float = 1.0, seed: int | None = None) -> ImaginedMap:
    """Half-metre voxels over the lattice; a wall at x = 8 m, or where a seed says."""
    shape = (26, 26, 10)
    occupied = np.zeros(shape, np.float32)
    if seed is None:
        occupied[18, :, :] = occupancy
    else:
        rng = np.random.default_rng(seed)
        some = rng.random(shape) < 0.1
        occupied[some] = rng.random(int(some.sum()))
    return ImaginedMap.new(np.array([-0.5, -0.5, -0.5]), 0.5, occupied, (slice(None),) * 3)


def seen(world: ImaginedMap) -> Sights:
    yaw, elevation = LATTICE.yaw_elevation_rad.T
    return sights(world, LATTICE.positions_enu_m, Orientations.of(yaw, elevation, CAMERA), RANGE_M)


def test_a_wall_is_worth_its_area_in_the_picture_aslant_or_not() -> None:
    gain = seen(imagined()).gains_m2
    here = LATTICE.flat((1, 1, 0, 0, 0))
    depth = 8.5 - 6.0
    height = min(48 / 40.0 * depth, 5.0)
    width = 64 / 40.0 * depth
    assert gain.ravel()[here] == pytest.approx(width * height, rel=0.05)
    assert gain.ravel()[LATTICE.flat((1, 1, 0, 0, 2))] == 0.0


def test_what_is_certain_is_shown_once_and_what_may_not_be_there_half() -> None:
    for chance in (1.0, 0.5):
        s = seen(imagined(chance))
        view = 4, 0
        once = s.left_after(*view, s.nothing_shown)
        assert s.gains_after(once)[view] <= (1.0 - chance) * 0.2 * s.gains_m2[view] + 1e-6
        certain = float(seen(imagined()).gains_m2[view])
        assert chance * certain - 1e-3 <= s.gains_m2[view] <= 1.2 * certain


def test_no_view_is_worth_more_than_the_faces_that_are_there() -> None:
    world = imagined(0.0)
    for voxel in ((21, 13, 5), (13, 13, 9), (4, 20, 1)):
        world.occupancy[voxel] = 1.0
    alone = ImaginedMap.new(world.origin_enu_m, world.voxel_m, world.occupancy, world.box)
    gains = seen(alone).gains_m2
    assert gains.max() > 0.0
    assert gains.max() <= 3 * 3 * 0.25 + 1e-6


@given(st.floats(0.01, 0.99), st.integers(1, 40))
def test_unknown_space_is_free_or_solid_in_pieces(chance: float, voxels: int) -> None:
    through, passed = 1.0, 0.0
    for n in range(voxels):
        stops, passed = _stopping(chance, passed, ALIKE)
        assert n > 0 or stops == pytest.approx(chance)
        through *= 1.0 - stops
    assert (1.0 - chance)**voxels - 1e-9 <= through <= 1.0 - chance + 1e-9
    assert _stopping(1.0, passed, ALIKE)[0] == 1.0
    independent = [_stopping(chance, level, 0.0)[0] for level in (0.0, 0.5 * chance, chance)]
    assert independent == pytest.approx([chance] * 3)


def test_a_wall_seen_from_one_side_is_new_from_the_other() -> None:
    world, middle = imagined(), (slice(17, 20), slice(8, 18), slice(2, 8))
    before = world.unseen[middle].copy()
    world.show(Pose((5.0, 6.0, 2.0), 0.0, 0.0), CAMERA, RANGE_M)
    shown_faces = before & ~world.unseen[middle]
    assert set(np.unique(shown_faces)) <= {0, 1}
    assert (shown_faces[1] == 1).mean() > 0.9
    yaw, elevation = LATTICE.yaw_elevation_rad.T
    views = Orientations.of(yaw, elevation, CAMERA)
    places = np.array([[5.0, 6.0, 2.0], [12.0, 6.0, 2.0]])
    left, right = sights(world, places, views, RANGE_M).gains_m2[[0, 1], [0, 2]]
    fresh = sights(imagined(), places, views, RANGE_M).gains_m2[[0, 1], [0, 2]]
    assert left < 0.25 * fresh[0]
    assert right == pytest.approx(fresh[1])


def test_pictures_have_shown_what_the_map_says_by_now_once_each_was_looked_up_again() -> None:
    shown, poses = ShownFaces(CAMERA, RANGE_M), [LATTICE.pose(LATTICE.index(k)) for k in range(0, len(LATTICE), 2)]
    for pose in poses:
        shown.add(pose)
    shown.take_out(imagined(seed=1))
    for _ in range(math.ceil(len(poses) / AGAIN)):
        world = imagined(seed=2)
        shown.take_out(world)
    expected = imagined(seed=2)
    for pose in poses:
        expected.show(pose, CAMERA, RANGE_M)
    np.testing.assert_array_equal(world.unseen, expected.unseen)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_views_never_add_more_after_others(seed: int) -> None:
    s = seen(imagined(seed=seed))
    rng = np.random.default_rng(seed)
    left = s.nothing_shown
    before = s.gains_after(left)
    for _ in range(4):
        left = s.left_after(int(rng.integers(9)), int(rng.integers(4)), left)
        after = s.gains_after(left)
        assert (after <= before + 1e-6).all()
        assert (left >= 0.0).all()
        before = after


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10**6))
def test_a_wide_search_finds_the_best_of_all_ways(seed: int) -> None:
    s = seen(imagined(seed=seed))
    steps = LATTICE.steps
    passable = np.ones(steps.shape)
    spec = HorizonSpec(depth=2, width=40, finals=40, discount=0.9)
    start = LATTICE.flat((1, 1, 0, 0, 0))
    nothing = np.zeros(len(LATTICE))
    way = best_way(s, s.nothing_shown, steps, passable, start, steps[start][steps[start] >= 0].tolist(), nothing, spec)
    assert way is not None
    assert way.value >= max(_worth(s, ways, spec, steps, passable) for ways in _ways(start, steps)) - 1e-6


def _ways(start: int, steps: np.ndarray) -> list[tuple[int, int]]:
    """One of the ways to each second pose: the search keeps one for each end."""
    ends: dict[int, tuple[int, int]] = {}
    for a in steps[start][steps[start] >= 0]:
        for b in steps[a][steps[a] >= 0]:
            ends[int(b)] = int(a), int(b)
    return list(ends.values())


def _worth(s: Sights, way: tuple[int, int], spec: HorizonSpec, steps: np.ndarray, passable: np.ndarray) -> float:
    left, total = s.nothing_shown, 0.0
    for k, pose in enumerate(way):
        view = divmod(pose, LATTICE.orientations)
        total += spec.discount**k * float(s.gains_after(left)[view])
        left = s.left_after(*view, left)
    return total + spec.discount ** len(way) * float(promises(s.gains_after(left), steps, passable, spec)[way[-1]])


def test_a_vehicle_with_nothing_to_see_heads_for_what_is_far() -> None:
    s = seen(imagined())
    steps, pose = LATTICE.steps, LATTICE.flat((0, 0, 0, 0, 2))
    passable, spec = np.ones(steps.shape), HorizonSpec(depth=1, width=30)
    promised = promises(s.gains_m2, steps, passable, spec)
    flown = [pose]
    while s.gains_m2.ravel()[flown[-1]] == 0.0 and len(flown) < 5:
        first = steps[flown[-1]][steps[flown[-1]] >= 0].tolist()
        way = best_way(s, s.nothing_shown, steps, passable, flown[-1], first, promised, spec)
        assert way is not None
        flown.append(way.poses[0])
    assert len(flown) <= 4


def test_no_way_leads_where_a_step_is_blocked() -> None:
    s = seen(imagined())
    steps, start = LATTICE.steps, LATTICE.flat((0, 1, 0, 0, 0))
    passable = np.ones(steps.shape)
    blocked = {LATTICE.flat((1, y, 0, 0, a)) for y, a in itertools.product(range(3), range(4))}
    passable[np.isin(steps, list(blocked))] = 0.0
    spec = HorizonSpec(depth=4, width=8)
    promised = promises(s.gains_m2, steps, passable, spec)
    first = [int(f) for f in steps[start] if f >= 0 and int(f) not in blocked]
    way = best_way(s, s.nothing_shown, steps, passable, start, first, promised, spec)
    assert way is not None
    assert not blocked & set(way.poses)
    assert best_way(s, s.nothing_shown, steps, passable, start, [], promised, spec) is None
    assert math.isfinite(way.value)
