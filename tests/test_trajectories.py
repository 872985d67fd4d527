"""Laws of jerk-limited motion: limits hold, ends are met, straight stays straight, nothing jumps."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.trajectories import Flight, Leg, Limits, State, Via, brake, fly_route, fly_run, leg_time_s, straight_run

coordinate = st.floats(-60.0, 60.0)
points = st.tuples(coordinate, coordinate, coordinate).map(np.array)
limits = st.builds(Limits, st.floats(0.5, 8.0), st.floats(0.5, 5.0), st.floats(1.0, 20.0), st.floats(0.3, 3.0))
share = st.floats(0.0, 1.0)


def norms(curve: Leg, step_s: float = 0.02) -> tuple[float, float]:
    """Largest speed and acceleration on a curve."""
    _, v, a = curve.at(np.arange(0.0, curve.duration_s + step_s, step_s))
    return float(np.linalg.norm(v, axis=1).max()), float(np.linalg.norm(a, axis=1).max())


def off_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of points (n, 3) from the segment ab."""
    f = np.clip((p - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(p - a - f[:, None] * (b - a), axis=1).max())


@given(points, points, limits)
@settings(max_examples=150, deadline=None)
def test_a_leg_between_rests_keeps_limits_and_segment(a: np.ndarray, b: np.ndarray, lim: Limits) -> None:
    leg = Leg(State.at_rest(a), b, lim)
    speed, acceleration = norms(leg)
    assert speed <= lim.speed_m_s * (1 + 1e-6)
    assert acceleration <= lim.acceleration_m_s2 * (1 + 1e-6)
    _, p = leg.sample(0.05)
    assert off_segment(p, a, b) < 1e-3
    end = leg.state(leg.duration_s)
    assert np.linalg.norm(end.position - b) < 1e-5
    assert not np.abs(end.velocity).max() > 1e-6
    assert leg.duration_s == pytest.approx(float(leg_time_s(np.linalg.norm(b - a), lim)), rel=1e-6, abs=1e-4)


@given(points, points, points, limits, share)
@settings(max_examples=100, deadline=None)
def test_a_leg_from_any_moment_of_another_is_continuous(a: np.ndarray, b: np.ndarray, c: np.ndarray, lim: Limits,
                                                        when: float) -> None:
    first = Leg(State.at_rest(a), b, lim)
    state = first.state(when * first.duration_s)
    second = Leg(state, c, lim)
    for was, now in zip((state.position, state.velocity, state.acceleration), second.at(0.0), strict=True):
        assert np.abs(was - now).max() < 1e-6
    assert np.linalg.norm(second.end - c) < 1e-4
    speed, acceleration = norms(second)
    assert speed <= lim.speed_m_s * (1 + 1e-5)
    assert acceleration <= lim.acceleration_m_s2 * (1 + 1e-5)


@given(points, points, limits, share)
@settings(max_examples=100, deadline=None)
def test_braking_stays_on_the_line_and_within_the_stopping_distance(a: np.ndarray, b: np.ndarray, lim: Limits,
                                                                    when: float) -> None:
    leg = Leg(State.at_rest(a), b, lim)
    state = leg.state(when * leg.duration_s)
    stop = brake(state, lim)
    end = stop.state(stop.duration_s)
    assert np.abs(end.velocity).max() < 1e-6
    assert np.abs(end.acceleration).max() < 1e-6
    longest = lim.stopping_distance_m + lim.speed_m_s * lim.acceleration_m_s2 / lim.jerk_m_s3
    assert np.linalg.norm(end.position - state.position) <= longest + 1e-6
    assert off_segment(stop.sample(0.05)[1], a, b) < 1e-3


@given(points, points, limits)
@settings(max_examples=50, deadline=None)
def test_pieces_join_without_a_jump(a: np.ndarray, b: np.ndarray, lim: Limits) -> None:
    leg = Leg(State.at_rest(a), b, lim)
    t = np.linspace(0.0, leg.duration_s, 400)
    p, v, acc = leg.at(t)
    dt = t[1] - t[0]
    assert np.linalg.norm(np.diff(p, axis=0), axis=1).max() <= lim.speed_m_s * dt * (1 + 1e-6) + 1e-9
    assert np.linalg.norm(np.diff(v, axis=0), axis=1).max() <= lim.acceleration_m_s2 * dt * (1 + 1e-6) + 1e-9
    assert np.linalg.norm(np.diff(acc, axis=0), axis=1).max() <= lim.jerk_m_s3 * dt * (1 + 1e-6) + 1e-9


@given(st.lists(points, min_size=1, max_size=6), points, limits)
@settings(max_examples=60, deadline=None)
def test_a_route_passes_its_waypoints_within_the_limits(vias: list[np.ndarray], start: np.ndarray,
                                                        lim: Limits) -> None:
    route = [Via(p, float(n), -0.2 * n, stop=n % 2 == 0, settle_s=0.2) for n, p in enumerate(vias)]
    flight = fly_route(State.at_rest(start), 0.0, 0.0, route, lim)
    for via, t in zip(route, flight.reached_s, strict=True):
        assert np.linalg.norm(flight.curve.at(t)[0] - via.position) < 0.06
    assert np.all(np.diff(flight.reached_s) >= 0.0)
    speed, _ = norms(flight.curve)  # type: ignore[arg-type]
    assert speed <= lim.speed_m_s * (1 + 1e-6)
    assert turn_rate(flight) <= lim.slew_rad_s * (1 + 1e-6)
    yaw, elevation = flight.attitude(flight.duration_s)
    assert math.cos(yaw - route[-1].yaw_rad) > 1 - 1e-9
    assert elevation == pytest.approx(route[-1].elevation_rad)


def turn_rate(flight: Flight) -> float:
    """Largest rate of yaw or elevation between knots."""
    dt = np.diff(flight.turn_s)
    moves = np.maximum(np.abs(np.diff(flight.yaw_rad)), np.abs(np.diff(flight.elevation_rad)))
    return float(np.max(moves[dt > 1e-9] / dt[dt > 1e-9], initial=0.0))


def test_waypoints_on_a_line_are_passed_at_speed_and_corners_are_not() -> None:
    lim = Limits(3.0, 2.0, 6.0, 1.0)
    line = [Via(np.array([x, 0.0, 5.0]), 0.0, stop=x == 20.0) for x in (5.0, 10.0, 15.0, 20.0)]
    corner = Via(np.array([20.0, 8.0, 5.0]), 0.0)
    assert straight_run(np.array([0.0, 0.0, 5.0]), [*line, corner]) == 4
    flight = fly_run(State.at_rest(np.array([0.0, 0.0, 5.0])), 0.0, 0.0, line, lim)
    speeds = np.linalg.norm(flight.curve.at(flight.reached_s)[1], axis=1)
    assert speeds[:3].min() > 2.0
    assert speeds[3] == pytest.approx(0.0, abs=1e-9)
    bent = [Via(np.array([5.0, 1.0, 5.0]), 0.0, stop=False), corner]
    assert straight_run(np.zeros(3), bent) == 1


def test_a_run_is_stretched_until_the_camera_has_turned() -> None:
    lim = Limits(3.0, 2.0, 6.0, 0.5)
    flight = fly_run(State.at_rest(np.zeros(3)), 0.0, 0.0, [Via(np.array([2.0, 0.0, 0.0]), math.pi / 2)], lim)
    assert flight.reached_s[-1] == pytest.approx(math.pi / 2 / 0.5, rel=0.01)
    assert flight.attitude(flight.reached_s[-1])[0] == pytest.approx(math.pi / 2)


def test_limits_of_a_typical_vehicle() -> None:
    lim = Limits(3.0, 2.0, 6.0)
    assert lim.stopping_distance_m == pytest.approx(2.75)
    assert leg_time_s(np.array([0.0, 50.0]), lim) == pytest.approx([0.0, 18.5])


def test_velocity_and_acceleration_must_be_parallel() -> None:
    state = State(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    with pytest.raises(ValueError, match="parallel"):
        brake(state, Limits(3.0, 2.0, 6.0))


def test_no_code_uses_the_waypoint_mode_that_calls_a_cloud_service() -> None:
    forbidden = "intermediate" + "_positions"
    root = Path(__file__).resolve().parents[1]
    rooms = ("missions", "planning", "perception", "vehicle", "sim_bridge", "ground_station")
    files = [f for room in rooms for f in (root / room).rglob("*.py")]
    assert len(files) > 50
    assert [f.name for f in files if forbidden in f.read_text(encoding="utf-8")] == []
