"""What is wrong: read off the sensors, the teammates and the clock; and how long it counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from missions.frames import Array
from missions.messages import AnnouncedTrajectory, RangeScan, VehicleState
from missions.mission import Mission
from missions.sensors import RANGE_DIRECTIONS
from planning.trajectories import Limits, State
from tests.vehicle_world import NS, SITE
from vehicle.condition import Condition, peers, triggers
from vehicle.failsafe import CLEAR_S, FLAPS, Failsafe
from vehicle.failsafe_table import Action, Trigger
from vehicle.geofence import stopping_distance_m
from vehicle.health import HEALTHY, Health
from vehicle.lookout import STEADY_NS
from vehicle.settings import Settings
from vehicle.simulator import Kinematics
from vehicle.teammates import Teammates
from vehicle.vehicle import Vehicle

MISSION = msgspec.convert({"title": "test", "fleet": {"vehicles": 2}}, Mission)
SETTINGS = Settings.of(MISSION)
WELL = Condition(0, 80.0, 3.0, 1.0, 0, True)
LIMITS = Limits(3.0, 2.0, 6.0)
WRONG: dict[Trigger, Condition] = {
    Trigger.ENERGY_GONE: replace(WELL, battery_percent=9.0, least_home_percent=9.0),
    Trigger.BATTERY_EMERGENCY: replace(WELL, battery_percent=2.0),
    Trigger.POSITION_INVALID: replace(WELL, health=Health(position_valid=False)),
    Trigger.FENCE_BREACHED: replace(WELL, fence_room_m=-0.01),
    Trigger.ENERGY_HOME: replace(WELL, battery_percent=30.0, home_percent=25.0),
    Trigger.BATTERY_CRITICAL: replace(WELL, battery_percent=5.0),
    Trigger.FENCE_AHEAD: replace(WELL, stops_inside=False), Trigger.PEER_CLOSE: replace(WELL, peer_close=True),
    Trigger.BATTERY_LOW: replace(WELL, battery_percent=20.0),
    Trigger.RANGE_BLIND: replace(WELL, range_silent_s=1.1), Trigger.PLAN_INVALID: replace(WELL, plan_valid=False),
    Trigger.CLOCK_JUMP: replace(WELL, clock_jumped=True),
    Trigger.CARD_TROUBLE: replace(WELL, card_troubled=True),
    Trigger.BATTERY_UNKNOWN: replace(WELL, health=Health(battery_known=False)),
    Trigger.GROUND_LOST: replace(WELL, t_ns=31 * NS, ground_takes_part=False)}


def test_a_healthy_vehicle_has_no_trigger_and_every_trigger_has_its_cause() -> None:
    assert triggers(WELL, SETTINGS) == frozenset()
    for trigger, condition in WRONG.items():
        assert trigger in triggers(condition, SETTINGS), trigger
    assert set(WRONG) == set(Trigger)


@pytest.mark.parametrize("level", [float("nan"), float("inf"), -1.0])
def test_a_charge_that_cannot_be_is_unknown_and_never_full(level: float) -> None:
    assert Trigger.BATTERY_UNKNOWN in triggers(replace(WELL, battery_percent=level), SETTINGS)


def test_a_fence_distance_that_is_no_number_is_a_breach() -> None:
    assert Trigger.FENCE_BREACHED in triggers(replace(WELL, fence_room_m=float("nan")), SETTINGS)


@given(st.floats(0.0, 100.0), st.floats(0.0, 100.0), st.floats(0.0, 50.0))
def test_less_charge_is_never_less_wrong(a: float, b: float, home: float) -> None:
    low, high = (replace(WELL, battery_percent=level, home_percent=home, least_home_percent=0.3 * home)
                 for level in sorted((a, b)))
    assert triggers(low, SETTINGS) >= triggers(high, SETTINGS)


def mate(position: Array, velocity: Array, announced: Array | None) -> Teammates:
    """Vehicle 2 in flight at 1 s, which said that it would be elsewhere."""
    mates = Teammates(1)
    mates.hear(VehicleState(
        vehicle_id=2, t_ns=NS, position_enu_m=tuple(position.tolist()), velocity_enu_m_s=tuple(velocity.tolist()),
        acceleration_enu_m_s2=(0.0, 0.0, 0.0), yaw_enu_rad=0.0, gimbal_elevation_rad=0.0, battery_percent=50.0,
        flying=True, mode="mission"))
    if announced is not None:
        mates.hear(AnnouncedTrajectory(vehicle_id=2, t_start_ns=0, step_ns=200_000_000,
                                       positions_enu_m=[tuple(announced.tolist())]))
    return mates


def here(velocity: Array) -> Kinematics:
    return Kinematics(State(np.zeros(3), velocity, np.zeros(3)), 0.0, 0.0)


velocities = arrays(np.float64, 3, elements=st.floats(-3.0, 3.0))


@given(velocities, velocities, arrays(np.float64, 3, elements=st.floats(-15.0, 15.0)))
def test_a_teammate_that_left_its_way_is_noticed_while_both_can_still_stop(own: Array, theirs: Array,
                                                                          place: Array) -> None:
    mates = list(mate(place, theirs, place + 1.0).members.values())
    peer = peers(here(own), mates, 2.0, 2.5, LIMITS)
    gap = float(np.linalg.norm(place))
    if not peer.close:
        toward = place / gap
        ways = sum(stopping_distance_m(max(0.0, v), LIMITS) for v in (own @ toward, -theirs @ toward) if v > 0.0)
        assert gap - ways >= 2.5 - 1e-9
    assert peer.close or not peer.closing


@given(velocities, velocities, arrays(np.float64, 3, elements=st.floats(-15.0, 15.0)))
def test_a_teammate_that_keeps_its_word_is_only_too_close_when_it_is(own: Array, theirs: Array, place: Array) -> None:
    mates = list(mate(place, theirs, place).members.values())
    assert peers(here(own), mates, 2.0, 2.5, LIMITS).close is bool(np.linalg.norm(place) < 2.0)


@pytest.fixture
def vehicle(tmp_path: Path) -> Vehicle:
    return Vehicle(MISSION, SITE, 1, tmp_path)


def look(vehicle: Vehicle, t_s: float, health: Health = HEALTHY, ground: bool = True) -> Condition:
    return vehicle.lookout.look(round(t_s * NS), SETTINGS, health, ground)


def test_a_clock_that_stood_still_makes_no_silence(vehicle: Vehicle) -> None:
    vehicle.lookout.hear_ground(0)
    assert not look(vehicle, 5.0, ground=False).clock_jumped
    jumped = look(vehicle, 3605.0, ground=False)
    assert jumped.clock_jumped
    assert Trigger.GROUND_LOST not in triggers(jumped, SETTINGS)
    late = [look(vehicle, 3605.0 + s, ground=False) for s in np.arange(0.5, 40.0, 0.5)]
    assert not late[round(2 * STEADY_NS / NS)].clock_jumped
    lost = [Trigger.GROUND_LOST in triggers(c, SETTINGS) for c in late]
    assert 25.0 < 0.5 * (1 + lost.index(True)) <= 31.0, "from the jump on silence counts as before"


@pytest.mark.parametrize(("offsets", "jumped"), [([0.0, 0.0], False), ([7.0, 7.0], False), ([0.0, 0.4], False),
                                                 ([0.0, 3600.0], True), ([3600.0, 0.0], True)])
def test_only_a_change_of_the_clock_against_monotonic_time_is_a_jump(offsets: list[float], jumped: bool,
                                                                     vehicle: Vehicle) -> None:
    conditions = [look(vehicle, 0.1 * n, Health(utc_offset_s=o)) for n, o in enumerate(offsets)]
    assert conditions[-1].clock_jumped is jumped


def test_a_clock_that_goes_back_is_a_jump(vehicle: Vehicle) -> None:
    look(vehicle, 50.0)
    assert look(vehicle, 20.0).clock_jumped


@pytest.mark.parametrize("broken", ["nan ranges", "nan position", "old"])
def test_a_scan_that_says_nothing_is_no_scan(broken: str, vehicle: Vehicle) -> None:
    vehicle.executor.mode = "mission"
    ranges = [3.0] * len(RANGE_DIRECTIONS)
    scan = RangeScan(vehicle_id=1, t_ns=10 * NS, position_enu_m=(0.0, 0.0, 5.0), ranges_m=ranges)
    assert vehicle.lookout.take_scan(scan)
    assert look(vehicle, 10.5).range_silent_s == pytest.approx(0.5)
    changes = {"nan ranges": {"ranges_m": [float("nan"), *ranges[1:]]}, "old": {"t_ns": 9 * NS},
               "nan position": {"position_enu_m": (float("nan"), 0.0, 5.0)}}[broken]
    vehicle.lookout.take_scan(msgspec.structs.replace(scan, **{"t_ns": 12 * NS, **changes}))
    assert look(vehicle, 12.5).range_silent_s == pytest.approx(2.5)


@given(st.lists(st.tuples(st.sampled_from(sorted(WRONG, key=lambda t: t.value)), st.floats(0.1, 1.0)), max_size=60))
def test_in_any_history_the_failsafe_asks_for_the_worst_that_is_wrong(history: list[tuple[Trigger, float]]) -> None:
    """Through the whole machine, on a vehicle that obeys only in mode: what is decided is never milder than what the
    trigger of the moment asks for from its first step on."""
    vehicle = Vehicle(MISSION, SITE, 1, Path())
    failsafe, executor, t_ns = Failsafe(SETTINGS), vehicle.executor, 0
    executor.mode = "mission"
    for trigger, seconds in history:
        t_ns += round(seconds * NS)
        condition = WRONG[trigger]
        heard = t_ns - 40 * NS if trigger is Trigger.GROUND_LOST else t_ns
        failsafe.step(replace(condition, t_ns=t_ns, ground_heard_ns=heard), executor)
        first = SETTINGS.steps(trigger)[0]
        if first.after_s == 0.0:
            assert failsafe.decision.action >= first.action or not executor.flying
        assert trigger in failsafe.active
        if failsafe.decision.action >= Action.LAND:
            assert executor.mode == "emergency"
        elif failsafe.decision.action is Action.RETURN:
            assert executor.mode in ("return", "emergency")
        elif failsafe.decision.action is Action.HOLD:
            assert executor.mode in ("hold", "return", "emergency")


def test_it_counts_until_it_has_been_quiet_and_a_flicker_does_not_start_it_anew() -> None:
    vehicle = Vehicle(MISSION, SITE, 1, Path())
    failsafe, executor = Failsafe(SETTINGS), vehicle.executor
    executor.mode = "mission"
    decided = []
    for n in range(200):
        lost = n % 5 != 0
        condition = WRONG[Trigger.POSITION_INVALID] if lost else WELL
        failsafe.step(replace(condition, t_ns=n * NS // 10), executor)
        decided.append(failsafe.decision.action)
    assert decided[20] is Action.HOLD
    assert decided[-1] is Action.LAND, "four fifths of the time without a position are as bad as all of it"
    quiet = round(CLEAR_S * 10) + 1
    for n in range(200, 200 + quiet):
        failsafe.step(replace(WELL, t_ns=n * NS // 10), executor)
    assert failsafe.active == frozenset()
    assert executor.mode == "emergency", "a landing is not taken back"
    assert FLAPS == 3
