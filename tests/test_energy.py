"""The power model, its fit to a published multirotor, and what motion takes out of a battery."""

from __future__ import annotations

import itertools

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.errors import UserError
from missions.mission import AirframeSpec, Mission
from planning.trajectories import Curve, Limits, State, Via, fly_run, leg_time_s
from planning.trajectories.energy import DistanceEnergy, PowerEnergy, energy_of
from planning.trajectories.power import GRAVITY_M_S2, PowerModel, fit, induced_m_s, published

AIRFRAME = AirframeSpec()
MODEL = fit(AIRFRAME)
STILL = np.zeros(3)
CAPACITY_J = 3600.0 * AIRFRAME.battery_wh
speeds = st.tuples(*[st.floats(-12.0, 12.0)] * 3).map(np.array)
accelerations = st.tuples(*[st.floats(-4.0, 4.0)] * 3).map(np.array)
winds = st.tuples(st.floats(-8.0, 8.0), st.floats(-8.0, 8.0), st.floats(-1.0, 1.0))


def straight(displacement_m: np.ndarray) -> Curve:
    return fly_run(State.at_rest(np.zeros(3)), 0.0, 0.0, [Via(displacement_m, 0.0)], Limits(3.0, 2.0, 6.0)).curve


def energy(wind: tuple[float, float, float] = (0.0, 0.0, 0.0), **airframe: float) -> PowerEnergy:
    mission = msgspec.convert({"title": "t", "wind": {"velocity_enu_m_s": wind}, "airframe": airframe}, Mission)
    found = energy_of(mission)
    assert isinstance(found, PowerEnergy)
    return found


def test_the_three_published_flights_last_as_long_as_published() -> None:
    speed, watts = published(AIRFRAME)
    np.testing.assert_allclose(MODEL.cruise_w(speed), watts, rtol=1e-6)
    assert CAPACITY_J / float(MODEL.cruise_w(0.0)) == pytest.approx(30 * 60, rel=1e-6)
    assert CAPACITY_J / float(MODEL.cruise_w(6.0)) == pytest.approx(34 * 60, rel=1e-6)


def test_the_published_speeds_are_the_models_best_ones() -> None:
    """The fit uses times alone: that these are the longest and the farthest flight is its prediction."""
    speed = np.linspace(0.5, 15.0, 1451)
    watts = MODEL.cruise_w(speed)
    assert speed[watts.argmin()] == pytest.approx(AIRFRAME.endurance_m_s, rel=0.03)
    assert speed[(watts / speed).argmin()] == pytest.approx(AIRFRAME.range_m_s, rel=0.03)


def test_the_model_draws_the_curve_of_its_source() -> None:
    """Zeng, Xu and Zhang 2019, level flight with their constants; they neglect the tilt that drag asks for."""
    weight, disk, solidity, tip, profile, induced, hover = 20.0, 0.503, 0.05, 120.0, 79.86, 88.63, 4.03
    v = np.linspace(0.0, 25.0, 26)
    theirs = (profile * (1.0 + 3.0 * v**2 / tip**2)
              + induced * np.sqrt(np.sqrt(1.0 + v**4 / (4.0 * hover**4)) - v**2 / (2.0 * hover**2))
              + 0.5 * 0.6 * 1.225 * solidity * disk * v**3)
    mass = weight / GRAVITY_M_S2
    ours = PowerModel(mass, mass, disk, 0.0, profile, 1.0, 0.6 * solidity * disk, tip).cruise_w(v)
    np.testing.assert_allclose(ours, theirs, rtol=0.03)
    np.testing.assert_allclose(ours[:11], theirs[:11], rtol=0.003)


def test_the_fit_finds_the_constants_of_another_airframe() -> None:
    heavy = AirframeSpec(mass_kg=0.895, battery_wh=77.0, rotor_diameter_m=0.239, hover_min=38.0, endurance_min=43.0,
                         endurance_m_s=9.0, range_km=28.0, range_m_s=14.0, base_load_w=10.0)
    speed, watts = published(heavy)
    np.testing.assert_allclose(fit(heavy).cruise_w(speed), watts, rtol=1e-6)


@pytest.mark.parametrize("wrong", [{"base_load_w": 60.0}, {"range_km": 60.0}, {"endurance_min": 20.0}])
def test_figures_that_contradict_each_other_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UserError, match="airframe: no power model"):
        fit(AirframeSpec(**wrong))  # type: ignore[arg-type]


@given(st.floats(1.0, 60.0), st.floats(-12.0, 25.0), st.floats(0.0, 500.0))
def test_induced_velocity_solves_its_equation(hover2: float, through: float, along2: float) -> None:
    v = float(induced_m_s(np.array(hover2), np.array(through), np.array(along2)))
    flow = max(through, -np.sqrt(hover2))
    assert v * v * (along2 + (flow + v) ** 2) == pytest.approx(hover2**2, rel=1e-6)


@given(speeds, accelerations, winds)
def test_power_is_never_below_the_base_load(velocity: np.ndarray, acceleration: np.ndarray, wind: object) -> None:
    assert float(MODEL.power_w(velocity, acceleration, np.array(wind))) >= AIRFRAME.base_load_w


@given(speeds, accelerations, winds, st.floats(0.0, 0.2), st.floats(0.005, 0.2))
def test_more_payload_hovers_and_cruises_on_more_power(velocity: np.ndarray, acceleration: np.ndarray, wind: object,
                                                       payload: float, more: float) -> None:
    light, heavy = (fit(AirframeSpec(payload_kg=p)) for p in (payload, payload + more))
    level = velocity * [1.0, 1.0, 0.0]
    assert np.all(heavy.cruise_w(np.linspace(0.0, 12.0, 25)) > light.cruise_w(np.linspace(0.0, 12.0, 25)))
    assert float(heavy.power_w(level, STILL, STILL)) > float(light.power_w(level, STILL, STILL))


@given(speeds, accelerations, winds)
def test_only_the_motion_through_the_air_counts(velocity: np.ndarray, acceleration: np.ndarray, wind: object) -> None:
    there = MODEL.power_w(velocity + np.array(wind), acceleration, np.array(wind))
    np.testing.assert_allclose(there, MODEL.power_w(velocity, acceleration, STILL), rtol=1e-9)


@given(st.floats(7.0, 12.0), st.floats(0.5, 6.0))
def test_above_the_best_speed_a_headwind_costs_more_than_a_tailwind(speed: float, wind: float) -> None:
    there = np.array([speed, 0.0, 0.0])
    head, tail = (float(MODEL.power_w(there, STILL, np.array([w, 0.0, 0.0]))) for w in (-wind, wind))
    assert head > tail


def test_a_round_trip_in_strong_wind_costs_more_than_in_still_air() -> None:
    ends = np.array([[40.0, 0.0, 0.0], [-40.0, 0.0, 0.0]])
    trips = [energy((wind, 0.0, 0.0)).leg_percent(ends, np.full(2, 40.0), np.full(2, 20.0)) for wind in (0.0, 9.0)]
    assert trips[1].sum() > trips[0].sum()
    assert trips[1][1] > 1.2 * trips[1][0]


def test_climbing_costs_what_lifting_takes_and_descending_gives_some_back() -> None:
    up, rest, down = (float(MODEL.power_w(np.array([0.0, 0.0, v]), STILL, STILL)) for v in (1.5, 0.0, -1.5))
    assert down < rest < up
    assert up - rest > 0.5 * MODEL.mass_kg * GRAVITY_M_S2 * 1.5
    assert up + down > 2.0 * rest


def test_tilting_to_speed_up_costs_more_than_to_slow_down() -> None:
    speed = np.array([3.0, 0.0, 0.0])
    watts = [float(MODEL.power_w(speed, np.array([a, 0.0, 0.0]), STILL)) for a in (2.0, 0.0, -2.0)]
    assert watts[0] > watts[1] > watts[2]


@settings(max_examples=30)
@given(st.lists(st.floats(0.0, 12.0), max_size=12), st.sampled_from([(0.0, 0.0, 0.0), (5.0, -3.0, 0.0)]))
def test_consumption_is_the_same_wherever_a_flight_is_cut(cuts: list[float], wind: tuple[float, float, float]) -> None:
    curve = straight(np.array([17.0, 6.0, 4.0]))
    found = energy(wind)
    at = [0.0, *sorted(cuts), 12.0]
    parts = sum(found.curve_percent(curve, a, b) for a, b in itertools.pairwise(at))
    assert parts == pytest.approx(found.curve_percent(curve, 0.0, 12.0), rel=1e-6)
    t = np.linspace(0.0, 12.0, 24_001)
    _, velocity, acceleration = curve.at(t)
    joules = np.trapezoid(found.model.power_w(velocity, acceleration, found.wind_enu_m_s), t)
    assert parts == pytest.approx(100.0 * joules / found.battery_j, rel=1e-4)


def test_hovering_empties_the_battery_in_the_published_time() -> None:
    assert energy().rest_percent(30 * 60) == pytest.approx(100.0)
    assert energy().curve_percent(Curve.hold(np.zeros(3), 30 * 60)) == pytest.approx(100.0)
    assert energy(payload_kg=0.05).rest_percent(30 * 60) > 110.0


@given(st.tuples(*[st.floats(-40.0, 40.0)] * 3).map(np.array), st.sampled_from([(0.0, 0.0, 0.0), (5.0, -3.0, 0.0)]))
def test_tabulated_legs_are_the_flown_ones(displacement: np.ndarray, wind: tuple[float, float, float]) -> None:
    found = energy(wind)
    length = np.linalg.norm(displacement)
    curve = straight(displacement)
    told = found.leg_percent(displacement, length, leg_time_s(length, found.limits))
    assert float(told) == pytest.approx(found.curve_percent(curve), rel=0.01, abs=1e-3)


@settings(max_examples=15)
@given(st.integers(0, 1000), st.sampled_from([2.0, 4.0, 10.0]), st.sampled_from([(0.0, 0.0, 0.0), (5.0, 3.0, 0.0)]))
def test_legs_add_up_to_blended_tours(seed: int, step_m: float, wind: tuple[float, float, float]) -> None:
    """The allocation reckons with legs from the table and their seconds; the vehicle flies the whole run."""
    found, rng = energy(wind), np.random.default_rng(seed)
    points = np.concatenate([np.zeros((1, 3)), np.cumsum(step_m * rng.normal(0.0, 0.5, (20, 3)), axis=0)])
    vias = [Via(p, 0.0, stop=n == 19, pass_m=0.25, speed_m_s=2.0) for n, p in enumerate(points[1:])]
    flight = fly_run(State.at_rest(points[0]), 0.0, 0.0, vias, found.limits)
    legs = np.diff(points, axis=0)
    told = found.leg_percent(legs, np.linalg.norm(legs, axis=1), np.diff(flight.reached_s, prepend=0.0))
    assert told.sum() == pytest.approx(found.curve_percent(flight.curve), rel=0.02)


def test_time_beyond_the_leg_is_hovered() -> None:
    found = energy()
    leg = np.array([10.0, 0.0, 0.0])
    least = leg_time_s(10.0, found.limits)
    told = found.leg_percent(np.stack([leg, leg]), np.full(2, 10.0), np.array([least, least + 7.0]))
    assert told[1] - told[0] == pytest.approx(found.rest_percent(7.0))


@given(st.tuples(*[st.floats(-40.0, 40.0)] * 3).map(np.array), st.floats(0.0, 2.0))
def test_by_distance_a_flight_costs_its_length(displacement: np.ndarray, rate: float) -> None:
    found = DistanceEnergy(rate)
    length = float(np.linalg.norm(displacement))
    curve = straight(displacement)
    assert found.curve_percent(curve) == pytest.approx(rate * length, abs=1e-6)
    assert float(found.leg_percent(displacement, np.array(length), np.array(1.0))) == pytest.approx(rate * length)
    assert found.rest_percent(1e6) == 0.0
