"""Doors: who gets which frame; ten vehicles behind one of them, found and commanded by MAVSDK without cross-talk."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from mavsdk import ComponentType, Configuration
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from pymavlink.dialects.v20 import common as mav

from missions import topics
from missions.bus import Delivery
from missions.clock import BRIDGE
from missions.errors import UserError
from missions.mavlink import Endpoint
from missions.messages import MavlinkFrames
from missions.mission import MavlinkSpec
from sim_bridge.doors import Doors
from sim_bridge.frame_header import Header, split
from tests.door_world import DoorWorld
from tests.simulated_doors import free_udp_port

ALL_S = 300.0


@pytest.mark.parametrize("number", sorted(n for n, m in mav.mavlink_map.items()
                                          if "target_system" in m.ordered_fieldnames))
def test_the_target_of_every_message_is_read_where_it_stands(number: int) -> None:
    message = mav.mavlink_map[number]
    fields = {name: _filled(message, name) for name in message.fieldnames}
    fields |= {"target_system": 7} | ({"target_component": 9} if "target_component" in fields else {})
    frame = Endpoint(3, 4).pack(message(**fields))
    header = Header.of(frame)
    assert (header.system, header.component, header.target_system) == (3, 4, 7)
    assert header.target_component == (9 if "target_component" in fields else 0)


def _filled(message: Any, name: str) -> Any:
    """A value of 1 for any field."""
    at = message.ordered_fieldnames.index(name)
    count = message.array_lengths[at]
    kind = message.fieldtypes[message.fieldnames.index(name)]
    if kind == "char":
        return b"1"
    return [1] * count if count else 1


def test_frames_go_to_whom_they_are_for() -> None:
    ports = free_udp_port(), _two_free_ports()
    doors = Doors(MavlinkSpec(open=[f"udpin://127.0.0.1:{ports[0]}"], open_each=f"udpin://127.0.0.1:{ports[1]}"), 2)
    try:
        with _visitor(ports[0]) as a, _visitor(ports[0]) as b, _visitor(ports[1]) as first:
            a.send(Endpoint(245, 190).pack(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)))
            b.send(Endpoint(255, 230).pack(mav.MAVLink_mission_request_list_message(2, 1)))
            first.send(Endpoint(244, 190).pack(mav.MAVLink_mission_request_list_message(2, 1)))
            came: dict[int, list[bytes]] = {}
            while doors.wait(0.5):
                for vehicle_id, frames in doors.receive(0):
                    came.setdefault(vehicle_id, []).extend(frames)
            assert {k: sorted(Header.of(f).system for f in v) for k, v in came.items()} == {1: [245], 2: [245, 255]}
            vehicle = Endpoint(2, 1)
            told = vehicle.pack(mav.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))
            answer = vehicle.pack(mav.MAVLink_mission_count_message(255, 230, 3))
            doors.send(2, [told, answer], 0)
            assert split(a.recv(2048)) == [told]
            assert [b.recv(2048), b.recv(2048)] == [told, answer]
            with pytest.raises(BlockingIOError):
                first.recv(2048)
    finally:
        doors.close()


def _two_free_ports() -> int:
    """The lower one of two neighbours."""
    while True:
        port = free_udp_port()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            try:
                s.bind(("127.0.0.1", port + 1))
            except OSError:
                continue
            return port


@contextmanager
def _visitor(port: int) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.connect(("127.0.0.1", port))
        s.setblocking(False)
        yield s


@pytest.mark.parametrize("url", ["tcp://127.0.0.1:1", "udpin:127.0.0.1:14540", "udpin://127.0.0.1", "udp://:14550"])
def test_what_is_no_door_is_refused_with_a_remedy(url: str) -> None:
    with pytest.raises(UserError, match="write udpin://"):
        Doors(MavlinkSpec(open=[url]), 1)


def test_a_port_that_is_taken_is_refused_and_nothing_stays_open() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        taken, free = s.getsockname()[1], free_udp_port()
        with pytest.raises(UserError, match="free"):
            Doors(MavlinkSpec(open=[f"udpin://127.0.0.1:{free}", f"udpin://127.0.0.1:{taken}"]), 1)
    Doors(MavlinkSpec(open=[f"udpin://127.0.0.1:{free}"]), 1).close()


class Behind:
    """Ten vehicles in a thread of this process, behind real doors, as fast as clients talk to them."""

    def __init__(self, folder: Path, port: int) -> None:
        self.world = DoorWorld(folder, vehicles=10)
        self._carry, self.world._carry = self.world._carry, self._out  # type: ignore[method-assign]
        self.doors = Doors(MavlinkSpec(open=[f"udp://127.0.0.1:{port}"]), 10)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _out(self, k: int, topic: Any, message: Any) -> None:
        if topic is topics.DOOR_UP:
            self.doors.send(k, message.frames, self.world.t_ns)
        else:
            self._carry(k, topic, message)

    def _run(self) -> None:
        while not self._stop.is_set():
            self.doors.wait(0.02)
            for vehicle_id, frames in self.doors.receive(self.world.t_ns):
                self.world.inbox[vehicle_id].append(Delivery(topics.DOOR_DOWN, str(vehicle_id), BRIDGE,
                                                             self.world.t_ns, MavlinkFrames(frames=frames)))
            self.world.tick()

    def __enter__(self) -> Behind:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()
        self.doors.close()


async def _all_found_and_one_armed(port: int) -> tuple[set[int], list[bool]]:
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as client:
        await client.add_any_connection(f"udpin://127.0.0.1:{port}")
        systems: list[Any] = []
        while len(systems) < 10:
            systems = await client.get_systems()
            await asyncio.sleep(0)
        by_id = {await s.get_system_id(): s for s in systems}
        chosen = by_id[4]
        await ActionAsync(chosen).arm()
        armed = []
        for k in sorted(by_id):
            async for state in TelemetryAsync(by_id[k]).subscribe_armed():
                if state == (k == 4):
                    armed.append(state)
                    break
        return set(by_id), armed


def test_ten_vehicles_behind_one_door_are_found_and_a_command_reaches_exactly_one(tmp_path: Path) -> None:
    port = free_udp_port()
    with Behind(tmp_path, port) as behind:
        found, armed = asyncio.run(asyncio.wait_for(_all_found_and_one_armed(port), ALL_S))
    assert found == set(range(1, 11))
    assert armed == [k == 4 for k in range(1, 11)]
    assert [v.executor.armed for v in behind.world.vehicles.values()] == armed
