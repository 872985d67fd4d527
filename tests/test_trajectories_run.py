"""Laws of runs: blended corners keep every limit, pass what they should, and can be stopped on the path at any time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from missions.grid import FREE, OCCUPIED, VoxelGrid
from planning.paths import VoxelField
from planning.trajectories import MAX_RUN, Flight, Limits, State, Via, fly_route, fly_run, leg_time_s, run_length

EXACT_M = 0.02
seeds = st.integers(0, 2**32 - 1)
share = st.floats(0.0, 1.0)


def a_run(seed: int) -> tuple[np.ndarray, list[Via], Limits]:
    """Start, vias and limits of a random run: some points on a line, some twice, some reversals, some exact."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 12))
    steps = rng.normal(0.0, rng.choice([0.3, 1.5, 6.0]), (count, 3))
    for n in range(1, count):
        other = [steps[n], steps[n - 1], -steps[n - 1], np.zeros(3)]
        steps[n] = other[rng.choice(4, p=[0.68, 0.2, 0.08, 0.04])]
    points = np.cumsum(steps, axis=0)
    speed, still = float(rng.uniform(0.5, 8.0)), rng.random(count) < 0.3
    vias = [Via(p, rng.uniform(-3, 3) * (not s), rng.uniform(-1, 1) * (not s), stop=n == count - 1,
                pass_m=float(rng.choice([0.0, 0.05, 0.25, 1.0])),
                speed_m_s=float(rng.choice([np.inf, 0.3 * speed, 0.7 * speed])))
            for n, (p, s) in enumerate(zip(points, still, strict=True))]
    slew = float(rng.choice([0.3, 1.0, math.inf]))
    return np.zeros(3), vias, Limits(speed, float(rng.uniform(0.5, 5.0)), float(rng.uniform(1.0, 20.0)), slew)


def flown(seed: int) -> tuple[Flight, list[Via], Limits]:
    """The run, flown."""
    start, vias, lim = a_run(seed)
    return fly_run(State.at_rest(start), 0.0, 0.0, vias, lim), vias, lim


def off_segments(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n,) distances of points (n, 3) from the nearest of the segments from a (k, 3) to b."""
    span = b - a
    f = np.clip(((p[:, None] - a) * span).sum(axis=2) / np.maximum((span**2).sum(axis=1), 1e-18), 0.0, 1.0)
    return np.asarray(np.linalg.norm(p[:, None] - a - f[..., None] * span, axis=2).min(axis=1))


@given(seeds)
@example(24000)  # a point 11 mm beside the straight that it is on, and passed too fast at first
@settings(max_examples=200, deadline=None)
def test_every_sample_keeps_every_limit_and_nothing_jumps(seed: int) -> None:
    flight, _, lim = flown(seed)
    t = np.linspace(0.0, flight.duration_s, 6000)
    p, v, a = flight.curve.at(t)
    dt = t[1] - t[0]
    assert np.linalg.norm(v, axis=1).max() <= lim.speed_m_s * (1 + 1e-6)
    assert np.linalg.norm(a, axis=1).max() <= lim.acceleration_m_s2 * (1 + 1e-6)
    assert np.linalg.norm(np.diff(a, axis=0), axis=1).max() <= lim.jerk_m_s3 * dt * (1 + 1e-6) + 1e-6
    assert np.linalg.norm(np.diff(v, axis=0), axis=1).max() <= lim.acceleration_m_s2 * dt * (1 + 1e-6) + 1e-6
    assert np.linalg.norm(np.diff(p, axis=0), axis=1).max() <= lim.speed_m_s * dt * (1 + 1e-6) + 1e-6


@given(seeds)
@settings(max_examples=200, deadline=None)
def test_vias_are_passed_in_order_nearby_slowly_enough_and_the_last_is_reached(seed: int) -> None:
    flight, vias, _ = flown(seed)
    p, v, _ = flight.curve.at(flight.reached_s)
    away = np.linalg.norm(p - [via.position for via in vias], axis=1)
    assert np.all(away <= np.maximum([via.pass_m for via in vias], EXACT_M) + 1e-6)
    assert np.all(np.diff(flight.reached_s) >= -1e-9)
    assert np.all(np.linalg.norm(v, axis=1) <= np.array([via.speed_m_s for via in vias]) * (1 + 1e-5))
    assert away[-1] < 1e-6
    assert np.abs(v[-1]).max() < 1e-6
    corners = np.array([np.zeros(3), *(via.position for via in vias)])
    widest = max(max(via.pass_m for via in vias), EXACT_M)
    assert off_segments(flight.curve.sample(0.02)[1], corners[:-1], corners[1:]).max() <= widest + 1e-6


@given(seeds)
@settings(max_examples=200, deadline=None)
def test_the_camera_is_turned_and_still_at_every_shutter_and_never_too_quick(seed: int) -> None:
    flight, vias, lim = flown(seed)
    dt = np.diff(flight.turn_s)
    moves = np.maximum(np.abs(np.diff(flight.yaw_rad)), np.abs(np.diff(flight.elevation_rad)))
    assert np.all(moves[dt == 0.0] == 0.0) or lim.slew_rad_s == math.inf
    assert np.all(moves[dt > 0.0] / dt[dt > 0.0] <= lim.slew_rad_s * (1 + 1e-5))
    for via, t in zip(vias, flight.reached_s, strict=True):
        for moment in (t - 0.009, t, t + 0.009):
            yaw, elevation = flight.attitude(moment)
            assert math.cos(yaw - via.yaw_rad) > 1 - 1e-9
            assert elevation == pytest.approx(via.elevation_rad)


@given(seeds, share)
@settings(max_examples=200, deadline=None)
def test_a_flight_can_be_stopped_on_its_path_at_any_time(seed: int, when: float) -> None:
    flight, _, lim = flown(seed)
    t = when * flight.duration_s
    stop = flight.stop(t)
    for now, then in zip(flight.curve.at(t), stop.curve.at(0.0), strict=True):
        np.testing.assert_allclose(now, then, atol=1e-6)
    after = np.linspace(0.0, stop.duration_s, 200)
    p, v, a = stop.curve.at(after)
    followed = np.linalg.norm(p - flight.curve.at(t + after)[0], axis=1)
    begin, end = (flight.curve.at(moments)[0] for moments in flight.straights_s.T)
    assert np.minimum(followed, off_segments(p, begin, end)).max() < 2e-6
    assert np.linalg.norm(v, axis=1).max() <= lim.speed_m_s * (1 + 1e-6)
    assert np.linalg.norm(a, axis=1).max() <= lim.acceleration_m_s2 * (1 + 1e-6)
    assert np.abs(v[-1]).max() < 1e-6
    assert stop.duration_s <= flight.duration_s - t + 1e-6


@given(seeds, share)
@settings(max_examples=100, deadline=None)
def test_a_stop_passes_at_most_one_blend_after_the_straight_it_is_on(seed: int, when: float) -> None:
    flight, _, lim = flown(seed)
    t = when * flight.duration_s
    following = flight.straights_s[flight.straights_s[:, 1] > t]
    latest = max(t, float(following[min(1, len(following) - 1), 0])) if len(following) else t
    ramp = lim.speed_m_s / lim.acceleration_m_s2 + 2.0 * lim.acceleration_m_s2 / lim.jerk_m_s3 \
        + 2.0 * math.sqrt(lim.speed_m_s / lim.jerk_m_s3)
    assert flight.stop(t).duration_s <= latest - t + ramp + 1e-6


@given(seeds)
@settings(max_examples=150, deadline=None)
def test_passing_is_never_slower_than_stopping_at_every_via(seed: int) -> None:
    flight, vias, lim = flown(seed)
    stops = fly_route(State.at_rest(np.zeros(3)), 0.0, 0.0, [replace(v, stop=True) for v in vias], lim)
    assert flight.duration_s <= stops.duration_s * (1 + 1e-6) + 1e-4


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_no_sample_comes_nearer_to_anything_than_the_margin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = VoxelGrid(np.full(3, -12.0), 0.5, np.full((48, 48, 48), FREE, np.uint8))
    grid.state[tuple(rng.integers(8, 40, (40, 3)).T)] = OCCUPIED
    field, need = VoxelField.from_grid(grid), 0.8
    points = [p for p in rng.uniform(-8.0, 8.0, (60, 3)) if field.clearance_m(p)[0] >= need]
    assume(len(points) > 1)
    kept = [points[0]]
    for p in points[1:]:
        if field.segments_clear(kept[-1], p, need)[0]:
            kept.append(p)
    assume(len(kept) > 1)

    def clear(polyline: np.ndarray) -> bool:
        return bool(field.segments_clear(polyline[:-1], polyline[1:], need).all())

    vias = [Via(p, 0.0, stop=p is kept[-1], pass_m=1.5) for p in kept[1:]]
    flight = fly_run(State.at_rest(kept[0]), 0.0, 0.0, vias, Limits(3.0, 2.0, 6.0), clear)
    cubes = grid.origin_enu_m + np.argwhere(grid.state == OCCUPIED) * grid.voxel_m
    p = flight.curve.sample(0.02)[1][:, None]
    gap = np.linalg.norm(np.maximum(np.maximum(cubes - p, p - cubes - grid.voxel_m), 0.0), axis=2)
    assert gap.min() >= need - 0.03


def test_a_blend_that_is_not_free_is_flown_more_tightly_and_at_last_not_at_all() -> None:
    lim, corner = Limits(3.0, 2.0, 6.0), np.array([10.0, 0.0, 0.0])
    vias = [Via(corner, 0.0, stop=False, pass_m=1.0), Via(np.array([10.0, 10.0, 0.0]), 0.0)]
    nearest = []
    for room in (9.0, 0.6, 0.3, 0.0):
        flight = fly_run(State.at_rest(np.zeros(3)), 0.0, 0.0, vias, lim,
                         lambda q, room=room: bool(np.linalg.norm(q - corner, axis=1).min() <= room))
        nearest.append(float(np.linalg.norm(flight.curve.at(flight.reached_s[0])[0] - corner)))
    assert nearest == pytest.approx([1.0, 0.5, 0.25, 0.0], abs=0.06)
    assert nearest[3] == pytest.approx(0.0, abs=1e-6)


def test_waypoints_on_a_line_are_passed_at_speed_and_the_shutter_limit_slows_there_alone() -> None:
    lim = Limits(3.0, 2.0, 6.0, 1.0)
    line = [Via(np.array([x, 0.0, 5.0]), 0.0, stop=x == 40.0) for x in (10.0, 20.0, 30.0, 40.0)]
    start = State.at_rest(np.array([0.0, 0.0, 5.0]))
    free = fly_run(start, 0.0, 0.0, line, lim)
    assert free.duration_s == pytest.approx(float(leg_time_s(40.0, lim)), abs=1e-5)
    slow = fly_run(start, 0.0, 0.0, [replace(v, speed_m_s=1.0) if v is line[1] else v for v in line], lim)
    speeds = np.linalg.norm(slow.curve.at(slow.reached_s)[1], axis=1)
    assert speeds == pytest.approx([3.0, 1.0, 3.0, 0.0], abs=1e-5)


def test_a_corner_off_by_a_rounding_is_none() -> None:
    lim = Limits(3.0, 2.0, 6.0)
    vias = [Via(np.array([x, 0.01 * (-1) ** x, 0.0]), 0.0, stop=x == 20) for x in range(1, 21)]
    flight = fly_run(State.at_rest(np.zeros(3)), 0.0, 0.0, vias, lim)
    assert flight.duration_s == pytest.approx(float(leg_time_s(20.0, lim)), abs=1e-3)


def test_runs_end_at_stops_and_are_not_endless() -> None:
    way = [Via(np.full(3, float(n)), 0.0, stop=n in (3, 4)) for n in range(100)]
    assert [run_length(way), run_length(way[4:]), run_length(way[5:])] == [4, 1, MAX_RUN]
    assert run_length(way[95:]) == 5


def test_only_the_stretch_on_which_the_camera_is_late_is_slowed() -> None:
    lim = Limits(3.0, 2.0, 6.0, 0.5)
    corners = np.array([[10.0, 0, 0], [10, 10, 0], [20, 10, 0], [20, 20, 0]])
    yaws = [0.0, 0.0, math.pi, math.pi]
    still = [Via(p, 0.0, stop=n == 3, pass_m=0.5) for n, p in enumerate(corners)]
    turning = [replace(v, yaw_rad=y) for v, y in zip(still, yaws, strict=True)]
    a, b = (np.diff(fly_run(State.at_rest(np.zeros(3)), 0.0, 0.0, v, lim).reached_s, prepend=0.0)
            for v in (still, turning))
    assert b[2] == pytest.approx(math.pi / 0.5 + 0.02, abs=0.05)
    assert b[[0, 1, 3]] == pytest.approx(a[[0, 1, 3]], abs=0.7)
    turn = fly_run(State.at_rest(np.zeros(3)), 0.0, 0.0, [Via(np.zeros(3), 1.0)], lim)
    assert turn.duration_s == pytest.approx(2.02)


def test_a_run_begins_at_rest() -> None:
    moving = State(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.zeros(3))
    with pytest.raises(ValueError, match="at rest"):
        fly_run(moving, 0.0, 0.0, [Via(np.ones(3), 0.0)], Limits(3.0, 2.0, 6.0))
