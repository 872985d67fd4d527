"""How near tracks come, and schedules that keep tours apart by waiting."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.frames import Array
from planning.deconflict import NEVER, Track, conflicts, distance_to_polyline_m, first_approach, schedule

SEPARATION_M = 2.5
coordinate = st.floats(-8.0, 8.0, allow_nan=False, width=32)
points = st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=2, max_size=6).map(np.array)


def straight(a: tuple[float, ...], b: tuple[float, ...], speed_m_s: float = 2.0) -> Track:
    """At constant speed from a to b."""
    length = float(np.linalg.norm(np.subtract(b, a)))
    return Track(np.array([0.0, length / speed_m_s]), np.array([a, b], dtype=np.float64))


def dense(polyline: Array, count: int = 60) -> Array:
    """(count (n - 1) + 1, 3) samples along the chords."""
    f = np.linspace(0.0, 1.0, count, endpoint=False)[:, None]
    parts = [p + f * (q - p) for p, q in pairwise(polyline)]
    return np.concatenate([*parts, polyline[-1:]])


@settings(max_examples=60, deadline=None)
@given(points, points)
def test_approach_of_polylines_is_that_of_their_samples(a: Array, b: Array) -> None:
    a, b = a.astype(np.float64), b.astype(np.float64)
    gap = np.linalg.norm(dense(a)[:, None] - dense(b), axis=2).min()
    error = 0.5 * (np.linalg.norm(np.diff(a, axis=0), axis=1).max() + np.linalg.norm(np.diff(b, axis=0), axis=1).max())
    assert first_approach(a, b, 100, gap + 1e-6) != NEVER
    if gap - error / 60 > 0.01:
        assert first_approach(a, b, 100, gap - error / 60 - 1e-6) == NEVER


@settings(max_examples=60, deadline=None)
@given(points, points)
def test_distance_to_a_polyline_is_never_more_than_to_its_samples(a: Array, b: Array) -> None:
    near = distance_to_polyline_m(a.astype(np.float64), b.astype(np.float64))
    sampled = np.linalg.norm(a[:, None] - dense(b.astype(np.float64)), axis=2).min(axis=1)
    assert np.all(near <= sampled + 1e-9)
    assert np.all(near >= sampled - 0.2)


def test_vehicles_that_cross_at_different_times_do_not_conflict_until_one_is_late() -> None:
    first = straight((-10, 0, 0), (10, 0, 0))
    later = Track(np.array([0.0, 4.0, 24.0]), np.array([[0.0, -20.0, 0.0], [0.0, -20.0, 0.0], [0.0, 20.0, 0.0]]))
    assert conflicts([first, later], SEPARATION_M) == []
    assert [(c.a, c.b) for c in conflicts([first, later], SEPARATION_M, slack_s=8.0)] == [(0, 1)]


def flown(tour: list[Track], hold_s: list[float]) -> Track:
    """A tour with its holds on one clock."""
    t, p, now = [0.0], [tour[0].position_enu_m[0]], 0.0
    for run, hold in zip(tour, hold_s, strict=True):
        t += [now + hold, *(now + hold + run.t_s[1:])]
        p += list(run.position_enu_m)
        now += hold + run.duration_s
    t, rising = np.unique(np.array(t), return_index=True)
    return Track(t, np.array(p)[rising])


def test_the_shorter_of_two_crossing_tours_waits() -> None:
    long = [straight((-10, 0, 5), (30, 0, 5))]
    short = [straight((0, -10, 5), (0, 10, 5))]
    plan = schedule([[short], [long]], SEPARATION_M)
    assert plan.unresolved == []
    assert plan.hold_s[1] == [0.0]
    assert plan.hold_s[0][0] > 0.0
    assert conflicts([flown(short, plan.hold_s[0]), flown(long, plan.hold_s[1])], SEPARATION_M) == []


def test_a_tour_reversed_is_taken_when_it_is_done_earlier() -> None:
    corridor = [straight((0, 0, 5), (20, 0, 5)), straight((20, 0, 5), (40, 0, 5)), straight((40, 0, 5), (40, 90, 5))]
    there = [straight((0, 6, 5), (10, 0, 5)), straight((10, 0, 5), (10, 40, 5)), straight((10, 40, 5), (0, 6, 5))]
    back = [Track(r.t_s, r.position_enu_m[::-1]) for r in there[::-1]]
    plan = schedule([[corridor], [there, back]], SEPARATION_M)
    assert plan.tour == [0, 1]
    assert plan.hold_s[1] == [0.0, 0.0, 0.0]
    assert plan.unresolved == []


def test_what_waiting_cannot_resolve_is_said() -> None:
    plan = schedule([[[straight((0, 0, 5), (20, 0, 5))]], [[straight((20, 0, 5), (0, 0, 5))]]], SEPARATION_M)
    assert [(c.a, c.b) for c in plan.unresolved] == [(0, 1)]
    assert schedule([], SEPARATION_M).unresolved == []
    assert schedule([[], [[]]], SEPARATION_M).finish_s == [0.0, 0.0]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_holds_keep_random_tours_apart(seed: int) -> None:
    random = np.random.default_rng(seed)
    tours = []
    for v in range(5):
        home = np.array([6.0 * v, -15.0, 3.0])
        stops = [home, *random.uniform((0, 0, 3), (25, 20, 10), (4, 3)), home]
        tours.append([straight(tuple(a), tuple(b)) for a, b in pairwise(stops)])
    plan = schedule([[t] for t in tours], SEPARATION_M)
    tracks = [flown(t, h) for t, h in zip(tours, plan.hold_s, strict=True)]
    involved = {(c.a, c.b) for c in plan.unresolved}
    assert {(c.a, c.b) for c in conflicts(tracks, SEPARATION_M - 0.05)} <= involved
    assert plan == schedule([[t] for t in tours], SEPARATION_M)
