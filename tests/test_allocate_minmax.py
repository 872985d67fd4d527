"""Min-max tours: the optimum where it can be enumerated; all that a problem may ask for kept, whatever it asks."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planning.allocate.minmax import Effort, solve
from planning.allocate.minmax_tables import Warm
from planning.allocate.problem import Allocation, Problem, Ways, appraise, sortie_cost, violations

Floats = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)
LITTLE = Effort(iterations=2_000, chains=2)


def scattered(seed: int, count: int) -> Floats:
    return np.random.default_rng(seed).uniform(0.0, 1.0, (count, 3)) * [60.0, 40.0, 25.0]


def ways(seed: int, views: int, vehicles: int, lopsided: bool = False, service: float = 1.0) -> Ways:
    """Legs between random positions; when lopsided, every leg costs up to half more in one direction."""
    straight = Ways.of_positions(scattered(seed, views), scattered(seed + 1, vehicles), scattered(seed + 2, vehicles),
                                 service=service)
    if not lopsided:
        return straight
    rng = np.random.default_rng(seed + 3)
    return replace(straight, between=straight.between * rng.uniform(1.0, 1.5, straight.between.shape),
                   to_home=straight.to_home * rng.uniform(1.0, 1.5, straight.to_home.shape))


def optimum(problem: Problem) -> float:
    """Least makespan of all ways to share out and order the views."""
    finish = np.full((problem.vehicles, 2**problem.views), np.inf)
    for vehicle, chosen in itertools.product(range(problem.vehicles), range(2**problem.views)):
        share = [view for view in range(problem.views) if chosen >> view & 1]
        finish[vehicle, chosen] = min(sortie_cost(problem, problem.seconds, vehicle, 0, order)
                                      for order in itertools.permutations(share))
    everything = 2**problem.views - 1
    return float(min(max(finish[0, a], finish[1, everything - a]) for a in range(2**problem.views)))


@given(seeds, st.integers(1, 6), st.booleans(), st.booleans())
@settings(deadline=None, max_examples=25)
def test_two_vehicles_with_few_views_fly_the_optimum(seed: int, views: int, lopsided: bool, free: bool) -> None:
    problem = Problem(ways(seed, views, 2, lopsided), free=free)
    found = solve(problem, LITTLE)
    assert violations(problem, found) == []
    assert found.left_over == []
    assert found.makespan_s == pytest.approx(optimum(problem), rel=1e-5)


@st.composite
def problems(draw: st.DrawFn) -> Problem:
    """Anything that a problem may hold: kinds of vehicle, energy, several sorties, forbidden views, missing legs."""
    seed, views, vehicles = draw(seeds), draw(st.integers(1, 25)), draw(st.integers(1, 4))
    rng = np.random.default_rng(seed)
    seconds = ways(seed, views, vehicles, draw(st.booleans()))
    if draw(st.booleans()):
        seconds.between[:, rng.random((views, views)) < 0.2] = np.inf
    if draw(st.booleans()):
        seconds.from_start[rng.random((vehicles, views)) < 0.2] = np.inf
    problem = Problem(seconds, forbidden=rng.random((vehicles, views)) < draw(st.sampled_from([0.0, 0.3, 0.9])))
    if draw(st.booleans()):
        problem = replace(problem, energy=ways(seed, views, vehicles, service=0.2),
                          available_percent=rng.uniform(20.0, 200.0, vehicles), swap_s=draw(st.floats(0.0, 60.0)),
                          swapped_percent=rng.uniform(50.0, 200.0, vehicles),
                          max_sorties=rng.integers(1, 4, vehicles))
    return problem


@given(problems(), seeds)
@settings(deadline=None, max_examples=120)
def test_every_view_is_flown_once_or_left_over_and_no_limit_is_broken(problem: Problem, seed: int) -> None:
    found = solve(problem, LITTLE, seed)
    assert violations(problem, found) == []
    again = solve(problem, LITTLE, seed)
    assert (again.sorties, again.left_over) == (found.sorties, found.left_over)


@given(problems(), seeds)
@settings(deadline=None, max_examples=80)
def test_no_view_is_left_over_that_an_idle_vehicle_could_fly(problem: Problem, seed: int) -> None:
    found = solve(problem, LITTLE, seed)
    idle = [vehicle for vehicle, tour in enumerate(found.tours) if not tour]
    for vehicle, view in itertools.product(idle, found.left_over):
        alone = [[[view]] if v == vehicle else [[]] for v in range(problem.vehicles)]
        assert violations(problem, appraise(problem, alone)) != [] or problem.views == 0


def line(*x: float) -> Floats:
    return np.array([[v, 0.0, 0.0] for v in x])


def test_a_faster_vehicle_gets_more() -> None:
    positions = line(*range(1, 31))
    starts = line(0.0, 0.0)
    seconds = Ways.of_positions(positions, starts, per_metre=(1.0, 0.25), kind=(0, 1), service=1.0)
    found = solve(Problem(seconds, kind=np.array([0, 1])), LITTLE)
    slow, fast = (len(tour) for tour in found.tours)
    assert fast > slow
    assert found.finish_s.max() - found.finish_s.min() <= 3.0


def test_a_vehicle_with_less_charge_gets_less_and_both_keep_their_reserve() -> None:
    positions, starts = scattered(5, 20), np.zeros((2, 3))
    seconds = Ways.of_positions(positions, starts)
    problem = Problem(seconds, energy=Ways.of_positions(positions, starts, per_metre=(0.2,)),
                      available_percent=np.array([15.0, 80.0]))
    found = solve(problem, LITTLE)
    assert found.left_over == []
    assert len(found.tours[0]) < len(found.tours[1])
    assert found.energy_percent[0][0] <= 15.0
    assert found.energy_percent[1][0] <= 80.0


def test_what_no_battery_reaches_is_left_over_and_the_rest_is_flown() -> None:
    positions, starts = line(5.0, 10.0, 400.0), line(0.0)
    problem = Problem(Ways.of_positions(positions, starts), energy=Ways.of_positions(positions, starts),
                      available_percent=np.array([100.0]), swapped_percent=np.array([100.0]),
                      max_sorties=np.array([9]))
    found = solve(problem, LITTLE)
    assert found.left_over == [2]
    assert sorted(found.tours[0]) == [0, 1]


def test_several_sorties_fly_what_one_cannot_and_each_change_of_battery_takes_its_time() -> None:
    positions, starts = line(-40.0, 40.0, -41.0, 41.0), line(0.0)
    whole = Ways.of_positions(positions, starts)
    problem = Problem(whole, energy=whole, available_percent=np.array([90.0]), swapped_percent=np.array([90.0]),
                      swap_s=30.0, max_sorties=np.array([3]))
    found = solve(problem, LITTLE)
    assert found.left_over == []
    assert sorted(sorted(sortie) for sortie in found.sorties[0]) == [[0, 2], [1, 3]]
    assert found.makespan_s == pytest.approx(82.0 + 30.0 + 82.0)
    alone = solve(replace(problem, max_sorties=np.array([1])), LITTLE)
    assert len(alone.left_over) == 2


def test_a_flying_vehicle_that_is_low_goes_home_first_and_flies_on_with_a_fresh_battery() -> None:
    positions, homes, here = line(50.0, 60.0), line(0.0), line(10.0)
    problem = Problem(Ways.of_positions(positions, here, homes), energy=Ways.of_positions(positions, here, homes),
                      available_percent=np.array([12.0]), swapped_percent=np.array([130.0]), swap_s=5.0,
                      max_sorties=np.array([2]))
    found = solve(problem, LITTLE)
    assert found.sorties == [[[], [0, 1]]] or found.sorties == [[[], [1, 0]]]
    assert found.makespan_s == pytest.approx(10.0 + 5.0 + 120.0)
    stranded = solve(replace(problem, available_percent=np.array([9.0])), LITTLE)
    assert stranded.left_over == [0, 1]


def test_nothing_to_do_takes_the_way_home() -> None:
    seconds = Ways.of_positions(np.zeros((0, 3)), line(3.0, 0.0), line(0.0, 0.0))
    assert list(solve(Problem(seconds), LITTLE).finish_s) == [3.0, 0.0]


@given(seeds, st.integers(1, 4), st.integers(0, 3))
@settings(deadline=None, max_examples=30)
def test_a_warm_start_keeps_the_locked_views_first_and_is_never_worse_for_long(seed: int, vehicles: int,
                                                                              locks: int) -> None:
    problem = Problem(ways(seed, 20, vehicles))
    order = np.random.default_rng(seed).permutation(16)
    plan = [[[int(v) for v in share]] for share in np.array_split(order, vehicles)]
    found = solve(problem, LITTLE, warm=Warm(plan, locked=[locks] * vehicles))
    assert violations(problem, found) == []
    assert found.left_over == []
    for own, tour in zip(plan, found.tours, strict=True):
        assert tour[:min(locks, len(own[0]))] == own[0][:locks]


def test_views_change_hands_only_when_it_saves_more_than_it_costs() -> None:
    problem = Problem(ways(3, 24, 3))
    plan = solve(problem, LITTLE).sorties
    swapped = [plan[1], plan[0], plan[2]]
    kept = solve(problem, LITTLE, warm=Warm(swapped, change_s=1e6))
    assert [sorted(t) for t in kept.tours] == [sorted(v for s in own for v in s) for own in swapped]
    free = solve(problem, LITTLE, warm=Warm(swapped))
    assert free.makespan_s <= kept.makespan_s


def test_more_chains_are_never_worse() -> None:
    problem = Problem(ways(8, 40, 3))
    spans = [solve(problem, Effort(1_000, chains)).makespan_s for chains in (1, 2, 4)]
    assert spans == sorted(spans, reverse=True)


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"max_sorties has shape \(3,\), not \(2,\)"):
        Problem(ways(1, 4, 2), max_sorties=np.ones(3, dtype=np.int64))


def test_a_time_limit_ends_the_search() -> None:
    problem = Problem(ways(9, 30, 2))
    found: Allocation = solve(problem, Effort(time_limit_s=0.05))
    assert violations(problem, found) == []
