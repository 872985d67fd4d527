"""The MAVLink edge: routes to mission items and back, plan identity, frames in and out.

NED, degrees, degE7 and millimetres exist only here and in the endpoints that fill telemetry messages. A waypoint
with a picture becomes four items, as recommended for free viewpoints:
NAV_WAYPOINT, DO_GIMBAL_MANAGER_PITCHYAW, NAV_DELAY (only when the vehicle is to stop) or DO_CHANGE_SPEED (only when it
is to pass slowly), IMAGE_START_CAPTURE.
"""

from __future__ import annotations

import hashlib
import math
import struct
from typing import Any

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions.errors import ProtocolError
from missions.frames import Site, heading_deg_from_yaw_enu, yaw_enu_from_heading_deg
from missions.signing import Signing

GROUND_SYSTEM, GROUND_COMPONENT = 255, mav.MAV_COMP_ID_MISSIONPLANNER
AUTOPILOT_COMPONENT = mav.MAV_COMP_ID_AUTOPILOT1
LEAST_PASS_M = 0.01
"""Acceptance radius of a waypoint that is passed exactly; 0 means stop."""
CAMERA_MODES = {"explore": mav.CAMERA_MODE_IMAGE, "survey": mav.CAMERA_MODE_IMAGE_SURVEY}
_PHASES = {mode: phase for phase, mode in CAMERA_MODES.items()}
GROUND_SPEED = float(mav.SPEED_TYPE_GROUNDSPEED)
NAN = float("nan")


class Waypoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One point of a route. With a view_id a picture is taken there; with stop the vehicle comes to rest first, else
    it may cut the corner by pass_m and passes at speed_m_s or slower (0: as fast as it likes)."""

    position_enu_m: tuple[float, float, float]
    yaw_enu_rad: float
    gimbal_elevation_rad: float = 0.0
    view_id: int | None = None
    stop: bool = True
    settle_s: float = 0.0
    pass_m: float = 0.0
    speed_m_s: float = 0.0


class Route(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A whole plan for one vehicle. phase chooses the camera mode; home_after returns to launch at the end."""

    plan_id: int
    phase: str
    waypoints: list[Waypoint]
    home_after: bool = False


class Item(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The fields of MISSION_ITEM_INT that make a plan what it is."""

    frame: int
    command: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float


def items_from_route(route: Route, site: Site) -> list[Item]:
    """Mission items of a route, altitudes AMSL (MAV_FRAME_GLOBAL_INT)."""
    items = [_action(mav.MAV_CMD_SET_CAMERA_MODE, (0.0, float(CAMERA_MODES[route.phase]), NAN, NAN))]
    for w in route.waypoints:
        lat, lon, alt = site.geodetic_from_enu(_array(w.position_enu_m))
        radius = 0.0 if w.stop else _single(max(w.pass_m, LEAST_PASS_M))
        heading = _single(heading_deg_from_yaw_enu(w.yaw_enu_rad))
        items.append(Item(mav.MAV_FRAME_GLOBAL_INT, mav.MAV_CMD_NAV_WAYPOINT, (0.0, radius, 0.0, heading),
                          round(lat * 1e7), round(lon * 1e7), _single(alt)))
        pitch = _single(math.degrees(w.gimbal_elevation_rad))
        items.append(_action(mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, (pitch, 0.0, NAN, NAN)))
        if w.stop and w.settle_s > 0:
            items.append(_action(mav.MAV_CMD_NAV_DELAY, (_single(w.settle_s), -1.0, -1.0, -1.0)))
        elif not w.stop and w.speed_m_s > 0:
            items.append(_action(mav.MAV_CMD_DO_CHANGE_SPEED, (GROUND_SPEED, _single(w.speed_m_s), -1.0, 0.0)))
        if w.view_id is not None:
            items.append(_action(mav.MAV_CMD_IMAGE_START_CAPTURE, (0.0, 0.0, 1.0, float(w.view_id))))
    if route.home_after:
        items.append(_action(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH, (0.0, 0.0, 0.0, 0.0)))
    return items


def route_from_items(items: list[Item], site: Site, plan_id: int) -> Route:
    """The route that these items describe. Raises ProtocolError at anything a vehicle of ours does not fly."""
    phase, home_after = "explore", False
    points: list[dict[str, Any]] = []
    for seq, item in enumerate(items):
        p = item.params
        if item.command == mav.MAV_CMD_NAV_WAYPOINT:
            points.append(_waypoint_fields(seq, item, site))
        elif item.command == mav.MAV_CMD_SET_CAMERA_MODE and p[1] in _PHASES:
            phase = _PHASES[int(p[1])]
        elif item.command == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            home_after = True
        elif not points:
            raise ProtocolError(f"item {seq}: command {item.command} before the first waypoint")
        elif item.command == mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW:
            points[-1]["gimbal_elevation_rad"] = math.radians(p[0])
        elif item.command == mav.MAV_CMD_NAV_DELAY:
            points[-1]["settle_s"] = p[0]
        elif item.command == mav.MAV_CMD_DO_CHANGE_SPEED and p[0] == GROUND_SPEED:
            points[-1]["speed_m_s"] = p[1]
        elif item.command == mav.MAV_CMD_IMAGE_START_CAPTURE:
            points[-1]["view_id"] = int(p[3])
        else:
            raise ProtocolError(f"item {seq}: command {item.command} is not flown by this vehicle")
    return Route(plan_id=plan_id, phase=phase, waypoints=[Waypoint(**f) for f in points], home_after=home_after)


def plan_sha256(items: list[Item]) -> str:
    """Identity of a plan: SHA-256 over the canonical items, hex."""
    return hashlib.sha256(msgspec.msgpack.encode(items)).hexdigest()


def item_message(item: Item, seq: int, system: int, component: int,
                 mission_type: int = mav.MAV_MISSION_TYPE_MISSION) -> mav.MAVLink_message:
    """MISSION_ITEM_INT for this target."""
    return mav.MAVLink_mission_item_int_message(
        system, component, seq, item.frame, item.command, int(seq == 0), 1, *item.params, item.x, item.y, item.z,
        mission_type)


def item_from_message(message: Any) -> Item:
    """The plan-relevant fields of a received MISSION_ITEM_INT, or of a MISSION_ITEM, whose degrees are floats."""
    x, y = message.x, message.y
    if message.get_type() == "MISSION_ITEM":
        scale = 1.0 if message.frame == mav.MAV_FRAME_MISSION else 1e7
        x, y = round(x * scale), round(y * scale)
    return Item(message.frame, message.command, (message.param1, message.param2, message.param3, message.param4),
                x, y, message.z)


class Endpoint:
    """Packs and parses MAVLink 2 frames for one system and component; with signing only those of who holds the key."""

    def __init__(self, system: int, component: int, signing: Signing | None = None) -> None:
        self._signing = signing
        self._mav = mav.MAVLink(None, srcSystem=system, srcComponent=component)
        self._mav.robust_parsing = True
        self.rejected = 0

    def pack(self, message: mav.MAVLink_message) -> bytes:
        """The frame, with this endpoint's next sequence number."""
        frame = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame if self._signing is None else self._signing.signed(frame, message.crc_extra)

    def parse(self, frames: list[bytes]) -> list[Any]:
        """The messages in these frames; what fails its CRC, or is not rightly signed, is counted and left out."""
        out = []
        for frame in frames:
            for message in self._mav.parse_buffer(frame) or []:
                bad = message.get_type() == "BAD_DATA"
                if bad or not (self._signing is None or self._signing.accepts(bytes(message.get_msgbuf()))):
                    self.rejected += 1
                else:
                    out.append(message)
        return out


def _waypoint_fields(seq: int, item: Item, site: Site) -> dict[str, Any]:
    if item.frame not in (mav.MAV_FRAME_GLOBAL, mav.MAV_FRAME_GLOBAL_INT):
        raise ProtocolError(f"item {seq}: frame {item.frame} is not supported; use MAV_FRAME_GLOBAL_INT (AMSL)")
    if not math.isfinite(item.z) or not math.isfinite(item.params[3]):
        raise ProtocolError(f"item {seq}: altitude and heading must be numbers")
    position = site.enu_from_geodetic(item.x / 1e7, item.y / 1e7, item.z)
    return {"position_enu_m": (float(position[0]), float(position[1]), float(position[2])),
            "yaw_enu_rad": yaw_enu_from_heading_deg(item.params[3]), "stop": item.params[1] == 0.0,
            "pass_m": item.params[1] if item.params[1] > LEAST_PASS_M else 0.0}


def _action(command: int, params: tuple[float, float, float, float]) -> Item:
    return Item(mav.MAV_FRAME_MISSION, command, params, 0, 0, 0.0)


def _single(value: float) -> float:
    """The float32 that will travel, so that both sides hash the same number."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def _array(position: tuple[float, float, float]) -> Any:
    return np.array(position)
