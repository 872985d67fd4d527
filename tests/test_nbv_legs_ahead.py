"""The search over several views of free legs: what plans are worth, who gets what, and looks that open the way."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from missions.grid import VoxelGrid
from missions.mission import ExploreSpec
from planning.nbv.lattice import Lattice, build_lattice
from planning.nbv.legs_ahead import Asker, Plan, plan_views
from planning.nbv.outlook import AheadSpec
from planning.nbv.sights import ImaginedMap, Orientations, sights
from planning.trajectories import Limits

CAMERA = Camera.from_diagonal_fov(57, 32, 84.0)
LOWER, UPPER = np.array([-16.0, -16.0, 0.0]), np.array([16.0, 16.0, 12.0])
SPEC = AheadSpec(Limits(3.0, 2.0, 6.0, 1.0), separation_m=5.0, coarse_rays=128, rays=512)
RANGE_M = 14.0
seeds = st.integers(0, 2**32 - 1)


def world(seed: int | None = None) -> ImaginedMap:
    """A house in free air, its walls known and its roof imagined; a seed adds imagined clutter."""
    grid = VoxelGrid.unknown(LOWER, UPPER, 0.5)
    x, y, z = np.moveaxis(grid.centers(np.stack(np.indices(grid.state.shape), axis=-1)), -1, 0)
    occupancy = np.where((abs(x) < 4) & (abs(y) < 4) & (z < 6), 1.0, 0.0)
    occupancy[(abs(x) < 4) & (abs(y) < 4) & (z > 6) & (z < 7)] = 0.4
    if seed is not None:
        rng = np.random.default_rng(seed)
        some = rng.random(occupancy.shape) < 0.02
        occupancy[some] = np.maximum(occupancy[some], rng.random(int(some.sum())))
    box = tuple(slice(int(a), int(b)) for a, b in zip(grid.index(LOWER * 0.4), grid.index(UPPER * 0.8), strict=True))
    return ImaginedMap.new(grid.origin_enu_m, 0.5, occupancy.astype(np.float32), box)


@pytest.fixture(scope="module")
def lattice() -> Lattice:
    spec = ExploreSpec(lattice_step_m=5.0, elevations_deg=(-40.0, 0.0), azimuths=6)
    return build_lattice(LOWER + 2.0, UPPER - 1.0, spec)


def free(lattice: Lattice) -> NDArray[np.bool_]:
    x, y, z = abs(lattice.positions_enu_m).T
    return np.asarray((x > 5.5) | (y > 5.5) | (z > 8.0))


def asker(lattice: Lattice, vehicle_id: int, x: float, y: float, share: float = 1.0, seed: int = 0) -> Asker:
    """Straight ways to a share of the free positions, drawn."""
    way = np.linalg.norm(lattice.positions_enu_m - np.array([x, y, 3.0]), axis=1)
    drawn = np.random.default_rng(seed + vehicle_id).random(len(way)) < share
    return Asker(vehicle_id, np.where(free(lattice) & drawn & (way > 1.0), way, np.inf))


def certain(lattice: Lattice) -> Array:
    return np.ones((len(lattice.positions_enu_m), len(lattice.yaw_enu_rad)))


def always(gains_m2: list[float], legs_m: list[float]) -> bool:
    return True


def decide(imagined: ImaginedMap, lattice: Lattice, askers: list[Asker], spec: AheadSpec = SPEC,
           chance: Array | None = None) -> list[Plan]:
    chance = certain(lattice) if chance is None else chance
    return plan_views(imagined, lattice, CAMERA, RANGE_M, askers, chance, spec, always)


@given(seeds)
@settings(max_examples=5, deadline=None)
def test_looking_farther_ahead_never_finds_a_worse_plan(lattice: Lattice, seed: int) -> None:
    here = [asker(lattice, 1, -12.0, -12.0, 0.6, seed)]
    values = [decide(world(seed), lattice, here, dataclasses.replace(SPEC, depth=d))[0].value_m2
              for d in (1, 2, 3)]
    assert values == sorted(values)


@given(seeds)
@settings(max_examples=5, deadline=None)
def test_a_plan_adds_up_what_its_views_show_after_one_another(lattice: Lattice, seed: int) -> None:
    imagined = world(seed)
    [plan] = decide(imagined, lattice, [asker(lattice, 1, -12.0, -12.0)])
    at = lattice.positions_enu_m[[p for p, _ in plan.views]]
    orientations = Orientations.of(lattice.yaw_enu_rad, lattice.elevation_rad, CAMERA, SPEC.rays)
    seen = sights(imagined, at, orientations, RANGE_M)
    left = seen.nothing_shown
    for n, (_, o) in enumerate(plan.views):
        assert plan.gains_m2[n] == pytest.approx(float(seen.gains_after(left)[n, o]), rel=1e-4, abs=1e-6)
        left = seen.left_after(n, o, left)


@given(seeds, st.integers(1, 4), st.floats(0.2, 1.0))
@settings(max_examples=6, deadline=None)
def test_no_view_is_given_that_is_out_of_reach_or_taken_or_beside_anothers_goal(lattice: Lattice, seed: int,
                                                                               vehicles: int, share: float) -> None:
    asking = [asker(lattice, v, -12.0, -12.0 + 6.0 * v, share, seed) for v in range(vehicles)]
    rng = np.random.default_rng(seed)
    chance = np.where(rng.random(certain(lattice).shape) < 0.3, 0.0, 0.5)
    plans = decide(world(seed), lattice, asking, chance=chance)
    goals = []
    for plan in plans:
        p, _ = plan.views[0]
        assert np.isfinite(next(a for a in asking if a.vehicle_id == plan.vehicle_id).way_m[p])
        assert all(chance[view] > 0.0 for view in plan.views)
        goals.append(lattice.positions_enu_m[p])
    assert len({plan.vehicle_id for plan in plans}) == len(plans)
    apart = [np.linalg.norm(a - b) for n, a in enumerate(goals) for b in goals[:n]]
    assert all(d >= SPEC.separation_m for d in apart)


@given(seeds)
@settings(max_examples=5, deadline=None)
def test_what_one_vehicle_will_show_is_nothing_new_to_the_next(lattice: Lattice, seed: int) -> None:
    imagined = world(seed)
    asking = [asker(lattice, 1, -12.0, -12.0), asker(lattice, 2, -12.0, 12.0)]
    plans = decide(imagined, lattice, asking)
    views = [view for plan in plans for view in plan.views]
    orientations = Orientations.of(lattice.yaw_enu_rad, lattice.elevation_rad, CAMERA, SPEC.rays)
    seen = sights(imagined, lattice.positions_enu_m[[p for p, _ in views]], orientations, RANGE_M)
    left, together = seen.nothing_shown, 0.0
    for n, (_, o) in enumerate(views):
        together += float(seen.gains_after(left)[n, o])
        left = seen.left_after(n, o, left)
    promised = sum(sum(plan.gains_m2[: len(plan.views)]) for plan in plans)
    assert promised == pytest.approx(together, rel=1e-4)


def test_only_plans_that_pay_are_given(lattice: Lattice) -> None:
    asked: list[tuple[list[float], list[float]]] = []

    def never(gains_m2: list[float], legs_m: list[float]) -> bool:
        asked.append((gains_m2, legs_m))
        return False

    here = asker(lattice, 1, -12.0, -12.0)
    found = plan_views(world(), lattice, CAMERA, RANGE_M, [here], certain(lattice), SPEC, never)
    assert found == []
    [(gains, legs)] = asked
    assert len(gains) == len(legs) >= 1
    assert legs[0] in here.way_m


def test_nothing_is_given_to_whom_nothing_is_within_reach(lattice: Lattice) -> None:
    nowhere = Asker(1, np.full(len(lattice.positions_enu_m), np.inf))
    assert decide(world(), lattice, [nowhere]) == []
    both = decide(world(), lattice, [nowhere, asker(lattice, 2, 12.0, 12.0)])
    assert [plan.vehicle_id for plan in both] == [2]


def test_where_nothing_is_left_to_see_a_look_opens_the_way(lattice: Lattice) -> None:
    """Only one corner is within reach, and it has shown all that can be seen from there."""
    imagined, position = world(), lattice.positions_enu_m
    corner = (position[:, 0] < -8.0) & (position[:, 1] < -8.0)
    for p in np.flatnonzero(corner):
        for o in range(len(lattice.yaw_enu_rad)):
            imagined.show(lattice.pose(int(p), o), CAMERA, RANGE_M)
    way = np.where(corner, 2.0 + np.linalg.norm(position - np.array([-12.0, -12.0, 3.0]), axis=1), np.inf)
    [plan] = decide(imagined, lattice, [Asker(1, way)], chance=0.5 * certain(lattice))
    assert corner[plan.views[0][0]]
    assert len(plan.opens) > 0
    assert not corner[plan.opens].any()
    assert sum(plan.gains_m2) > 1.0
    unopenable = np.where(corner[:, None], 1.0, 0.0) * certain(lattice)
    left = [sum(p.gains_m2) for p in decide(imagined, lattice, [Asker(1, way)], chance=unopenable)]
    assert all(gain < 0.2 * sum(plan.gains_m2) for gain in left)


def test_plans_do_not_depend_on_threads(lattice: Lattice) -> None:
    asking = [asker(lattice, v, -12.0, -12.0 + 8.0 * v) for v in range(3)]
    threads = numba.get_num_threads()
    many = decide(world(7), lattice, asking)
    numba.set_num_threads(1)
    one = decide(world(7), lattice, asking)
    numba.set_num_threads(threads)
    assert [(p.views, p.gains_m2, p.value_m2) for p in one] == [(p.views, p.gains_m2, p.value_m2) for p in many]
