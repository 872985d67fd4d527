"""Who has control of a real aircraft: persons, failsafes, dead processes, stopped clocks, bad wires."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from missions.frames import Array
from planning.deconflict import distance_to_polyline_m
from tests.autopilot_stub import AutopilotStub
from tests.autopilot_world import AutopilotWorld
from tests.test_companion_flight import KINDS, flown, world_of
from tests.vehicle_world import NS, route
from vehicle.simulator import resting

LEGS = [(0, -8, 5), (12, -8, 5), (12, -12, 9), (-8, -12, 5)]
PERSONS_MODE = {"px4": "POSCTL", "ardupilot": "STABILIZE"}


def under_way(tmp_path: Path, kind: str, **options: float) -> AutopilotWorld:
    """A vehicle in the middle of its second leg."""
    world = world_of(tmp_path, kind, **options)
    world.upload(route(LEGS), 1)
    assert world.run(90, lambda: world.views() == [100] and world.stub_enu(1)[0] > 4.0)
    return world


def texts(world: AutopilotWorld, k: int = 1) -> list[str]:
    return [m.text for m in world.mavlink[k] if m.get_type() == "STATUSTEXT"]


def orders(stub: AutopilotStub) -> list[int]:
    """All that it was commanded, but for what it shall tell."""
    return [c for c in stub.commands if c != mav.MAV_CMD_SET_MESSAGE_INTERVAL]


@pytest.mark.parametrize("kind", KINDS)
def test_a_person_who_changes_the_mode_is_not_fought(tmp_path: Path, kind: str) -> None:
    world = under_way(tmp_path, kind)
    stub = world.attached[1].stub
    stub._set_mode(PERSONS_MODE[kind])
    world.run(0.3)
    before = stub.setpoints, orders(stub)
    world.run(30)
    assert (stub.setpoints, orders(stub)) == before
    assert stub.mode == PERSONS_MODE[kind]
    assert any(text.startswith("control given up: mode changed to") for text in texts(world))
    assert {r.view_id: r.outcome for r in world.reports} == dict.fromkeys((101, 102, 103), "unreachable")
    assert world.states[1][-1].mode == "emergency"
    stub._set_mode("LAND")  # the person lands it
    assert world.run(40, world.landed)
    assert world.states[1][-1].mode in ("emergency", "standby")


def test_teammates_are_told_where_a_person_takes_the_aircraft(tmp_path: Path) -> None:
    world = under_way(tmp_path, "px4")
    stub = world.attached[1].stub
    stub._set_mode("POSCTL")
    stub.air.wind = np.array([0.0, 2.0, 0.0])
    world.run(10)
    body = world.vehicles[1].body
    assert np.linalg.norm(body.at(world.t_ns).state.position - world.stub_enu(1)) < 1.5
    assert np.linalg.norm(np.subtract(world.states[1][-1].position_enu_m, world.stub_enu(1))) < 0.3


@pytest.mark.parametrize("kind", KINDS)
def test_after_a_person_has_landed_it_the_aircraft_can_be_sent_out_again(tmp_path: Path, kind: str) -> None:
    world = under_way(tmp_path, kind)
    stub = world.attached[1].stub
    stub._set_mode("RTL")
    assert world.run(60, world.landed)
    world.run(1)
    world.upload(route(LEGS[:1], plan_id=2, first_view=200, home_after=True), 1)
    assert world.run(120, lambda: 200 in world.views() and world.landed())
    assert stub.armings == 2


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("after_s", [0.5, 1.5, 2.5])
def test_a_take_off_that_is_called_off_ends_on_the_ground(tmp_path: Path, kind: str, after_s: float) -> None:
    world = world_of(tmp_path, kind, ready_s=0.0)
    body, stub = world.vehicles[1].body, world.attached[1].stub
    world.run(0.5)
    here = body.at(world.t_ns).state.position
    up = here + np.array([0.0, 0.0, 4.0])
    body.fly(resting(up, 0.0, 0.0), world.t_ns)
    for _ in range(round(after_s / 0.1)):
        world.tick()
    body.fly(resting(here, 0.0, 0.0), world.t_ns)
    assert world.run(30, lambda: stub.air.on_ground and not stub.armed)
    world.run(15)
    assert not stub.armed
    assert stub.air.on_ground


@pytest.mark.parametrize("kind", KINDS)
def test_an_aircraft_disarmed_in_flight_is_given_up(tmp_path: Path, kind: str) -> None:
    world = under_way(tmp_path, kind)
    stub = world.attached[1].stub
    stub.armed = False
    world.run(2)
    assert "control given up: motors disarmed" in texts(world)
    assert orders(stub)[-1] != mav.MAV_CMD_COMPONENT_ARM_DISARM


@pytest.mark.parametrize("kind", KINDS)
def test_an_autopilot_that_does_not_disarm_by_itself_is_told_to_once_it_has_landed(tmp_path: Path, kind: str) -> None:
    world = world_of(tmp_path, kind)
    stub = world.attached[1].stub
    stub.disarms = False
    world.upload(route(LEGS[:1], home_after=True), 1)
    assert world.run(120, lambda: flown(world))
    assert not stub.armed
    assert stub.refused_disarms == 0


@pytest.mark.parametrize("kind", KINDS)
def test_the_autopilot_stops_by_itself_when_this_process_dies(tmp_path: Path, kind: str) -> None:
    world = under_way(tmp_path, kind)
    attached = world.attached[1]
    attached.alive = False
    attached.pump(attached.t_s + 6.0)
    assert np.linalg.norm(attached.stub.air.velocity) < 0.05
    assert attached.stub.mode == {"px4": "HOLD", "ardupilot": "GUIDED"}[kind]
    assert attached.stub.armed


def test_the_autopilot_hears_of_the_ground_station_for_as_long_as_there_is_one(tmp_path: Path) -> None:
    world = under_way(tmp_path, "px4")
    stub = world.attached[1].stub
    world.run(15)
    assert stub.mode == "OFFBOARD"
    world.attached[1].pump(world.attached[1].t_s + 20.0)  # no ticks any more, but the process lives
    assert stub.mode == "RTL", "its own data link failsafe"


@pytest.mark.parametrize("kind", KINDS)
def test_when_the_clock_stands_still_the_aircraft_stops_on_its_way(tmp_path: Path, kind: str) -> None:
    world = under_way(tmp_path, kind)
    attached, way = world.attached[1], np.array(LEGS, dtype=float)
    track: list[Array] = []
    for _ in range(50):  # five seconds, in which no tick comes
        attached.pump(attached.t_s + 0.1)
        track.append(world.stub_enu(1))
    world._offset_s[1] += 5.0
    assert np.linalg.norm(attached.stub.air.velocity) < 0.05
    assert attached.stub.mode in ("OFFBOARD", "GUIDED")
    assert distance_to_polyline_m(np.array(track), way).max() < 0.3
    assert world.run(120, lambda: world.views() == [100, 101, 102, 103])


@pytest.mark.parametrize(("kind", "seed"), [("px4", 1), ("ardupilot", 2)])
def test_a_clock_that_stops_now_and_then_never_takes_it_off_its_way(tmp_path: Path, kind: str, seed: int) -> None:
    world, dice = world_of(tmp_path, kind, ready_s=0.0), random.Random(seed)
    world.upload(route(LEGS), 1)
    attached, track = world.attached[1], []
    while world.views() != [100, 101, 102, 103] and world.t_ns < 200 * NS:
        world.tick()
        track += [world.stub_enu(1)] if world.views() else []
        stands_s = dice.uniform(0.1, 1.0) if world.views() and dice.random() < 0.05 else 0.0
        while stands_s > 0.0:
            attached.pump(attached.t_s + 0.1)
            world._offset_s[1], stands_s = world._offset_s[1] + 0.1, stands_s - 0.1
            track.append(world.stub_enu(1))
    assert world.views() == [100, 101, 102, 103]
    assert "planning anew from where it is" in texts(world)
    assert distance_to_polyline_m(np.array(track), np.array(LEGS, dtype=float)).max() < 0.3


def test_a_gust_off_the_course_makes_it_plan_anew_from_where_it_is(tmp_path: Path) -> None:
    world = under_way(tmp_path, "px4")
    world.attached[1].stub.air.wind = np.array([4.0, 0.0, 0.0])
    world.run(1.5)
    world.attached[1].stub.air.wind = np.zeros(3)
    assert "planning anew from where it is" in texts(world)
    assert world.run(120, lambda: world.views() == [100, 101, 102, 103])
    assert world.reports == []


@pytest.mark.parametrize("kind", KINDS)
def test_an_autopilot_that_does_not_arm_is_given_up_with_its_reason(tmp_path: Path, kind: str) -> None:
    world = world_of(tmp_path, kind)
    stub = world.attached[1].stub
    stub.refuse_arming = "compass"
    world.upload(route(LEGS), 1)
    assert world.run(200, lambda: "Arming denied: compass" in texts(world))
    assert "control given up: it does not take off" in texts(world)
    assert world.run(2, world.landed)
    assert "emergency" in {s.mode for s in world.states[1]}
    assert stub.armings == 0
    assert {r.view_id for r in world.reports} == {100, 101, 102, 103}


def test_a_silent_autopilot_is_given_up(tmp_path: Path) -> None:
    world = under_way(tmp_path, "px4")
    world.attached[1].cut = True
    world.run(5)
    assert "control given up: the autopilot is silent" in texts(world)
