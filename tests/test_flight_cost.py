"""Legs cost what flying them takes: predicted against flown, and the laws in between."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.grid import FREE, OCCUPIED, VoxelGrid
from planning.allocate.flight_cost import Passing, leg_seconds
from planning.paths import VoxelField
from planning.paths.roadmap import Roadmap, build_roadmap
from planning.trajectories import Flight, Limits, State, Via, fly_route, leg_time_s

NEED_M, CORNER_PASS_M = 1.0, 0.5
LIMITS = Limits(3.0, 2.0, 6.0, math.radians(60.0))
seeds = st.integers(0, 2**32 - 1)


def around_a_box(count: int, seed: int) -> tuple[Roadmap, Passing]:
    """Views that look at a box of 16 x 10 x 12 m from all sides."""
    grid = VoxelGrid.unknown(np.zeros(3), np.array([40.0, 34.0, 24.0]), 1.0)
    grid.state[:] = FREE
    grid.state[12:28, 12:22, :12] = OCCUPIED
    rng = np.random.default_rng(seed)
    p = rng.uniform([5.0, 5.0, 3.0], [35.0, 29.0, 20.0], (20 * count, 3))
    away = np.maximum(np.maximum([12.0, 12.0, 0.0] - p, p - [28.0, 22.0, 12.0]), 0.0)
    far = np.linalg.norm(away, axis=1)
    p = p[(far > 4.0) & (far < 7.0)][:count]
    look = np.array([20.0, 17.0, 6.0]) - p
    roadmap = build_roadmap(VoxelField.from_grid(grid), p, NEED_M)
    elevation = np.arctan2(look[:, 2], np.hypot(look[:, 0], look[:, 1]))
    return roadmap, Passing(np.arctan2(look[:, 1], look[:, 0]), elevation, np.full(count, 2.0), np.full(count, 0.25))


def flown(roadmap: Roadmap, passing: Passing, tour: list[int]) -> Flight:
    """The tour, from rest at its first view to rest at its last."""
    vias: list[Via] = []
    for a, b in pairwise(tour):
        corners = roadmap.corners_enu_m[a, b]
        vias += [Via(c, passing.yaw_rad[b], passing.elevation_rad[b], stop=False, pass_m=CORNER_PASS_M)
                 for c in corners[np.isfinite(corners[:, 0])]]
        vias.append(Via(roadmap.places_enu_m[b], passing.yaw_rad[b], passing.elevation_rad[b],
                        stop=bool(passing.speed_m_s[b] == 0.0), pass_m=passing.pass_m[b],
                        speed_m_s=passing.speed_m_s[b]))
    first = tour[0]
    return fly_route(State.at_rest(roadmap.places_enu_m[first]), passing.yaw_rad[first], passing.elevation_rad[first],
                     vias, LIMITS)


def a_good_tour(seconds: np.ndarray) -> list[int]:
    """Always to the nearest, then improved by 2-opt."""
    tour = [0]
    while len(tour) < len(seconds):
        tour.append(min(set(range(len(seconds))) - set(tour), key=lambda k: (seconds[tour[-1], k], k)))
    better = True
    while better:
        better = False
        for i in range(len(tour) - 2):
            for j in range(i + 2, len(tour) - 1):
                a, b, c, d = tour[i], tour[i + 1], tour[j], tour[j + 1]
                if seconds[a, c] + seconds[b, d] < seconds[a, b] + seconds[c, d] - 1e-9:
                    tour[i + 1:j + 1], better = tour[i + 1:j + 1][::-1], True
    return tour


def resting_at(passing: Passing, places: list[int]) -> Passing:
    """The same, stopping at some."""
    rests = np.isin(np.arange(len(passing.yaw_rad)), places)
    return replace(passing, speed_m_s=np.where(rests, 0.0, passing.speed_m_s))


@pytest.mark.parametrize(("optimised", "mean", "worst"), [(True, 0.03, 0.05), (False, 0.06, 0.08)])
def test_tours_take_what_their_legs_cost(optimised: bool, mean: float, worst: float) -> None:
    errors = []
    for seed in range(4):
        roadmap, passing = around_a_box(60, seed)
        seconds = leg_seconds(roadmap, passing, LIMITS, CORNER_PASS_M)
        tour = a_good_tour(seconds) if optimised else np.random.default_rng(seed).permutation(60).tolist()
        passing = resting_at(passing, [tour[0], tour[-1]])
        seconds = leg_seconds(roadmap, passing, LIMITS, CORNER_PASS_M)
        errors.append(sum(seconds[a, b] for a, b in pairwise(tour)) / flown(roadmap, passing, tour).duration_s - 1.0)
    assert abs(np.mean(errors)) < mean
    assert np.abs(errors).max() < worst


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_a_leg_between_rests_costs_exactly_what_it_takes(seed: int) -> None:
    roadmap, passing = around_a_box(8, seed)
    passing = resting_at(passing, list(range(8)))
    seconds = leg_seconds(roadmap, passing, LIMITS, CORNER_PASS_M)
    for a, b in [(0, 1), (2, 3), (4, 5), (6, 7)]:
        taken = flown(roadmap, passing, [a, b]).duration_s
        straight = bool(np.isnan(roadmap.corners_enu_m[a, b]).all())
        assert seconds[a, b] == pytest.approx(taken, rel=1e-5 if straight else 0.05)


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_passing_costs_less_than_stopping_and_no_leg_less_than_full_speed(seed: int) -> None:
    roadmap, passing = around_a_box(12, seed)
    passed = leg_seconds(roadmap, passing, LIMITS, CORNER_PASS_M)
    stopped = leg_seconds(roadmap, resting_at(passing, list(range(12))), LIMITS, CORNER_PASS_M)
    np.testing.assert_array_equal(passed, passed.T)
    assert np.mean(passed) < np.mean(stopped)
    assert np.all(passed >= (roadmap.lengths_m - 2.0 * CORNER_PASS_M * (1 + roadmap.corners_enu_m.shape[2])) / 3.0)
    assert np.all(stopped >= leg_time_s(roadmap.lengths_m, LIMITS) * 0.9 - 1e-6)


def test_the_camera_and_the_shutter_can_make_a_leg_longer() -> None:
    roadmap, passing = around_a_box(12, 1)
    quick = leg_seconds(roadmap, passing, LIMITS, CORNER_PASS_M)
    slow = leg_seconds(roadmap, replace(passing, speed_m_s=np.full(12, 0.2)), LIMITS, CORNER_PASS_M)
    assert np.all(slow >= quick - 1e-9)
    assert np.mean(slow) > np.mean(quick) + 0.2
    turning = leg_seconds(roadmap, passing, replace(LIMITS, slew_rad_s=0.05), CORNER_PASS_M)
    yaw = np.abs(np.angle(np.exp(1j * (passing.yaw_rad[:, None] - passing.yaw_rad))))
    assert np.all(turning >= yaw / 0.05)


def test_where_there_is_no_way_there_is_no_cost() -> None:
    grid = VoxelGrid.unknown(np.zeros(3), np.array([20.0, 10.0, 10.0]), 0.5)
    grid.state[:] = FREE
    grid.state[18:22] = OCCUPIED
    roadmap = build_roadmap(VoxelField.from_grid(grid), np.array([[4.0, 5, 5], [5.0, 5, 7], [16.0, 5, 5]]), NEED_M)
    same = Passing(np.zeros(3), np.zeros(3), np.full(3, 2.0), np.full(3, 0.2))
    assert np.isfinite(leg_seconds(roadmap, same, LIMITS, CORNER_PASS_M)).tolist() == [
        [True, True, False], [True, True, False], [False, False, True]]
