"""The failsafe as other ground stations meet it: what they set, what they see, and what happens when they go."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from missions.mavlink import Item
from missions.pads import takeoff_points
from missions.simulation import FaultSpec
from tests.door_world import ACCEPTED, DENIED, Client, DoorWorld, flight_plan, take_off
from tests.vehicle_world import NS, SITE

RETURN = mav.MAV_CMD_NAV_RETURN_TO_LAUNCH
HOLD_PX4 = (1.0, 4.0, 3.0)
WATCHER = (255, 190)


def texts(client: Client) -> list[str]:
    return [m.text for m in client.heard if m.get_type() == "STATUSTEXT"]


def set_parameter(client: Client, name: str, value: float, kind: int = mav.MAV_PARAM_TYPE_REAL32) -> str:
    """What came back."""
    client.tell(mav.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
    return str(client.wait(lambda m: m.get_type() in ("PARAM_VALUE", "PARAM_ERROR")).get_type())


def home(world: DoorWorld) -> bool:
    return bool(np.linalg.norm(world.path(1)[-1] - takeoff_points(world.mission, SITE)[0]) < 0.01)


def test_a_leader_that_falls_silent_is_missed_and_one_that_beats_is_not(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    world.run(40.0)
    take_off(client)
    world.run(60.0)
    assert world.vehicles[1].executor.flying, "it hovers on the word of a leader that is there"
    world.clients.remove(client)
    silent_s = world.t_ns / NS
    assert world.run(60.0, until=world.landed)
    assert world.t_ns / NS - silent_s > 30.0
    assert home(world)


def test_a_watcher_s_heartbeat_does_not_stand_in_for_the_leader_s(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client, watcher = world.client(), world.client(ids=WATCHER)
    take_off(client)
    world.clients.remove(client)
    assert world.run(60.0, until=world.landed)
    assert any("ground silent" in t for t in texts(watcher))


@pytest.mark.parametrize("how", ["set mode", "loiter"])
def test_a_watcher_holds_a_mission_but_not_a_return(how: str, tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client, watcher = world.client(), world.client(ids=WATCHER)
    assert client.upload(flight_plan(world)) == mav.MAV_MISSION_ACCEPTED
    take_off(client)
    assert client.command(mav.MAV_CMD_MISSION_START) == ACCEPTED
    world.run(2.0)

    def hold(who: Client) -> int:
        return who.command(mav.MAV_CMD_DO_SET_MODE, *HOLD_PX4) if how == "set mode" else \
            who.command(mav.MAV_CMD_NAV_LOITER_UNLIM)

    assert hold(watcher) == ACCEPTED
    world.run(1.0)
    assert world.vehicles[1].executor.mode == "hold"
    assert hold(client) == ACCEPTED, "the leader pauses as well: only it decides from now on"
    assert watcher.command(mav.MAV_CMD_MISSION_START) == DENIED
    assert client.command(mav.MAV_CMD_MISSION_START) == ACCEPTED
    world.run(5.0)
    assert watcher.command(RETURN) == ACCEPTED
    assert hold(watcher) == DENIED
    assert world.vehicles[1].executor.mode == "return"
    assert hold(client) == ACCEPTED
    assert world.vehicles[1].executor.mode == "hold"


def test_what_the_failsafe_sees_is_told_to_programs_as_well(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path, faults=[FaultSpec(vehicle=1, kind="position_lost", at_s=15.0, until_s=20.0)])
    client = world.client()
    take_off(client)
    world.run(18.0 - world.t_ns / NS)
    assert client.last("HEARTBEAT", 1).system_status == mav.MAV_STATE_CRITICAL
    assert not client.last("SYS_STATUS").onboard_control_sensors_health & mav.MAV_SYS_STATUS_SENSOR_GPS
    world.run(8.0)
    assert client.last("HEARTBEAT", 1).system_status == mav.MAV_STATE_ACTIVE
    assert client.last("SYS_STATUS").onboard_control_sensors_health & mav.MAV_SYS_STATUS_SENSOR_GPS
    assert world.vehicles[1].executor.flying


@pytest.mark.parametrize(("identity", "name"), [("px4", "GF_ACTION"), ("px4", "NAV_DLL_ACT")])
def test_termination_cannot_be_set(identity: Literal["px4", "ardupilot"], name: str, tmp_path: Path) -> None:
    world = DoorWorld(tmp_path, identity)
    before = world.vehicles[1].failsafe.settings
    assert set_parameter(world.client(), name, 4.0 if name == "GF_ACTION" else 5.0) == "PARAM_ERROR"
    assert world.vehicles[1].failsafe.settings == before


def test_a_watcher_cannot_soften_the_failsafe(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client, watcher = world.client(), world.client(ids=WATCHER)
    take_off(client)
    before = world.vehicles[1].failsafe.settings
    assert set_parameter(watcher, "BAT_EMERGEN_THR", 0.0) == "PARAM_ERROR"
    assert world.vehicles[1].failsafe.settings == before
    assert set_parameter(client, "COM_DL_LOSS_T", 20.0) == "PARAM_VALUE"
    assert world.vehicles[1].failsafe.settings.ground_lost_s == 20.0


def test_the_lead_is_handed_over_by_who_has_it(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client, watcher = world.client(), world.client(ids=WATCHER)

    def control(who: Client, request: int) -> int:
        who.tell(mav.MAVLink_change_operator_control_message(1, request, 0, b""))
        return int(who.wait(lambda m: m.get_type() == "CHANGE_OPERATOR_CONTROL_ACK").ack)

    take_off(client)
    assert control(watcher, 0) == 3
    assert control(watcher, 1) == 0
    assert watcher.command(mav.MAV_CMD_DO_CHANGE_SPEED, 0.0, 1.0) == DENIED, "who has no lead has none to let go of"
    assert control(client, 1) == 0
    assert control(watcher, 0) == 0
    assert watcher.command(mav.MAV_CMD_DO_CHANGE_SPEED, 0.0, 1.0) == ACCEPTED
    assert client.command(mav.MAV_CMD_DO_CHANGE_SPEED, 0.0, 1.0) == DENIED


def test_a_charge_level_that_is_set_in_flight_sends_it_home(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    take_off(client)
    world.run(5.0)
    assert set_parameter(client, "BAT_LOW_THR", 0.999) == "PARAM_VALUE"
    world.run(2.0)
    assert world.vehicles[1].executor.mode in ("return", "land")


def test_a_fence_uploaded_across_the_way_is_never_crossed(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    assert client.upload(flight_plan(world)) == mav.MAV_MISSION_ACCEPTED
    take_off(client)
    assert client.command(mav.MAV_CMD_MISSION_START) == ACCEPTED
    assert world.run(20.0, until=lambda: bool(world.path(1)[-1][0] > 0.5))
    corners = [(-20.0, -20.0), (5.5, -20.0), (5.5, 20.0), (-20.0, 20.0)]
    places = [world.site.geodetic_from_enu(np.array([x, y, 0.0])) for x, y in corners]
    items = [Item(mav.MAV_FRAME_GLOBAL_INT, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, (4.0, 0.0, 0.0, 0.0),
                  round(lat * 1e7), round(lon * 1e7), 0.0) for lat, lon, _ in places]
    assert client.upload(items, mav.MAV_MISSION_TYPE_FENCE) == mav.MAV_MISSION_ACCEPTED
    assert world.path(1)[-1][0] < 2.5, "the test needs it inside when the fence comes"
    assert world.run(60.0, until=world.landed)
    assert world.path(1)[:, 0].max() <= 5.55
    assert home(world)
    assert any("plan not valid any more" in t for t in texts(client))
