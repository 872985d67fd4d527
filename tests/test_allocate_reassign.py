"""Reassignment in flight: nothing lost, nothing twice, next legs kept, few changes, as good as starting afresh."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planning.allocate.minmax import Effort, solve
from planning.allocate.minmax_tables import Warm
from planning.allocate.problem import Problem, Sorties, Ways, violations
from planning.allocate.reassign import reassign

Floats = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)
LITTLE = Effort(iterations=2_000, chains=2)
PERCENT_PER_M = 0.25


@dataclass(frozen=True)
class Fleet:
    """Vehicles in flight over views that are not flown yet."""

    views: Floats
    here: Floats
    homes: Floats
    flying: Sorties
    percent: Floats

    def problem(self, forbidden: NDArray[np.bool_] | None = None) -> Problem:
        return Problem(Ways.of_positions(self.views, self.here, self.homes, service=1.0), forbidden=forbidden,
                       energy=Ways.of_positions(self.views, self.here, self.homes, (PERCENT_PER_M,)),
                       available_percent=self.percent)

    @property
    def owner(self) -> dict[int, int]:
        return {view: k for k, own in enumerate(self.flying) for sortie in own for view in sortie}


def flying_fleet(seed: int, views: int, vehicles: int, effort: Effort = LITTLE) -> Fleet:
    """A third of every tour is flown; views are numbered anew."""
    rng = np.random.default_rng(seed)
    positions, homes = rng.uniform(0.0, 1.0, (views, 3)) * [60.0, 40.0, 25.0], rng.uniform(0.0, 60.0, (vehicles, 3))
    tours = solve(Problem(Ways.of_positions(positions, homes, service=1.0)), effort).tours
    flown = [tour[:len(tour) // 3] for tour in tours]
    left = sorted(itertools.chain.from_iterable(tour[len(tour) // 3:] for tour in tours))
    here = np.array([positions[own[-1]] if own else home for own, home in zip(flown, homes, strict=True)])
    flying = [[[left.index(v) for v in tour[len(tour) // 3:]]] for tour in tours]
    return Fleet(positions[left], here, homes, flying, np.full(vehicles, 100.0))


def without_vehicle(fleet: Fleet, k: int) -> Fleet:
    keep = [i for i in range(len(fleet.here)) if i != k]
    return Fleet(fleet.views, fleet.here[keep], fleet.homes[keep], [fleet.flying[i] for i in keep], fleet.percent[keep])


def with_vehicle(fleet: Fleet) -> Fleet:
    pad = np.array([[30.0, -5.0, 0.0]])
    return Fleet(fleet.views, np.vstack([fleet.here, pad]), np.vstack([fleet.homes, pad]), [*fleet.flying, [[]]],
                 np.append(fleet.percent, 100.0))


def with_views(fleet: Fleet, seed: int, count: int) -> Fleet:
    new = np.random.default_rng(seed).uniform(0.0, 1.0, (count, 3)) * [60.0, 40.0, 25.0]
    return replace(fleet, views=np.vstack([fleet.views, new]))


@st.composite
def events(draw: st.DrawFn) -> tuple[Fleet, NDArray[np.bool_]]:
    """A fleet to which several things happen, and who must not fly what."""
    fleet = flying_fleet(draw(seeds), draw(st.integers(3, 30)), draw(st.integers(1, 4)))
    if draw(st.booleans()):
        fleet = with_vehicle(fleet)
    if draw(st.booleans()) and len(fleet.here) > 1:
        fleet = without_vehicle(fleet, draw(st.integers(0, len(fleet.here) - 1)))
    if draw(st.booleans()):
        fleet = with_views(fleet, draw(seeds), draw(st.integers(1, 6)))
    if draw(st.booleans()):
        fleet.percent[draw(st.integers(0, len(fleet.here) - 1))] = draw(st.floats(0.0, 30.0))
    rng = np.random.default_rng(draw(seeds))
    return fleet, rng.random((len(fleet.here), len(fleet.views))) < draw(st.sampled_from([0.0, 0.1, 0.5]))


@given(events(), seeds)
@settings(deadline=None, max_examples=60)
def test_whatever_happens_nothing_is_lost_or_done_twice_and_next_legs_stay(
        event: tuple[Fleet, NDArray[np.bool_]], seed: int) -> None:
    fleet, forbidden = event
    problem = fleet.problem(forbidden)
    found = reassign(problem, fleet.flying, effort=LITTLE, seed=seed)
    assert violations(problem, found.allocation) == []
    owner = fleet.owner
    for vehicle, tour in enumerate(found.allocation.tours):
        received = [view for view in tour if owner.get(view) != vehicle]
        assert received == [view for view in tour if found.receiver_of_view.get(view) == vehicle]
        next_view = next(iter(fleet.flying[vehicle][0]), None)
        if next_view is not None and not forbidden[vehicle, next_view]:
            there = np.linalg.norm(fleet.views[next_view] - fleet.here[vehicle])
            back = np.linalg.norm(fleet.views[next_view] - fleet.homes[vehicle])
            if PERCENT_PER_M * (there + back) <= fleet.percent[vehicle] - 1e-4:
                assert tour[0] == next_view
    again = reassign(problem, fleet.flying, effort=LITTLE, seed=seed)
    assert again.allocation.sorties == found.allocation.sorties


@pytest.mark.parametrize("event", ["lost", "joined", "new views", "blocked", "low battery", "nothing"])
def test_it_is_as_good_as_starting_afresh_and_changes_little(event: str) -> None:
    fleet, forbidden = flying_fleet(11, 60, 3, Effort(iterations=10_000)), None
    if event == "lost":
        fleet = without_vehicle(fleet, 2)
    elif event == "joined":
        fleet = with_vehicle(fleet)
    elif event == "new views":
        fleet = with_views(fleet, 5, 4)
    elif event == "blocked":
        forbidden = np.zeros((3, len(fleet.views)), dtype=np.bool_)
        forbidden[0, fleet.flying[0][0][2:4]] = True
    elif event == "low battery":
        fleet.percent[1] = 20.0
    problem = fleet.problem(forbidden)
    next_legs = Warm([[own[0][:1]] for own in fleet.flying], locked=[1] * problem.vehicles)
    found, cold = reassign(problem, fleet.flying), solve(problem, Effort(iterations=15_000), warm=next_legs)
    assert found.allocation.left_over == []
    assert found.allocation.makespan_s <= 1.02 * cold.makespan_s
    moved = sum(1 for view in found.receiver_of_view if view in fleet.owner)
    cold_moved = sum(1 for k, tour in enumerate(cold.tours) for view in tour if fleet.owner.get(view, k) != k)
    assert moved <= cold_moved + 2


def test_a_lost_vehicle_may_also_be_forbidden_everything() -> None:
    fleet = flying_fleet(3, 20, 2)
    forbidden = np.zeros((2, len(fleet.views)), dtype=np.bool_)
    forbidden[1] = True
    found = reassign(fleet.problem(forbidden), fleet.flying, effort=LITTLE)
    assert found.allocation.tours[1] == []
    assert sorted(found.receiver_of_view) == sorted(fleet.flying[1][0])


def test_when_nobody_can_fly_a_view_it_is_left_over() -> None:
    fleet = replace(flying_fleet(4, 12, 2), percent=np.zeros(2))
    found = reassign(fleet.problem(), fleet.flying, effort=LITTLE)
    assert found.allocation.left_over == list(range(len(fleet.views)))
