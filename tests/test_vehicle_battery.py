"""The simulated battery, and the energy that is kept back for the way home."""

from __future__ import annotations

import itertools
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from missions.mission import Mission
from missions.pads import takeoff_points
from planning.allocate.battery import consume
from planning.trajectories import Limits, State, Via, fly_run
from planning.trajectories.energy import DistanceEnergy, energy_of, stops_percent
from tests.vehicle_world import NS, SITE, World, open_map, route
from vehicle.battery import Battery
from vehicle.way_home import WayHome

paths = st.integers(1, 30).flatmap(lambda n: arrays(np.float64, (n, 3), elements=st.floats(-1e3, 1e3)))
places = arrays(np.float64, 3, elements=st.floats(-30.0, 30.0))
LIMITS = Limits(3.0, 2.0, 6.0)


def mission(**sections: object) -> Mission:
    return msgspec.convert({"title": "test", "fleet": {"vehicles": 1}, **sections}, Mission)


@settings(max_examples=30)
@given(st.lists(places, min_size=1, max_size=5), st.floats(0.0, 1.0))
def test_by_distance_the_vehicle_spends_as_the_algorithm_says(stops: list[np.ndarray], rate: float) -> None:
    points = np.array([np.zeros(3), *stops])
    battery = Battery(100.0, DistanceEnergy(rate))
    for a, b in itertools.pairwise(points):
        curve = fly_run(State.at_rest(a), 0.0, 0.0, [Via(b, 0.0)], LIMITS).curve
        for t in np.arange(0.0, curve.duration_s, 0.7):
            battery.spend(curve, float(t), min(float(t) + 0.7, curve.duration_s))
    assert battery.level_percent == pytest.approx(consume(points, 100.0, rate).level_percent[-1], abs=1e-6)


def test_a_battery_is_never_below_empty() -> None:
    curve = fly_run(State.at_rest(np.zeros(3)), 0.0, 0.0, [Via(np.array([30.0, 0.0, 0.0]), 0.0)], LIMITS).curve
    battery = Battery(0.3, energy_of(mission()))
    battery.spend(curve, 0.0, curve.duration_s)
    assert battery.level_percent == 0.0


@settings(max_examples=30)
@given(places, st.lists(st.floats(0.01, 1.0), min_size=1, max_size=30))
def test_what_is_spent_does_not_depend_on_the_ticks(goal: np.ndarray, ticks: list[float]) -> None:
    curve = fly_run(State.at_rest(np.zeros(3)), 0.0, 0.0, [Via(goal, 1.0)], LIMITS).curve
    battery, at_once = Battery(100.0, energy_of(mission())), Battery(100.0, energy_of(mission()))
    for a, b in itertools.pairwise(np.cumsum([0.0, *ticks])):
        battery.spend(curve, float(a), float(b))
    at_once.spend(curve, 0.0, sum(ticks))
    assert 100.0 - battery.level_percent == pytest.approx(100.0 - at_once.level_percent, rel=1e-6)


@given(places, st.sampled_from([(0.0, 0.0, 0.0), (8.0, 3.0, 0.0)]))
def test_the_way_home_kept_back_is_more_than_a_free_one_takes(place: np.ndarray, wind: object) -> None:
    energy = energy_of(mission(wind={"velocity_enu_m_s": wind}))
    hover, pad = np.array([0.0, 0.0, 4.0]), np.zeros(3)
    slow, vertical = Limits(1.5, 2.0, 6.0), Limits(1.5, 2.0, 6.0)
    home = WayHome(energy, hover, pad, LIMITS, slow, vertical, 1)
    back = fly_run(State.at_rest(place), 0.0, 0.0, [Via(hover, 0.0)], LIMITS).curve
    down = fly_run(State.at_rest(hover), 0.0, 0.0, [Via(pad, 0.0)], vertical).curve
    flown = energy.curve_percent(back) + energy.curve_percent(down)
    assert float(home.least_percent(place)) == pytest.approx(flown, rel=0.01)
    assert float(home.percent(place)) > flown


def test_behind_a_wall_the_way_home_is_as_long_as_the_way_there() -> None:
    def clear(a: np.ndarray, b: np.ndarray) -> bool:
        """Around the end of a wall along x = 0, from y = -40 on to the south."""
        if a[0] * b[0] >= 0.0:
            return True
        return bool(a[1] + (b[1] - a[1]) * a[0] / (a[0] - b[0]) < -40.0)

    hover, pad = np.array([-5.0, 0.0, 4.0]), np.array([-5.0, 0.0, 0.0])
    home = WayHome(DistanceEnergy(1.0), hover, pad, LIMITS, LIMITS, LIMITS, 1)
    before = float(home.percent(np.array([5.0, 0.0, 4.0])))
    for x, y in ((-5, -20), (-5, -45), (5, -45), (5, -20), (5, 0)):
        home.note(np.array([x, y, 4.0]), clear)
    assert before == pytest.approx(1.3 * 10.0 + 4.0)
    assert float(home.percent(np.array([5.0, 0.0, 4.0]))) == pytest.approx(45.0 + 10.0 + 45.0 + 4.0)
    assert float(home.least_percent(np.array([5.0, 0.0, 4.0]))) == pytest.approx(10.0 + 4.0)
    home.note(np.array([-5.0, -10.0, 4.0]), clear)
    assert float(home.percent(np.array([-5.0, -10.0, 4.0]))) == pytest.approx(1.3 * 10.0 + 4.0)


@settings(max_examples=30)
@given(st.lists(places, min_size=1, max_size=6))
def test_stopping_everywhere_bounds_a_flight(stops: list[np.ndarray]) -> None:
    energy = energy_of(mission())
    points = np.array([np.zeros(3), *stops])
    flown = sum(energy.curve_percent(fly_run(State.at_rest(a), 0.0, 0.0, [Via(b, 0.0)], LIMITS).curve)
                for a, b in itertools.pairwise(points))
    assert float(stops_percent(energy, points, 0.0, LIMITS).sum()) == pytest.approx(flown, rel=0.01, abs=1e-4)


def test_at_the_threshold_one_more_picture_is_taken_of_a_long_run(tmp_path: Path) -> None:
    world = World(mission(battery={"start_percent": [21.0], "threshold_percent": 20.0}), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(1.2 * n - 14.0, -9, 5) for n in range(24)], stop=False), 1)
    assert world.run(60, lambda: world.vehicles[1].battery.level_percent <= 20.0)
    before = len(world.views())
    assert 3 < before < 20
    assert world.run(90, world.landed)
    assert len(world.views()) == before + 1
    assert [r.view_id for r in world.reports] == list(range(101 + before, 124))


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (0.0, 12.0, 0.0), (-9.0, -9.0, 0.0)])
@pytest.mark.parametrize("seed", range(2))
def test_a_vehicle_always_lands_at_its_pad_with_the_reserve(seed: int, wind: tuple[float, float, float],
                                                            tmp_path: Path) -> None:
    """Whatever it is asked to fly, from little charge and without a threshold, the wind against it on the way home."""
    rng = np.random.default_rng(seed)
    reserve = float(rng.uniform(1.0, 10.0))
    world = World(mission(battery={"start_percent": [reserve + 5.0], "reserve_percent": reserve,
                                   "threshold_percent": 0.0}, wind={"velocity_enu_m_s": wind}), tmp_path)
    world.share_map(open_map(world.mission))
    battery, plan_id = world.vehicles[1].battery, 0
    while not (any(s.flying for s in world.states[1]) and world.landed()) and world.t_ns < 600 * NS:
        points = rng.uniform((-15.0, -15.0, 3.0), (15.0, -6.0, 12.0), (int(rng.integers(1, 9)), 3))
        plan_id += 1
        world.upload(route([(float(x), float(y), float(z)) for x, y, z in points], plan_id=plan_id,
                           first_view=100 * plan_id), 1)
        world.run(3)
        world.run(40, lambda: world.vehicles[1].executor.idle or world.landed())
    assert world.landed()
    assert np.linalg.norm(world.path(1)[-1] - takeoff_points(world.mission, SITE)[0]) < 0.01
    assert reserve <= battery.level_percent < reserve + 3.0
