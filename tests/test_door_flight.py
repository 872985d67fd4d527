"""Flights that other people's clients command at a door: plans, points, set-points, and who may command."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from msgspec import structs
from pymavlink.dialects.v20 import common as mav

from missions.mavlink import GROUND_COMPONENT, GROUND_SYSTEM, Item
from tests.door_world import (
    ACCEPTED,
    DENIED,
    GIMBAL,
    IDENTITIES,
    NAN,
    UNSUPPORTED,
    DoorWorld,
    flight_plan,
    take_off,
    waypoint,
)
from tests.vehicle_world import route
from vehicle.dialects import DIALECTS


@pytest.mark.parametrize("identity", IDENTITIES)
def test_propellers_stay_on_in_flight_whoever_asks_and_however(identity: Literal["px4", "ardupilot"],
                                                               tmp_path: Path) -> None:
    world = DoorWorld(tmp_path, identity)
    client = world.client()
    if identity == "ardupilot":
        assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0) == ACCEPTED
    take_off(client)
    for force in (0.0, 21196.0):  # MAVSDK's arm_force sends the second one, by mistake
        assert client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, force) == DENIED
    assert client.command(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == DENIED
    assert client.command(mav.MAV_CMD_DO_FLIGHTTERMINATION, 1.0) == UNSUPPORTED
    assert world.vehicles[1].executor.armed
    assert world.vehicles[1].executor.flying


def test_a_plan_of_somebody_else_is_flown_photographed_and_ends_on_the_pad(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    assert client.upload(flight_plan(world)) == mav.MAV_MISSION_ACCEPTED
    assert client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == ACCEPTED
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0) == ACCEPTED
    assert world.run(120.0, until=lambda: world.landed() and world.t_ns > 20e9)
    assert [m.seq for m in client.heard if m.get_type() == "MISSION_ITEM_REACHED"] == [0, 1, 2, 3, 4, 5]
    first, second = world.shutters
    assert np.allclose(first.pose.position_enu_m, (6.0, -13.0, 5.0), atol=0.02)
    assert np.allclose(second.pose.position_enu_m, (-6.0, -13.0, 6.0), atol=0.02)
    assert math.degrees(first.pose.elevation_rad) == pytest.approx(-30.0)
    assert first.pose.yaw_enu_rad == pytest.approx(math.pi / 2.0)
    assert abs(second.pose.yaw_enu_rad) == pytest.approx(math.pi, abs=0.01), "no heading: along the leg"
    assert [m.image_index for m in client.heard if m.get_type() == "CAMERA_IMAGE_CAPTURED"] == [0, 1]
    assert not world.vehicles[1].executor.armed
    assert client.last("MISSION_CURRENT").mission_state == mav.MISSION_STATE_COMPLETE


def test_with_ardupilot_item_zero_is_home_and_a_mission_starts_by_command(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path, "ardupilot")
    client = world.client()
    plan = [structs.replace(i, params=tuple(0.0 if math.isnan(p) else p for p in i.params)) for i in flight_plan(world)]
    home = waypoint(world, (1.0, 1.0, 1.0), yaw_deg=0.0)
    assert client.upload([home, *plan]) == mav.MAV_MISSION_ACCEPTED
    back = client.download()
    assert len(back) == 7
    assert back[0].z == pytest.approx(world.site.alt_m + 0.2), "home is where the vehicle stands"
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 3.0) == ACCEPTED
    assert client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == DENIED
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0) == ACCEPTED
    assert client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == ACCEPTED
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 3.0) == ACCEPTED
    assert not world.vehicles[1].executor.flying
    assert client.command(mav.MAV_CMD_MISSION_START) == ACCEPTED
    assert world.run(120.0, until=lambda: world.landed() and world.t_ns > 20e9)
    assert [m.seq for m in client.heard if m.get_type() == "MISSION_ITEM_REACHED"] == [1, 2, 3, 4, 5, 6]
    assert len(world.shutters) == 2


@pytest.mark.parametrize(("change", "result"), [
    ({"x": 950_000_000}, mav.MAV_MISSION_INVALID_PARAM5_X), ({"frame": 10}, mav.MAV_MISSION_UNSUPPORTED_FRAME),
    ({"z": NAN}, mav.MAV_MISSION_INVALID_PARAM7), ({"command": 189}, mav.MAV_MISSION_UNSUPPORTED),
    ({"z": 4000.0}, mav.MAV_MISSION_INVALID_PARAM5_X), ({"y": 0}, mav.MAV_MISSION_INVALID_PARAM5_X)])
def test_a_bad_item_refuses_the_whole_plan_with_its_reason_and_keeps_the_old_one(
        change: dict[str, Any], result: int, tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    plan = flight_plan(world)
    assert client.upload(plan) == mav.MAV_MISSION_ACCEPTED
    fields = {n: getattr(plan[3], n) for n in Item.__struct_fields__} | change
    assert client.upload([*plan[:3], Item(**fields), *plan[4:]]) == result
    assert len(client.download()) == len(plan)
    said = client.wait(lambda m: m.get_type() == "HEARTBEAT") and [m.text for m in client.heard
                                                                    if m.get_type() == "STATUSTEXT"]
    assert any("refused" in text for text in said)


def test_unknown_is_not_free_for_clients_either(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    take_off(client)
    lat, lon, alt = world.site.geodetic_from_enu(np.array([0.0, -60.0, 5.0]))
    assert client.command(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, lat, lon, alt) == DENIED
    assert any("geofence" in m.text for m in client.heard if m.get_type() == "STATUSTEXT")


def test_goto_hold_and_turning_the_camera(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    take_off(client)
    lat, lon, alt = world.site.geodetic_from_enu(np.array([8.0, -12.0, 6.0]))
    goto = mav.MAVLink_command_int_message(1, 1, mav.MAV_FRAME_GLOBAL, mav.MAV_CMD_DO_REPOSITION, 0, 0, -1.0, 1.0, 0.0,
                                           0.0, round(lat * 1e7), round(lon * 1e7), alt)
    client.tell(goto, goto)  # a repeated command changes nothing
    assert world.run(30.0, until=lambda: np.linalg.norm(world.path(1)[-1] - (8.0, -12.0, 6.0)) < 0.02)
    assert client.command(mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, -45.0, NAN, NAN, NAN, component=GIMBAL) == ACCEPTED
    assert world.run(10.0, until=lambda: abs(world.states[1][-1].gimbal_elevation_rad + math.pi / 4) < 1e-6)
    moved = np.linalg.norm(world.path(1)[-1] - world.path(1)[-2])
    assert moved < 0.05
    q = client.wait(lambda m: m.get_type() == "GIMBAL_DEVICE_ATTITUDE_STATUS").q
    pitch = math.asin(2.0 * (q[0] * q[2] - q[3] * q[1]))
    assert math.degrees(pitch) == pytest.approx(-45.0, abs=1.0)
    assert client.command(mav.MAV_CMD_NAV_LAND) == ACCEPTED
    assert world.run(30.0, until=world.landed)
    assert np.allclose(world.path(1)[-1], (8.0, -12.0, 0.2), atol=0.05)


def setpoint(east: float, mask: int = 0b110111111000) -> Any:
    return mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, mav.MAV_FRAME_LOCAL_NED, mask, -12.0, east, -5.0,
                                                             0, 0, 0, 0, 0, 0, 0.0, 0.0)


def test_offboard_follows_the_newest_set_point_and_holds_when_they_stop(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    take_off(client)
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 6.0) == DENIED, "no set-points yet"
    client.tell(setpoint(4.0))
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 6.0) == ACCEPTED
    for east in (4.0, -4.0):
        for _ in range(120):
            client.tell(setpoint(east))
            world.tick()
        assert np.allclose(world.path(1)[-1], (east, -12.0, 5.0), atol=0.02)
    assert client.last("HEARTBEAT", 1).custom_mode == DIALECTS["px4"].mode_numbers["offboard"]
    world.run(2.0)
    assert world.vehicles[1].executor.mode == "hold"
    client.tell(setpoint(0.0, mask=0b110111000111))
    world.run(0.3)
    assert any("only position" in m.text for m in client.heard if m.get_type() == "STATUSTEXT")


def test_nobody_sets_signing_up_or_speaks_for_a_component_that_is_not_there(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    take_off(client)
    client.tell(mav.MAVLink_setup_signing_message(1, 1, [7] * 32, 0))
    world.run(1.0)
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0) == ACCEPTED, "unsigned, as before"
    before = len([m for m in client.heard if m.get_type() == "COMMAND_ACK"])
    for component in (101, 171):
        client.tell(mav.MAVLink_command_long_message(1, component, mav.MAV_CMD_REQUEST_MESSAGE, 0, 148.0, 0, 0, 0, 0,
                                                     0, 0))
    world.run(1.0)
    assert len([m for m in client.heard if m.get_type() == "COMMAND_ACK"]) == before
    assert client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, component=0) == DENIED, "MAVProxy disarms component 0"


def test_a_fence_that_is_uploaded_bounds_plans_and_flights(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    corners = [(-9.0, -18.0), (9.0, -18.0), (9.0, -9.0), (-9.0, -9.0)]
    fence = [Item(0, 5001, (4.0, 0.0, 0.0, 0.0), *(round(v * 1e7) for v in world.site.geodetic_from_enu(
        np.array([e, n, 0.0]))[:2]), 0.0) for e, n in corners]
    assert client.upload(fence[:3], mav.MAV_MISSION_TYPE_FENCE) == mav.MAV_MISSION_INVALID_PARAM1
    assert client.upload(fence, mav.MAV_MISSION_TYPE_FENCE) == mav.MAV_MISSION_ACCEPTED
    assert [(m.x, m.y) for m in client.download(mav.MAV_MISSION_TYPE_FENCE)] == [(i.x, i.y) for i in fence]
    plan = flight_plan(world)
    assert client.upload(plan) == mav.MAV_MISSION_ACCEPTED
    outside = waypoint(world, (0.0, -8.0, 5.0))
    assert client.upload([plan[0], outside]) == mav.MAV_MISSION_INVALID_PARAM5_X
    assert client.upload([], mav.MAV_MISSION_TYPE_FENCE) == mav.MAV_MISSION_ACCEPTED
    assert client.upload([plan[0], outside]) == mav.MAV_MISSION_ACCEPTED


def test_one_leads_the_other_watches_but_may_make_it_safer(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    leader, watcher = world.client(), world.client(ids=(255, 230))
    take_off(leader)
    assert watcher.command(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, NAN, NAN, NAN) == DENIED
    assert watcher.upload(flight_plan(world)) == mav.MAV_MISSION_DENIED
    assert leader.upload(flight_plan(world)) == mav.MAV_MISSION_ACCEPTED
    assert leader.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0) == ACCEPTED
    world.run(2.0)
    assert watcher.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0) == ACCEPTED, "holding is safer than flying"
    assert world.vehicles[1].executor.mode == "hold"
    assert leader.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0) == ACCEPTED, "so does the leader, and decides"
    assert watcher.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0) == DENIED
    assert leader.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0) == ACCEPTED


def test_our_own_ground_station_leads_while_it_is_there(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path, ground=True)
    client = world.client()
    assert client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == DENIED
    assert any("ground station" in m.text for m in client.heard if m.get_type() == "STATUSTEXT")
    world.ground_alive = False
    world.run(0.5)
    assert client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == ACCEPTED


def test_a_watcher_may_pause_our_mission_and_let_it_go_on(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path, ground=True)
    client, other = world.client(), world.client(ids=(255, 230))
    world.upload(route([(-9, -14, 5), (9, -14, 5), (0, -13, 7)]), 1)
    assert world.run(60, lambda: bool(world.views()))
    world.run(1.0)
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0) == ACCEPTED
    taken = len(world.views())
    world.run(20.0)
    assert len(world.views()) == taken
    assert other.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0) == DENIED
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0) == ACCEPTED
    assert world.run(60, lambda: len(world.views()) == 3)
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0) == DENIED, "nothing is paused any more"


def test_a_hold_between_two_plans_outlasts_the_next_plan(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path, ground=True)
    client = world.client(ids=(GROUND_SYSTEM, GROUND_COMPONENT))
    world.upload(route([(-9, -14, 5)]), 1)
    assert world.run(60, lambda: len(world.views()) == 1)
    world.run(5.0)
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0) == ACCEPTED
    world.upload(route([(9, -14, 5), (0, -13, 7)], plan_id=2, first_view=200), 1)
    world.run(20.0)
    assert [v.plan_id for v in world.verdicts if v.accepted] == [1, 2]
    assert len(world.views()) == 1
    assert world.vehicles[1].executor.mode == "hold"
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0) == ACCEPTED
    assert world.run(60, lambda: len(world.views()) == 3)


def test_a_hold_on_the_way_up_stops_there_until_a_person_at_our_ground_station_lets_it_go_on(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path, ground=True)
    client = world.client()
    world.upload(route([(-9, -14, 5)]), 1)
    assert world.run(10, lambda: world.vehicles[1].executor.mode == "takeoff")
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0) == ACCEPTED
    world.run(20.0)
    assert world.vehicles[1].executor.mode == "hold"
    assert not world.views()
    world.command(1, mav.MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
    assert world.run(60, lambda: bool(world.views()))


@pytest.mark.parametrize("holds", [False, True])
def test_a_mission_chosen_in_the_climb_is_flown_in_place_of_hovering(tmp_path: Path, holds: bool) -> None:
    world = DoorWorld(tmp_path)
    client, executor = world.client(), world.vehicles[1].executor
    assert client.upload(flight_plan(world)) == mav.MAV_MISSION_ACCEPTED
    assert client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == ACCEPTED
    assert client.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, NAN) == ACCEPTED
    assert executor.mode == "takeoff"
    if holds:
        assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0) == ACCEPTED
        assert executor.mode == "hold"
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0) == ACCEPTED
    assert world.run(120.0, until=lambda: world.landed() and world.t_ns > 20e9)
    assert len(world.shutters) == 2
