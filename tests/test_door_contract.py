"""What a vehicle tells and answers at a door: the contract that clients of other makes rely on."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from tests.door_world import (
    ACCEPTED,
    CAMERA,
    GIMBAL,
    IDENTITIES,
    UNSUPPORTED,
    DoorWorld,
    flight_plan,
    take_off,
)
from vehicle.autopilot.telemetry import STREAMS
from vehicle.dialects import DIALECTS


@pytest.mark.parametrize("identity", IDENTITIES)
def test_everything_that_clients_wait_for_is_sent(identity: Literal["px4", "ardupilot"], tmp_path: Path) -> None:
    world = DoorWorld(tmp_path, identity)
    client = world.client()
    world.run(3.0)
    kinds = {(m.get_srcComponent(), m.get_type()) for m in client.heard}
    wanted = {(s.component, mav.mavlink_map[s.number].msgname) for s in STREAMS} - {
        (1, "OBSTACLE_DISTANCE"), (1, "FENCE_STATUS")}  # when there is something to tell
    assert wanted <= kinds
    beat = client.last("HEARTBEAT", 1)
    assert beat.autopilot == DIALECTS[identity].autopilot
    assert beat.base_mode & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    assert {m.get_srcSystem() for m in client.heard} == {1}
    assert client.last("HEARTBEAT", CAMERA).type == mav.MAV_TYPE_CAMERA
    assert client.last("HEARTBEAT", GIMBAL).autopilot == mav.MAV_AUTOPILOT_INVALID
    health = client.last("SYS_STATUS").onboard_control_sensors_health
    assert health & mav.MAV_SYS_STATUS_PREARM_CHECK
    assert health & mav.MAV_SYS_STATUS_GEOFENCE, "MAVProxy would cry fence breach"
    assert client.last("BATTERY_STATUS").time_remaining > 0


@pytest.mark.parametrize(("component", "number"), [
    (1, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION), (1, mav.MAVLINK_MSG_ID_HOME_POSITION),
    (CAMERA, mav.MAVLINK_MSG_ID_CAMERA_INFORMATION), (CAMERA, mav.MAVLINK_MSG_ID_CAMERA_SETTINGS),
    (CAMERA, mav.MAVLINK_MSG_ID_STORAGE_INFORMATION), (CAMERA, mav.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS),
    (GIMBAL, mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION), (GIMBAL, mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION)])
def test_what_is_asked_for_is_acknowledged_first_and_then_sent(component: int, number: int, tmp_path: Path) -> None:
    client = DoorWorld(tmp_path).client()
    client.tell(mav.MAVLink_command_long_message(1, component, mav.MAV_CMD_REQUEST_MESSAGE, 0, float(number), 0, 0, 0,
                                                 0, 0, 0))
    ack = client.wait(lambda m: m.get_type() == "COMMAND_ACK")
    assert (ack.result, ack.get_srcComponent(), ack.target_system, ack.target_component) == (ACCEPTED, component, 245,
                                                                                            190)
    after = client.heard[client.heard.index(ack) + 1:]
    assert number in [m.get_msgId() for m in after if m.get_srcComponent() == component]


@pytest.mark.parametrize("identity", IDENTITIES)
def test_what_is_not_there_is_refused_and_never_left_unanswered(identity: Literal["px4", "ardupilot"],
                                                                tmp_path: Path) -> None:
    client = DoorWorld(tmp_path, identity).client()
    assert client.command(mav.MAV_CMD_DO_PARACHUTE, 1.0) == UNSUPPORTED
    assert client.ask(mav.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION, CAMERA) == UNSUPPORTED
    assert client.ask(mav.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED, CAMERA, 0.0) == UNSUPPORTED
    assert client.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 77.0) == UNSUPPORTED


def test_a_repeated_photo_command_takes_one_photo_and_a_series_ends_when_told(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    for _ in range(3):  # MAVSDK repeats with the same sequence, and with confirmation 0
        assert client.command(mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0, 0.0, component=CAMERA) == ACCEPTED
    world.run(1.0)
    assert len(world.shutters) == 1
    assert client.command(mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0, 1.0, component=CAMERA) == ACCEPTED
    world.run(1.0)
    assert len(world.shutters) == 2
    assert client.command(mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 1.0, 0.0, 0.0, component=CAMERA) == ACCEPTED
    world.run(4.0)
    assert client.command(mav.MAV_CMD_IMAGE_STOP_CAPTURE, component=CAMERA) == ACCEPTED
    taken = len(world.shutters)
    assert 5 <= taken <= 8
    world.run(3.0)
    assert len(world.shutters) == taken
    indices = [m.image_index for m in client.heard if m.get_type() == "CAMERA_IMAGE_CAPTURED"]
    assert indices == list(range(taken))
    again = client.ask(mav.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED, CAMERA, 1.0)
    assert (again.image_index, again.capture_result) == (1, 1)


def test_parameters_have_effect_and_travel_as_each_dialect_sends_them(tmp_path: Path) -> None:
    for identity, name, value, kind in (("px4", "MPC_XY_CRUISE", 1.0, mav.MAV_PARAM_TYPE_REAL32),
                                        ("ardupilot", "WPNAV_SPEED", 100.0, mav.MAV_PARAM_TYPE_REAL32)):
        folder = tmp_path / identity
        folder.mkdir()
        world = DoorWorld(folder, identity)  # type: ignore[arg-type]
        client = world.client()
        client.tell(mav.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
        assert client.wait(lambda m: m.get_type() == "PARAM_VALUE").param_value == pytest.approx(value)
        assert world.vehicles[1].pilot.limits.speed_m_s == pytest.approx(1.0)
        client.tell(mav.MAVLink_param_set_message(1, 1, name.encode(), -5.0, kind))
        assert client.wait(lambda m: m.get_type() == "PARAM_VALUE").param_value == pytest.approx(value)
        client.tell(mav.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
        assert client.wait(lambda m: m.get_type() == "PARAM_ERROR").error == mav.MAV_PARAM_ERROR_DOES_NOT_EXIST
        client.tell(mav.MAVLink_param_request_list_message(1, 1))
        world.run(0.5)
        values = [m for m in client.heard if m.get_type() == "PARAM_VALUE" and m.param_count]
        number = next(m for m in reversed(values) if m.param_id in ("MAV_SYS_ID", "SYSID_THISMAV")).param_value
        assert (struct.unpack("<i", struct.pack("<f", number))[0] if identity == "px4" else number) == 1
        assert {m.param_index for m in values} == set(range(values[0].param_count))


def test_a_picture_that_fails_is_told_as_such(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    world._expose = lambda k, request: None  # type: ignore[method-assign]  # the camera gives nothing
    assert client.command(mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0, 0.0, component=CAMERA) == ACCEPTED
    told = client.wait(lambda m: m.get_type() == "CAMERA_IMAGE_CAPTURED", 5.0)
    assert (told.capture_result, told.get_srcComponent()) == (0, CAMERA)


def test_what_clients_need_to_know_first_is_said(tmp_path: Path) -> None:
    for identity in IDENTITIES:
        folder = tmp_path / identity
        folder.mkdir()
        version = DoorWorld(folder, identity).client().ask(mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        assert version.capabilities & mav.MAV_PROTOCOL_CAPABILITY_MISSION_INT, "else MAVSDK refuses every mission call"
        bytewise = version.capabilities & mav.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        assert bool(bytewise) == (identity == "px4")
        assert version.uid == 1


def test_numbers_that_are_no_places_come_back_as_they_were_sent(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    plan = flight_plan(world)
    assert client.upload(plan) == mav.MAV_MISSION_ACCEPTED
    back = client.download()
    assert [(m.frame, m.command, m.x, m.y) for m in back] == [(i.frame, i.command, i.x, i.y) for i in plan]
    assert back[1].x == 12, "flags of the gimbal, not degrees"
    np.testing.assert_equal([(m.param1, m.param2, m.param3, m.param4) for m in back], [i.params for i in plan])


def test_obstacles_around_are_told_in_the_body_s_frame(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    world.obstacles = [((-1.0, -9.0, 0.0), (1.0, -8.0, 10.0))]  # 5 m north of the pad, which the vehicle faces
    client = world.client()
    take_off(client)
    told = client.wait(lambda m: m.get_type() == "OBSTACLE_DISTANCE")
    ahead = min(told.distances[0], told.distances[1], told.distances[71])
    assert ahead == pytest.approx(500, abs=40)
    assert told.distances[36] == 65535
    assert (told.increment, told.frame) == (5, mav.MAV_FRAME_BODY_FRD)


def test_a_change_of_mode_is_told_at_once(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    world.run(2.35)
    before = len([m for m in client.heard if m.get_type() == "HEARTBEAT" and m.get_srcComponent() == 1])
    assert client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == ACCEPTED
    beats = [m for m in client.heard if m.get_type() == "HEARTBEAT" and m.get_srcComponent() == 1]
    assert len(beats) == before + 1
    assert beats[-1].base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED


def test_rates_are_changed_when_asked(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path)
    client = world.client()
    number = mav.MAVLINK_MSG_ID_VFR_HUD
    assert client.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, float(number), 100_000.0) == ACCEPTED
    before = len([m for m in client.heard if m.get_type() == "VFR_HUD"])
    world.run(2.0)
    assert len([m for m in client.heard if m.get_type() == "VFR_HUD"]) - before > 4
    assert client.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, float(number), -1.0) == ACCEPTED
    before = len([m for m in client.heard if m.get_type() == "VFR_HUD"])
    world.run(2.0)
    assert len([m for m in client.heard if m.get_type() == "VFR_HUD"]) == before
