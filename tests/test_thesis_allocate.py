"""Clustering, tours, battery forecast and reassignment."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planning.allocate.battery import consume, range_m, threshold_index
from planning.allocate.cost import LegCost
from planning.allocate.thesis import allocate
from planning.allocate.thesis_reassign import Receiver, ownership, reassign, tour_length_m
from planning.allocate.tours import closed_tour, open_tour
from planning.allocate.ward import clusters_to_vehicles, ward_clusters

seeds = st.integers(0, 2**32 - 1)


def scattered(seed: int, count: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).uniform(0.0, 1.0, (count, 3)) * [60.0, 20.0, 25.0]


def test_distance_cost_is_euclidean() -> None:
    assert LegCost().between(np.zeros((1, 3)), np.array([[2.0, 3.0, 6.0]]))[0, 0] == 7.0


def test_elevation_cost_is_equation_4_4() -> None:
    cost = LegCost("distance_elevation", alpha=2.0, beta=0.5)
    assert cost.between(np.zeros((1, 3)), np.array([[3.0, 4.0, -6.0]]))[0, 0] == 2.0 * 5.0 + 0.5 * 6.0


@given(seeds, st.integers(0, 40), st.integers(1, 8))
@settings(deadline=None)
def test_clusters_partition_the_views(seed: int, views: int, vehicles: int) -> None:
    clusters = ward_clusters(scattered(seed, views), vehicles)
    assert sorted(i for c in clusters for i in c) == list(range(views))
    assert len(clusters) == min(views, vehicles)


def test_ward_separates_two_heaps() -> None:
    heaps = np.concatenate([scattered(1, 10), scattered(2, 15) + np.array([500.0, 0.0, 0.0])])
    assert [list(c) for c in sorted(ward_clusters(heaps, 2), key=len)] == [list(range(10)), list(range(10, 25))]


def test_clusters_go_to_the_vehicles_beside_them() -> None:
    from_start = np.array([[9.0, 9.0, 1.0], [1.0, 1.0, 9.0]])
    given_clusters = clusters_to_vehicles([np.array([0, 1]), np.array([2])], from_start)
    assert [list(c) for c in given_clusters] == [[2], [0, 1]]


@given(seeds, st.integers(0, 40), st.integers(1, 8), st.sampled_from(["distance", "distance_elevation"]))
@settings(deadline=None, max_examples=40)
def test_allocation_conserves_the_views(seed: int, views: int, vehicles: int, kind: str) -> None:
    positions, starts = scattered(seed, views), scattered(seed + 1, vehicles)
    cost = LegCost(kind)  # type: ignore[arg-type]
    tours = allocate(positions, starts, cost)
    assert len(tours) == vehicles
    assert sorted(itertools.chain.from_iterable(tours)) == list(range(views))
    assert tours == allocate(positions, starts, cost)


def test_allocation_follows_flown_lengths_when_given() -> None:
    positions, starts = np.array([[1.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0], [4.0, 0, 0]]), np.zeros((1, 3))
    ring = [2, 0, 3, 1]
    between = np.full((4, 4), 100.0)
    for a, b in zip(ring, ring[1:] + ring[:1], strict=True):
        between[a, b] = between[b, a] = 1.0
    np.fill_diagonal(between, 0.0)
    (tour,) = allocate(positions, starts, LegCost(), between=between, from_start=np.array([[9.0, 9.0, 0.5, 0.5]]))
    assert len({tour[0], tour[-1]} & {2, 3}) == 1
    assert sum(between[a, b] for a, b in itertools.pairwise(tour)) == 3.0


def round_trip(order: list[int], cost: NDArray[np.float64]) -> float:
    return float(sum(cost[a, b] for a, b in zip(order, order[1:] + order[:1], strict=True)))


@given(seeds, st.integers(4, 7))
@settings(deadline=None, max_examples=25)
def test_closed_tour_is_within_christofides_bound(seed: int, views: int) -> None:
    points = scattered(seed, views)
    cost = LegCost().between(points, points)
    tour = closed_tour(cost)
    shortest = min(round_trip([0, *rest], cost) for rest in itertools.permutations(range(1, views)))
    assert tour[0] == 0
    assert sorted(tour) == list(range(views))
    assert round_trip(tour, cost) <= 1.5 * shortest + 1e-6


@given(seeds, st.integers(2, 12))
@settings(deadline=None, max_examples=25)
def test_open_tour_is_the_best_cut_of_the_round_trip(seed: int, views: int) -> None:
    points, start = scattered(seed, views), scattered(seed + 1, 1)
    between, ends = LegCost().between(points, points), LegCost().between(start, points)[0]

    def length(order: list[int]) -> float:
        return float(ends[order[0]] + ends[order[-1]] + sum(between[a, b] for a, b in itertools.pairwise(order)))

    cycle = closed_tour(between)
    cuts = [cycle[c:] + cycle[:c] for c in range(views)]
    assert length(open_tour(between, ends, ends)) == pytest.approx(min(length(cut) for cut in cuts))


@given(seeds, st.integers(1, 30), st.floats(0.0, 100.0), st.floats(0.0, 1.0))
@settings(deadline=None)
def test_forecast_is_algorithm_1(seed: int, count: int, start: float, rate: float) -> None:
    points = scattered(seed, count)
    distance, level = [0.0], [start]
    for i in range(1, count):
        delta = float(np.linalg.norm(points[i] - points[i - 1]))
        distance.append(distance[-1] + delta)
        level.append(max(level[-1] - delta * rate, 0.0))
    forecast = consume(points, start, rate)
    assert np.allclose(forecast.distance_m, distance)
    assert np.allclose(forecast.level_percent, level, atol=1e-9)


def test_threshold_is_where_the_level_first_reaches_it() -> None:
    forecast = consume(line(0.0, 100.0, 200.0, 300.0), 50.0, 0.1)
    assert list(forecast.level_percent) == [50.0, 40.0, 30.0, 20.0]
    assert threshold_index(forecast, 20.0) == 3
    assert threshold_index(forecast, 19.0) is None


def test_range_is_what_is_left_above_the_reserve() -> None:
    assert range_m(60.0, 0.1, 20.0) == pytest.approx(400.0)
    assert range_m(10.0, 0.1, 20.0) == 0.0
    assert range_m(10.0, 0.0) == float("inf")


@st.composite
def handovers(draw: st.DrawFn) -> tuple[list[int], list[Receiver], NDArray[np.float64]]:
    """Remaining views, receivers with tours of their own, and ways between views."""
    rng = np.random.default_rng(draw(seeds))
    views, count = draw(st.integers(1, 25)), draw(st.integers(0, 4))
    points = scattered(draw(seeds), views)
    owner = rng.integers(-1, count, views)
    receivers = []
    for r in range(count):
        here, home = (LegCost().between(scattered(draw(seeds), 1), points)[0] for _ in range(2))
        tour = [int(v) for v in rng.permutation(np.flatnonzero(owner == r))]
        own = Receiver(10 + r, tour, draw(st.integers(0, 30)), here, home, float("inf"))
        between = LegCost().between(points, points)
        spare = draw(st.floats(0.0, 300.0))
        receivers.append(Receiver(10 + r, tour, own.flown_views, here, home, tour_length_m(own, tour, between) + spare))
    return [int(v) for v in np.flatnonzero(owner == -1)], receivers, LegCost().between(points, points)


@given(handovers())
@settings(deadline=None, max_examples=150)
def test_reassignment_loses_no_view_and_doubles_none(
        handover: tuple[list[int], list[Receiver], NDArray[np.float64]]) -> None:
    remaining, receivers, between = handover
    result = reassign(remaining, receivers, between)
    before = sorted(remaining + [v for r in receivers for v in r.tour])
    after = sorted(result.left_over + [v for tour in result.tours.values() for v in tour])
    assert before == after
    assert sorted(result.receiver_of_view) == sorted(set(remaining) - set(result.left_over))
    for r in receivers:
        tour = result.tours[r.vehicle_id]
        assert tour_length_m(r, tour, between) <= r.range_m + 1e-6
        assert tour[: len(r.tour)] == list(r.tour)
        assert all(result.receiver_of_view[v] == r.vehicle_id for v in tour if v not in r.tour)


def receiver(vehicle_id: int, tour: list[int], flown: int, x: float, points: NDArray[np.float64],
             metres: float = 1e6) -> Receiver:
    ways = np.linalg.norm(points - [x, 0.0, 0.0], axis=1)
    return Receiver(vehicle_id, tour, flown, ways, ways, metres)


def line(*x: float) -> NDArray[np.float64]:
    return np.array([[v, 0.0, 0.0] for v in x])


def test_the_free_vehicle_takes_all_even_when_a_busy_one_is_nearer() -> None:
    points = line(10, 11, 12)
    busy, free = receiver(1, [0], 0, 10.0, points), receiver(2, [], 5, 90.0, points)
    result = reassign([1, 2], [busy, free], LegCost().between(points, points))
    assert result.receiver_of_view == {1: 2, 2: 2}
    assert result.tours[1] == [0]


def test_what_the_free_vehicle_cannot_afford_goes_to_the_busy_one() -> None:
    points = line(10, 11, 60)
    busy, free = receiver(1, [0], 0, 10.0, points), receiver(2, [], 5, 0.0, points, metres=30.0)
    result = reassign([1, 2], [busy, free], LegCost().between(points, points))
    assert result.receiver_of_view == {1: 2, 2: 1}


def test_what_is_taken_over_goes_behind_the_own_tour_in_its_order() -> None:
    points = line(10, 30, 20, 5)
    free = receiver(1, [0, 1], 9, 0.0, points)
    assert reassign([2, 3], [free], LegCost().between(points, points)).tours[1] == [0, 1, 2, 3]


def test_nobody_left_leaves_every_view_over() -> None:
    assert reassign([4, 2], [], np.zeros((5, 5))).left_over == [4, 2]


def test_ids_of_origin_survive_two_reassignments() -> None:
    table = ownership({1: [5, 3], 2: [4]})
    later = table.moved({5: 2, 3: 2}).moved({3: 7})
    assert list(later.view_id) == [3, 4, 5]
    assert list(later.origin_vehicle) == [1, 2, 1]
    assert list(later.current_vehicle) == [7, 2, 2]
