"""Laws of straight motion: limits hold, ends are met, straight stays straight, nothing jumps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.mission import FleetSpec
from planning.trajectories import Curve, Limits, State, Via, fly_run, leg_time_s, shutter_speed_m_s
from planning.trajectories.leg import brake

coordinate = st.floats(-60.0, 60.0)
points = st.tuples(coordinate, coordinate, coordinate).map(np.array)
limits = st.builds(Limits, st.floats(0.5, 8.0), st.floats(0.5, 5.0), st.floats(1.0, 20.0), st.floats(0.3, 3.0))
share = st.floats(0.0, 1.0)


def leg(a: np.ndarray, b: np.ndarray, lim: Limits) -> Curve:
    """From rest to rest."""
    return fly_run(State.at_rest(a), 0.0, 0.0, [Via(b, 0.0)], lim).curve


def off_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of points (n, 3) from the segment ab."""
    f = np.clip((p - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(p - a - f[:, None] * (b - a), axis=1).max())


@given(points, points, limits)
@settings(max_examples=150, deadline=None)
def test_a_leg_between_rests_keeps_limits_and_segment(a: np.ndarray, b: np.ndarray, lim: Limits) -> None:
    curve = leg(a, b, lim)
    p, v, acceleration = curve.at(np.linspace(0.0, curve.duration_s, 400))
    assert np.linalg.norm(v, axis=1).max() <= lim.speed_m_s * (1 + 1e-6)
    assert np.linalg.norm(acceleration, axis=1).max() <= lim.acceleration_m_s2 * (1 + 1e-6)
    assert off_segment(p, a, b) < 1e-6
    end = curve.state(curve.duration_s)
    assert np.linalg.norm(end.position - b) < 1e-6
    assert not np.abs(end.velocity).max() > 1e-6
    assert curve.duration_s == pytest.approx(float(leg_time_s(np.linalg.norm(b - a), lim)), rel=1e-6, abs=1e-4)


@given(points, points, limits, share)
@settings(max_examples=100, deadline=None)
def test_braking_stays_on_the_line_and_within_the_stopping_distance(a: np.ndarray, b: np.ndarray, lim: Limits,
                                                                    when: float) -> None:
    curve = leg(a, b, lim)
    state = curve.state(when * curve.duration_s)
    stop = brake(state, lim)
    end = stop.state(stop.duration_s)
    assert np.abs(end.velocity).max() < 1e-6
    assert np.abs(end.acceleration).max() < 1e-6
    longest = lim.stopping_distance_m + lim.speed_m_s * lim.acceleration_m_s2 / lim.jerk_m_s3
    assert np.linalg.norm(end.position - state.position) <= longest + 1e-6
    assert off_segment(stop.sample(0.05)[1], a, b) < 1e-6


@given(points, points, limits, share, share)
@settings(max_examples=50, deadline=None)
def test_a_part_of_a_curve_is_the_curve(a: np.ndarray, b: np.ndarray, lim: Limits, one: float, other: float) -> None:
    curve = leg(a, b, lim)
    begin, end = sorted((one * curve.duration_s, other * curve.duration_s))
    part = curve.part(begin, end)
    t = np.linspace(0.0, end - begin, 50)
    for mine, whole in zip(part.at(t), curve.at(t + begin), strict=True):
        np.testing.assert_allclose(mine, whole, atol=1e-9)


def test_limits_of_a_typical_vehicle() -> None:
    lim = Limits.of_fleet(FleetSpec(speed_m_s=3.0, acceleration_m_s2=2.0, jerk_m_s3=6.0))
    assert lim.stopping_distance_m == pytest.approx(2.75)
    assert leg_time_s(np.array([0.0, 50.0]), lim) == pytest.approx([0.0, 18.5])


def test_velocity_and_acceleration_must_be_parallel() -> None:
    state = State(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    with pytest.raises(ValueError, match="parallel"):
        brake(state, Limits(3.0, 2.0, 6.0))


@given(st.floats(0.5, 50.0), st.floats(200.0, 4000.0), st.floats(1e-4, 0.02), st.floats(0.1, 3.0), st.floats(1e-3, 0.1))
def test_at_shutter_speed_blur_and_ground_sample_are_kept_and_one_is_used_up(
        distance: float, focal: float, exposure: float, blur: float, gsd: float) -> None:
    v = shutter_speed_m_s(distance, focal, exposure, blur, gsd)
    shares = np.array([v * exposure * focal / distance / blur, v * exposure / gsd])
    assert shares.max() == pytest.approx(1.0)


def test_no_code_uses_the_waypoint_mode_that_calls_a_cloud_service() -> None:
    forbidden = "intermediate" + "_positions"
    root = Path(__file__).resolve().parents[1]
    rooms = ("missions", "planning", "perception", "vehicle", "sim_bridge", "ground_station")
    files = [f for room in rooms for f in (root / room).rglob("*.py")]
    assert len(files) > 50
    assert [f.name for f in files if forbidden in f.read_text(encoding="utf-8")] == []
