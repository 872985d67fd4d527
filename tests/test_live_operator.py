"""What becomes of an operator's commands on the ground, before and beside what vehicles answer."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from ground_station.control import Control
from ground_station.director import Director
from ground_station.drone import Drone, Stage
from ground_station.fleet import Fleet
from ground_station.live.alarms import Alarms
from ground_station.live.feed import LiveFeed
from ground_station.operator import Operator
from ground_station.recorder import Recorder
from ground_station.survey_phase import SurveyPhase
from missions import live, topics
from missions.bus import Delivery
from missions.clock import SECOND_NS
from missions.grid import OCCUPIED
from missions.live import OperatorAnswer, OperatorCommand
from missions.mavlink import AUTOPILOT_COMPONENT, GROUND_COMPONENT, GROUND_SYSTEM, Endpoint
from missions.messages import FenceVerdict, SiteBrief, VehicleState, vector
from missions.mission import BatterySpec, FleetSpec, Mission, SiteSpec
from missions.run_folder import RunFolder

SITE = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)
MISSION = Mission(title="t", fleet=FleetSpec(vehicles=2))
WITH_RESERVE = Mission(title="t", fleet=FleetSpec(vehicles=2, reserve=1), battery=BatterySpec(swaps=1))


@dataclass
class World:
    """A ground station without a bus, and the vehicles' ends of its links."""

    folder: Path
    mission: Mission = MISSION
    said: list[Any] = field(default_factory=list)
    asked: int = 0

    def __post_init__(self) -> None:
        self.recorder = Recorder(RunFolder(self.folder), self.mission, SITE)
        self.fleet = Fleet(self.mission, SITE, Mock(), Mock(), self.recorder)
        self.control = Control(self.mission, SITE, self.fleet, Mock(), self.recorder)
        self.director = Director(self.control)
        self.operator = Operator(self.control, self.director, self, waits_for_start=True)  # type: ignore[arg-type]

    def publish(self, topic: object, message: OperatorAnswer) -> None:
        assert topic is topics.OPERATOR_ANSWER
        self.said.append(message)

    def ask(self, action: live.AnyAction) -> OperatorAnswer | None:
        """The answer, if it is there at once."""
        self.asked += 1
        return self.ask_as(str(self.asked), action)

    def ask_as(self, command_id: str, action: live.AnyAction) -> OperatorAnswer | None:
        """The same, with this id."""
        before = len(self.said)
        command = OperatorCommand(command_id=command_id, action=action)
        self.operator.receive([Delivery(topics.OPERATOR_COMMAND, "", "", 0, command)])
        self.operator.answer()
        return self.said[-1] if len(self.said) > before else None

    def vehicles_answer(self, result: int = mav.MAV_RESULT_ACCEPTED) -> list[int]:
        """Every vehicle acknowledges what reaches it; the commands that did."""
        commands = []
        for k, drone in self.fleet.drones.items():
            for message in Endpoint(GROUND_SYSTEM, GROUND_COMPONENT).parse(drone.link.poll(self.fleet.t_ns).frames):
                if message.get_type() == "COMMAND_LONG":
                    commands.append(message.command)
                    ack = mav.MAVLink_command_ack_message(message.command, result)
                    drone.link.on_frames([Endpoint(k, AUTOPILOT_COMPONENT).pack(ack)])
        self.operator.answer()
        return commands

    def hovers(self, vehicle_id: int) -> Drone:
        drone = self.fleet.drones[vehicle_id]
        drone.stage = Stage.READY
        x, y, z = (float(c) for c in drone.hover_enu_m)
        drone.link.on_state(VehicleState(
            vehicle_id=vehicle_id, t_ns=SECOND_NS, position_enu_m=(x, y, z), velocity_enu_m_s=(0.0, 0.0, 0.0),
            acceleration_enu_m_s2=(0.0, 0.0, 0.0), yaw_enu_rad=0.0, gimbal_elevation_rad=0.0, battery_percent=90.0,
            flying=True, mode="mission"))
        return drone


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(tmp_path)


def test_on_the_pad_nothing_is_sent_and_the_answer_comes_at_once(world: World) -> None:
    answer = world.ask(live.Pause())
    assert answer is not None
    assert answer.accepted
    assert [v.text for v in answer.vehicles] == ["is on its pad", "is on its pad"]
    world.director.step()
    assert [d.stage for d in world.fleet.drones.values()] == [Stage.PARKED, Stage.PARKED]
    world.ask(live.Resume(vehicle_id=2))
    world.director.step()
    assert [d.stage for d in world.fleet.drones.values()] == [Stage.PARKED, Stage.LAUNCHING]


def test_the_answer_waits_for_the_vehicle_and_carries_its_refusal(world: World) -> None:
    world.hovers(1)
    assert world.ask(live.Pause(vehicle_id=1)) is None
    assert world.vehicles_answer(mav.MAV_RESULT_DENIED) == [mav.MAV_CMD_DO_PAUSE_CONTINUE]
    assert not world.said[-1].accepted
    assert [(v.vehicle_id, v.text) for v in world.said[-1].vehicles] == [(1, "refuses")]


def test_a_vehicle_that_lands_where_it_is_flies_no_more_and_one_on_its_pad_is_left_alone(world: World) -> None:
    drone = world.hovers(1)
    assert world.ask(live.Land(vehicle_id=1)) is None
    assert world.vehicles_answer() == [mav.MAV_CMD_NAV_LAND]
    assert (drone.stage, drone.available) == (Stage.HOMING, False)
    assert world.ask(live.Land(vehicle_id=2)) is not None
    assert world.fleet.drones[2].available


def test_a_command_that_comes_twice_is_carried_out_once_and_answered_again(world: World) -> None:
    world.hovers(1)
    assert [world.ask_as("a", live.Pause(vehicle_id=1)) for _ in range(2)] == [None, None]
    assert world.vehicles_answer() == [mav.MAV_CMD_DO_PAUSE_CONTINUE]
    assert world.ask_as("a", live.Pause(vehicle_id=1)) == world.said[0]
    assert world.vehicles_answer() == []
    assert world.ask_as("b", live.Start()).accepted  # type: ignore[union-attr]
    assert world.ask_as("b", live.Start()).accepted  # type: ignore[union-attr]


def test_an_id_belongs_to_one_command(world: World) -> None:
    world.ask_as("1", live.Start())
    refused = world.ask_as("1", live.Pause())
    assert refused is not None
    assert (refused.accepted, "of its own" in refused.text) == (False, True)
    assert not any(d.held for d in world.fleet.drones.values())


def test_who_is_called_home_keeps_its_place_in_the_mission_and_who_is_dropped_does_not(world: World) -> None:
    first, second = world.hovers(1), world.hovers(2)
    world.ask(live.Home(vehicle_id=1))
    world.ask(live.Drop(vehicle_id=2))
    assert world.vehicles_answer() == 2 * [mav.MAV_CMD_NAV_RETURN_TO_LAUNCH]
    assert (first.available, first.held, second.available, second.held) == (True, True, False, False)
    assert (first.stage, second.stage) == (Stage.HOMING, Stage.HOMING)
    assert world.ask(live.Add(vehicle_id=1)).text == "vehicle 1 takes part already"  # type: ignore[union-attr]
    assert world.ask(live.Add(vehicle_id=2)).accepted  # type: ignore[union-attr]
    assert second.available


def test_the_reserve_stays_on_its_pad_until_it_is_added(tmp_path: Path) -> None:
    world = World(tmp_path, WITH_RESERVE)
    spare = world.fleet.drones[2]
    asked = world.ask(live.Pause())
    assert asked is not None
    assert [v.vehicle_id for v in asked.vehicles] == [1]
    world.director.step()
    assert (spare.stage, spare.available, spare.held) == (Stage.PARKED, False, False)
    assert Alarms(world.fleet, MISSION.battery).now({1: 0.0, 2: 0.0}, started=True)[-1].vehicle_id == 1
    assert world.ask(live.Add(vehicle_id=2)).accepted  # type: ignore[union-attr]
    world.director.step()
    assert spare.stage is Stage.LAUNCHING


def test_who_is_out_of_the_mission_gets_no_views_for_its_next_battery_either(tmp_path: Path) -> None:
    world = World(tmp_path, WITH_RESERVE)
    survey = SurveyPhase(world.control, None)
    assert [f.vehicle_id for f in survey._flyers()] == [1]
    world.fleet.add(world.fleet.drones[2])
    world.fleet.drones[2].spent = True
    assert [(f.vehicle_id, f.usable_percent, f.swaps) for f in survey._flyers()][1] == (2, 0.0, 1)


def test_nobody_is_added_once_the_mission_comes_home(tmp_path: Path) -> None:
    world = World(tmp_path, WITH_RESERVE)
    world.ask(live.Abort())
    assert "comes home already" in world.ask(live.Add(vehicle_id=2)).text  # type: ignore[union-attr]


def test_the_fence_moves_out_once_all_vehicles_have_it_on_board(tmp_path: Path) -> None:
    world = World(tmp_path, Mission(title="t", fleet=FleetSpec(vehicles=2), site=SiteSpec(geofence_room_m=5.0)))
    regions = world.control.regions
    (low, high), (least, most) = regions.on_board_enu_m, regions.limit_enu_m
    wide = live.MoveFence(lower_enu_m=vector(low), upper_enu_m=vector(most))
    assert "begun" in world.ask(wide).text  # type: ignore[union-attr]
    world.ask(live.Start())
    for accepted in (False, True):
        assert world.ask(wide) is None
        assert np.array_equal(regions.fence_enu_m[1], high)
        for drone in world.fleet.drones.values():
            assert drone.fence_asked is not None
            order = drone.fence_asked.order
            assert (order.lower_enu_m, order.upper_enu_m) == (vector(low), vector(most))
            world.fleet._take(drone, Delivery(topics.FENCE_VERDICT, str(drone.vehicle_id), "", 0, FenceVerdict(
                order_id=order.order_id, accepted=accepted or drone.vehicle_id == 1, reason="" if accepted else "no")))
        world.operator.answer()
        assert world.said[-1].accepted == accepted
    assert np.allclose(regions.fence_enu_m[1], most)
    assert np.allclose(regions.on_board_enu_m[1], most)
    narrow = world.ask(live.MoveFence(lower_enu_m=vector(low), upper_enu_m=vector(high)))
    assert narrow is not None
    assert narrow.accepted
    assert not regions.beyond_board(vector(low), vector(most))
    assert "allows no more" in world.ask(  # type: ignore[union-attr]
        live.MoveFence(lower_enu_m=vector(least - 1.0), upper_enu_m=vector(most))).text


def test_abort_ends_the_wait_for_start_and_the_mission(world: World) -> None:
    assert not world.operator.started
    assert world.ask(live.Abort()) is not None
    assert world.operator.started
    world.director.step()
    assert world.director.phase == "over"


@pytest.mark.parametrize(("action", "why"), [
    (live.Pause(vehicle_id=9), "there is no vehicle 9"), (live.SetGoal(coverage=0.0), "the goal is a share"),
    (live.Add(vehicle_id=9), "does not take part in this mission's clock"),
    (live.ClearRegion(region_id=3), "no region 3"), (live.SetSpeed(speed=2.0), "only a recording"),
    (live.MoveFence(lower_enu_m=(0.0, 0.0, 0.0), upper_enu_m=(1.0, 1.0, 1.0)), "pads"),
])
def test_what_cannot_be_done_is_refused_with_a_reason(world: World, action: live.AnyAction, why: str) -> None:
    answer = world.ask(action)
    assert answer is not None
    assert (answer.accepted, why in answer.text) == (False, True)


def test_a_goal_keeps_exploration_going_and_is_told(world: World) -> None:
    answer = world.ask(live.SetGoal(coverage=0.97))
    assert answer is not None
    assert answer.accepted
    assert world.director.goal_coverage == 0.97
    explorer = world.director._explore.explorer  # type: ignore[union-attr]
    assert explorer._pays([0.6], [1000.0])
    assert not explorer._pays([0.1], [1.0])
    assert any("operator: explore up to coverage 97%" in note for note in world.recorder.notes)


def test_the_feed_tells_everything_once_and_then_what_is_new(world: World) -> None:
    feed = LiveFeed(world.control, world.director, world.operator, RunFolder(world.folder), Mock())
    state = world.control.grid.state.copy()  # type: ignore[union-attr]
    state[5, 6, 7] = OCCUPIED
    world.control.grid = replace(world.control.grid, state=state)  # type: ignore[type-var]
    first, second = feed.update(), feed.update()
    assert (first.whole, second.whole, second.seq) == (True, False, first.seq + 1)
    assert first.map is not None
    assert (first.map.solid, first.map.gone, second.map, second.plans) == ([(5, 6, 7)], [], None, [])
    world.control.grid = replace(world.control.grid, state=np.zeros_like(state))  # type: ignore[type-var]
    third = feed.update()
    assert third.map is not None
    assert (third.map.solid, third.map.gone) == ([], [(5, 6, 7)])
    feed.hear((Delivery(topics.LIVE_HELLO, "", "", 0, live.LiveHello(name="x", whole=True)),))
    assert feed.update().whole


def test_alarms_say_what_is_the_matter(world: World) -> None:
    alarms = Alarms(world.fleet, MISSION.battery)
    assert [a.name for a in alarms.now({1: 0.0, 2: 0.0}, started=False)] == ["waits for start"]
    drone = world.hovers(1)
    world.fleet.t_ns = 2 * SECOND_NS
    assert alarms.now({1: 1.0, 2: 0.0}, started=True) == []
    assert [a.name for a in alarms.now({1: 84.0, 2: 0.0}, started=True)] == ["little energy"]
    world.ask(live.Pause(vehicle_id=1))
    drone.link.telemetry.warning = "plan refused: fence"
    world.fleet.t_ns = 9 * SECOND_NS
    told = alarms.now({1: 1.0, 2: 0.0}, started=True)
    assert [(a.name, a.severity) for a in told] == [
        ("silent", "danger"), ("says", "warning"), ("waits for you", "notice")]
    world.fleet.drones[2].stage = Stage.LOST
    assert alarms.now({1: 1.0, 2: 0.0}, started=True)[1].text.startswith("Vehicle 2 is lost")
