"""Reassignment in flight: nothing lost, nothing twice, next legs kept, few changes, as good as starting afresh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ground_station.allocate.fleet_in_flight import (
    EVENTS,
    FULL_PERCENT,
    PERCENT_PER_M,
    FleetInFlight,
    in_flight,
    random_places,
    with_vehicle,
    with_views,
    without_vehicle,
)
from planning.allocate.minmax import Effort, solve
from planning.allocate.minmax_tables import Warm
from planning.allocate.problem import violations
from planning.allocate.reassign import reassign

seeds = st.integers(0, 2**32 - 1)
LITTLE = Effort(iterations=2_000, chains=2)


def small_fleet(seed: int, views: int, vehicles: int, effort: Effort = LITTLE) -> FleetInFlight:
    return in_flight(random_places(views, seed), vehicles, effort, seed)


@st.composite
def events(draw: st.DrawFn) -> FleetInFlight:
    """A fleet to which several things happen."""
    fleet = small_fleet(draw(seeds), draw(st.integers(3, 30)), draw(st.integers(1, 4)))
    fleet.percent[:] = draw(st.sampled_from([FULL_PERCENT, 20.0]))
    if draw(st.booleans()):
        fleet = with_vehicle(fleet)
    if draw(st.booleans()) and len(fleet.here) > 1:
        fleet = without_vehicle(fleet, draw(st.integers(0, len(fleet.here) - 1)))
    if draw(st.booleans()):
        fleet = with_views(fleet, draw(st.integers(1, 6)), draw(seeds))
    if draw(st.booleans()):
        fleet.percent[draw(st.integers(0, len(fleet.here) - 1))] = draw(st.floats(0.0, 6.0))
    fleet.forbidden[:] = np.random.default_rng(draw(seeds)).random(fleet.forbidden.shape) < draw(
        st.sampled_from([0.0, 0.1, 0.5]))
    return fleet


@given(events(), seeds)
@settings(deadline=None, max_examples=60)
def test_whatever_happens_nothing_is_lost_or_done_twice_and_next_legs_stay(fleet: FleetInFlight, seed: int) -> None:
    found = reassign(fleet.problem, fleet.flying, effort=LITTLE, seed=seed)
    assert violations(fleet.problem, found.allocation) == []
    owner = fleet.owner
    for vehicle, tour in enumerate(found.allocation.tours):
        received = [view for view in tour if owner.get(view) != vehicle]
        assert received == [view for view in tour if found.receiver_of_view.get(view) == vehicle]
        next_view = next(iter(fleet.flying[vehicle][0]), None)
        if next_view is not None and not fleet.forbidden[vehicle, next_view]:
            there = np.linalg.norm(fleet.views[next_view] - fleet.here[vehicle])
            back = np.linalg.norm(fleet.views[next_view] - fleet.pads[vehicle])
            if PERCENT_PER_M * (there + back) <= fleet.percent[vehicle] - 1e-4:
                assert tour[0] == next_view
    again = reassign(fleet.problem, fleet.flying, effort=LITTLE, seed=seed)
    assert again.allocation.sorties == found.allocation.sorties


@pytest.mark.parametrize("event", EVENTS)
def test_it_is_as_good_as_starting_afresh_and_changes_little(event: str) -> None:
    fleet = EVENTS[event](small_fleet(11, 60, 3, Effort(iterations=10_000)), 5)
    next_legs = Warm([[own[0][:1]] for own in fleet.flying], locked=[1] * len(fleet.here))
    found, cold = reassign(fleet.problem, fleet.flying), solve(fleet.problem, Effort(iterations=15_000), warm=next_legs)
    assert found.allocation.left_over == []
    assert found.allocation.makespan_s <= 1.02 * cold.makespan_s
    moved = sum(1 for view in found.receiver_of_view if view in fleet.owner)
    cold_moved = sum(1 for k, tour in enumerate(cold.tours) for view in tour if fleet.owner.get(view, k) != k)
    assert moved <= cold_moved + 2


def test_a_lost_vehicle_may_also_be_forbidden_everything() -> None:
    fleet = small_fleet(3, 20, 2)
    fleet.forbidden[1] = True
    found = reassign(fleet.problem, fleet.flying, effort=LITTLE)
    assert found.allocation.tours[1] == []
    assert sorted(found.receiver_of_view) == sorted(fleet.flying[1][0])


def test_when_nobody_can_fly_a_view_it_is_left_over() -> None:
    fleet = replace(small_fleet(4, 12, 2), percent=np.zeros(2))
    found = reassign(fleet.problem, fleet.flying, effort=LITTLE)
    assert found.allocation.left_over == list(range(len(fleet.views)))
