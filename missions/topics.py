"""The topic table: key, message type, and whether the topic belongs to the lock-step of simulated time.

Nothing else in the project spells a key.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import msgspec

from missions import live
from missions import messages as m

M = TypeVar("M", bound=msgspec.Struct)
ROOT = "swarmscan"


@dataclass(frozen=True)
class Topic(Generic[M]):
    """A family of keys `swarmscan/{fleet}/{path}`; `{id}` in the path stands for a vehicle id or a process name."""

    path: str
    type: type[M]
    lockstep: bool
    plain_json: bool = False
    """For programs of any kind: the payload is the message as JSON and nothing else. Lost where a receiver is slow."""

    def key(self, fleet: str, who: int | str = "") -> str:
        """The concrete key."""
        return f"{ROOT}/{fleet}/" + self.path.replace("{id}", str(who))

    def wildcard(self, fleet: str) -> str:
        """The key expression that matches every id."""
        return self.key(fleet, "*")


# the clock itself
JOIN = Topic("clock/join/{id}", m.Join, lockstep=False)
WELCOME = Topic("clock/welcome/{id}", m.Welcome, lockstep=False)
TICK = Topic("clock/tick", m.Tick, lockstep=False)
TICK_DONE = Topic("clock/done/{id}", m.TickDone, lockstep=False)

# vehicle to ground
MAVLINK_UP = Topic("v/{id}/mavlink/up", m.MavlinkFrames, lockstep=True)
PLAN_VERDICT = Topic("v/{id}/plan/verdict", m.PlanVerdict, lockstep=True)
FENCE_VERDICT = Topic("v/{id}/fence/verdict", m.FenceVerdict, lockstep=True)
LEG_REPORT = Topic("v/{id}/leg", m.LegReport, lockstep=True)
PICTURE_CHUNK = Topic("v/{id}/picture", m.PictureChunk, lockstep=True)
RANGE_HITS = Topic("v/{id}/hits", m.RangeHits, lockstep=True)

# ground to vehicle
MAVLINK_DOWN = Topic("g/{id}/mavlink/down", m.MavlinkFrames, lockstep=True)
PLAN_HASH = Topic("g/{id}/plan/hash", m.PlanHash, lockstep=True)
FENCE_ORDER = Topic("g/{id}/fence", m.FenceOrder, lockstep=True)
PICTURE_ACK = Topic("g/{id}/picture/ack", m.PictureAck, lockstep=True)
BATTERY_SWAP = Topic("g/{id}/battery", m.BatterySwap, lockstep=True)
MAP_SNAPSHOT = Topic("g/map", m.MapSnapshot, lockstep=True)

# vehicle to everybody (teammates, ground, referee)
VEHICLE_STATE = Topic("v/{id}/state", m.VehicleState, lockstep=True)
ANNOUNCED = Topic("v/{id}/announced", m.AnnouncedTrajectory, lockstep=True)

# vehicle and its simulated sensors
SHUTTER = Topic("v/{id}/shutter", m.ShutterRequest, lockstep=True)
SENSOR_PICTURE = Topic("w/{id}/picture", m.SensorPicture, lockstep=True)
RANGE_SCAN = Topic("w/{id}/range", m.RangeScan, lockstep=True)

# vehicle and other ground stations, through the bridge's doors
DOOR_UP = Topic("v/{id}/door/up", m.MavlinkFrames, lockstep=True)
DOOR_DOWN = Topic("w/{id}/door/down", m.MavlinkFrames, lockstep=True)

# for people
STATUS = Topic("g/status", m.Status, lockstep=False)
LIVE_HELLO = Topic("g/live/hello", live.LiveHello, lockstep=False, plain_json=True)
LIVE_UPDATE = Topic("g/live/update", live.LiveUpdate, lockstep=False, plain_json=True)
OPERATOR_COMMAND = Topic("g/live/command", live.OperatorCommand, lockstep=False, plain_json=True)
OPERATOR_ANSWER = Topic("g/live/answer", live.OperatorAnswer, lockstep=False, plain_json=True)
