"""The world of one process (vehicle_world) with doors: other people's clients talk to vehicles in simulated time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions import topics
from missions.bus import Delivery
from missions.clock import BRIDGE
from missions.mavlink import Endpoint, Item, item_message
from missions.messages import MavlinkFrames
from missions.mission import BatterySpec, FleetSpec, MavlinkSpec, Mission
from missions.simulation import ClockSpec
from tests.vehicle_world import NS, World, open_map

GCS = (245, 190)
NAN = float("nan")
ACCEPTED, DENIED, UNSUPPORTED = mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_DENIED, mav.MAV_RESULT_UNSUPPORTED
CAMERA, GIMBAL = mav.MAV_COMP_ID_CAMERA, mav.MAV_COMP_ID_GIMBAL
IDENTITIES: tuple[Literal["px4", "ardupilot"], ...] = ("px4", "ardupilot")


def mission_with_doors(identity: Literal["px4", "ardupilot"] = "px4", vehicles: int = 1) -> Mission:
    """Vehicles that others may talk to."""
    return Mission(title="doors", fleet=FleetSpec(vehicles=vehicles), battery=BatterySpec(model="distance"),
                   clock=ClockSpec(tick_s=0.1),
                   mavlink=MavlinkSpec(open=["udpin://127.0.0.1:14540"], identity=identity))


class Client:
    """A ground station at the doors of one vehicle."""

    def __init__(self, world: DoorWorld, to: int = 1, ids: tuple[int, int] = GCS) -> None:
        self.world, self.to, self.ids = world, to, ids
        self.endpoint = Endpoint(*ids)
        self.heard: list[Any] = []

    def tell(self, *messages: Any) -> None:
        """Frames through the door."""
        frames = [self.endpoint.pack(m) for m in messages]
        self.world.inbox[self.to].append(Delivery(topics.DOOR_DOWN, str(self.to), BRIDGE, self.world.t_ns,
                                                  MavlinkFrames(frames=frames)))

    def command(self, command: int, *params: float, component: int = 1) -> int:
        """COMMAND_LONG; the result it is acknowledged with."""
        values = [*params, *([0.0] * (7 - len(params)))]
        self.tell(mav.MAVLink_command_long_message(self.to, component, command, 0, *values))
        ack = self.wait(lambda m: m.get_type() == "COMMAND_ACK" and m.command == command
                        and (m.target_system, m.target_component) == self.ids)
        return int(ack.result)

    def ask(self, number: int, component: int = 1, param2: float = 0.0) -> Any:
        """REQUEST_MESSAGE; the message, or the result when it is refused."""
        seen = len(self.heard)
        result = self.command(mav.MAV_CMD_REQUEST_MESSAGE, float(number), param2, component=component)
        if result != mav.MAV_RESULT_ACCEPTED:
            return result
        return next(m for m in self.heard[seen:] if m.get_msgId() == number)

    def wait(self, fits: Callable[[Any], bool], seconds: float = 3.0) -> Any:
        """The first message from now on that fits."""
        seen = len(self.heard)
        assert self.world.run(seconds, until=lambda: any(fits(m) for m in self.heard[seen:])), "nothing came"
        return next(m for m in self.heard[seen:] if fits(m))

    def upload(self, items: list[Item], kind: int = mav.MAV_MISSION_TYPE_MISSION) -> int:
        """A whole list of items, one by one as it is asked for; the result."""
        self.tell(mav.MAVLink_mission_count_message(self.to, 1, len(items), kind))
        while True:
            m = self.wait(lambda m: m.get_type() in ("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK")
                          and m.target_system == self.ids[0])
            if m.get_type() == "MISSION_ACK":
                return int(m.type)
            self.tell(item_message(items[m.seq], m.seq, self.to, 1, kind))

    def download(self, kind: int = mav.MAV_MISSION_TYPE_MISSION) -> list[Any]:
        """All items, as messages."""
        self.tell(mav.MAVLink_mission_request_list_message(self.to, 1, kind))
        count = self.wait(lambda m: m.get_type() == "MISSION_COUNT").count
        items = []
        for seq in range(count):
            self.tell(mav.MAVLink_mission_request_int_message(self.to, 1, seq, kind))
            items.append(self.wait(lambda m: m.get_type() == "MISSION_ITEM_INT"))
        return items

    def last(self, kind: str, component: int | None = None) -> Any:
        """The newest message of a type."""
        return next(m for m in reversed(self.heard) if m.get_type() == kind
                    and component in (None, m.get_srcComponent()))


class DoorWorld(World):
    """Vehicles in open, known space; no ground station of ours unless it is asked for."""

    def __init__(self, folder: Path, identity: Literal["px4", "ardupilot"] = "px4", vehicles: int = 1,
                 ground: bool = False, **changes: Any) -> None:
        super().__init__(msgspec.structs.replace(mission_with_doors(identity, vehicles), **changes), folder)
        self.clients: list[Client] = []
        self.ground_alive = ground
        self.share_map(open_map(self.mission))
        self.tick()

    def client(self, to: int = 1, ids: tuple[int, int] = GCS) -> Client:
        """One more client; it tells that it is there once a second."""
        client = Client(self, to, ids)
        self.clients.append(client)
        return client

    def tick(self) -> None:
        """One tick, with the heartbeats of all clients."""
        if self.t_ns // NS != (self.t_ns - 100_000_000) // NS:
            for client in getattr(self, "clients", []):
                client.tell(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3))
        super().tick()

    def _carry(self, k: int, topic: Any, message: Any) -> None:
        if topic is not topics.DOOR_UP:
            super()._carry(k, topic, message)
            return
        for client in self.clients:
            if client.to == k:
                client.heard += Endpoint(*client.ids).parse(message.frames)


def waypoint(world: DoorWorld, point: tuple[float, float, float], *, frame: int = mav.MAV_FRAME_GLOBAL_INT,
             yaw_deg: float = NAN, hold_s: float = 1.0) -> Item:
    lat, lon, alt = world.site.geodetic_from_enu(np.array(point))
    up = alt if frame in (0, 5) else point[2] - 0.2
    return Item(frame, mav.MAV_CMD_NAV_WAYPOINT, (hold_s, 0.0, 0.0, yaw_deg), round(lat * 1e7), round(lon * 1e7), up)


def action(command: int, *params: float, x: int = 0) -> Item:
    p = [*params, *([0.0] * (4 - len(params)))]
    return Item(mav.MAV_FRAME_MISSION, command, (p[0], p[1], p[2], p[3]), x, 0, 0.0)


def take_off(client: Client) -> None:
    """Armed, up, and hovering."""
    assert client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == ACCEPTED
    assert client.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, NAN) == ACCEPTED
    assert client.world.run(20.0, until=lambda: client.world.vehicles[1].executor.mode == "hold")


def flight_plan(world: DoorWorld) -> list[Item]:
    """Two views, and home."""
    return [waypoint(world, (6.0, -13.0, 5.0), yaw_deg=0.0),
            action(mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, -30.0, 0.0, NAN, NAN, x=12),
            action(mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0, 0.0),
            waypoint(world, (-6.0, -13.0, 6.0), frame=mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT),
            action(mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0, 1.0),
            action(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH, NAN, NAN, NAN, NAN)]
