"""A telemetry log as Foxglove's messages: poses, places, trails, plans, batteries and what vehicles say."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from foxglove import messages as fox
from pymavlink.dialects.v20 import common as mav

from ground_station.mcap_shapes import SITE, Event, Stamps, colour_of, line, pose, transform
from missions.frames import Array, Site, yaw_enu_from_heading_deg
from missions.mavlink import AUTOPILOT_COMPONENT, item_from_message

TRAIL_S = 5.0
PLAN_OPACITY = 0.4
_LEVELS = {mav.MAV_SEVERITY_EMERGENCY: fox.LogLevel.Fatal, mav.MAV_SEVERITY_ALERT: fox.LogLevel.Fatal,
           mav.MAV_SEVERITY_CRITICAL: fox.LogLevel.Error, mav.MAV_SEVERITY_ERROR: fox.LogLevel.Error,
           mav.MAV_SEVERITY_WARNING: fox.LogLevel.Warning}


@dataclass
class _Vehicle:
    """What is known of one vehicle while its messages are read."""

    yaw_enu_rad: float = 0.0
    home_up_m: float = 0.0
    trail: list[Array] = field(default_factory=list)
    trails: int = 0
    trail_begin_s: float = 0.0
    plan: dict[int, Array] = field(default_factory=dict)


class Flights:
    """Reads messages in order and tells what they show."""

    def __init__(self, anchor: Site, stamps: Stamps) -> None:
        self._anchor, self._stamps = anchor, stamps
        self._vehicles: dict[int, _Vehicle] = {}

    def events(self, log: Iterable[tuple[float, Any]]) -> Iterator[Event]:
        """log: (simulated time in s, message)."""
        for t_s, message in log:
            if message.get_srcComponent() != AUTOPILOT_COMPONENT:
                self._hear_ground(message)
            elif message.get_type() in _HANDLERS:
                system = message.get_srcSystem()
                vehicle = self._vehicles.setdefault(system, _Vehicle(trail_begin_s=t_s))
                yield from _HANDLERS[message.get_type()](self, t_s, system, vehicle, message)

    def _hear_ground(self, message: Any) -> None:
        """Plans on their way up, whoever sends them."""
        kind = message.get_type()
        if kind not in ("MISSION_COUNT", "MISSION_ITEM_INT") or message.mission_type != mav.MAV_MISSION_TYPE_MISSION:
            return
        vehicle = self._vehicles.setdefault(message.target_system, _Vehicle())
        if kind == "MISSION_COUNT":
            vehicle.plan.clear()
        elif message.command == mav.MAV_CMD_NAV_WAYPOINT:
            item = item_from_message(message)
            above_home = item.frame in (mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
            height_m = item.z + (self._anchor.alt_m + vehicle.home_up_m if above_home else 0.0)
            vehicle.plan[message.seq] = self._anchor.enu_from_geodetic(item.x / 1e7, item.y / 1e7, height_m)

    def _home(self, t_s: float, system: int, vehicle: _Vehicle, message: Any) -> Iterator[Event]:
        vehicle.home_up_m = -message.z
        yield from ()

    def _position(self, t_s: float, system: int, vehicle: _Vehicle, message: Any) -> Iterator[Event]:
        at, stamp = np.array([message.y, message.x, -message.z], dtype=np.float64), self._stamps(t_s)
        half = 0.5 * vehicle.yaw_enu_rad
        turned = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
        yield Event(t_s, "/tf", transform(stamp, f"uav{system}", at, turned))
        yield Event(t_s, f"/uav{system}/pose",
                    fox.PoseInFrame(timestamp=stamp, frame_id=SITE, pose=pose(at, turned)))
        vehicle.trail.append(at)
        if t_s >= vehicle.trail_begin_s + TRAIL_S:
            vehicle.trails += 1
            yield Event(t_s, f"/uav{system}/trail",
                        line(stamp, f"trail {vehicle.trails}", np.array(vehicle.trail), colour_of(system)))
            vehicle.trail, vehicle.trail_begin_s = [at], t_s

    def _place(self, t_s: float, system: int, vehicle: _Vehicle, message: Any) -> Iterator[Event]:
        yield Event(t_s, f"/uav{system}/location", fox.LocationFix(
            timestamp=self._stamps(t_s), frame_id=f"uav{system}", latitude=message.lat / 1e7,
            longitude=message.lon / 1e7, altitude=message.alt / 1e3))

    def _attitude(self, t_s: float, system: int, vehicle: _Vehicle, message: Any) -> Iterator[Event]:
        vehicle.yaw_enu_rad = yaw_enu_from_heading_deg(math.degrees(message.yaw))
        yield from ()

    def _battery(self, t_s: float, system: int, vehicle: _Vehicle, message: Any) -> Iterator[Event]:
        yield Event(t_s, f"/uav{system}/battery", {"percent": message.battery_remaining})

    def _text(self, t_s: float, system: int, vehicle: _Vehicle, message: Any) -> Iterator[Event]:
        yield Event(t_s, "/log", fox.Log(
            timestamp=self._stamps(t_s), level=_LEVELS.get(message.severity, fox.LogLevel.Info), message=message.text,
            name=f"uav{system}"))

    def _accepted(self, t_s: float, system: int, vehicle: _Vehicle, message: Any) -> Iterator[Event]:
        if message.type == mav.MAV_MISSION_ACCEPTED and vehicle.plan:
            way = np.array([vehicle.plan[seq] for seq in sorted(vehicle.plan)])
            yield Event(t_s, f"/uav{system}/plan",
                        line(self._stamps(t_s), "plan", way, colour_of(system), PLAN_OPACITY))


_Handler = Callable[[Flights, float, int, _Vehicle, Any], Iterator[Event]]
_HANDLERS: dict[str, _Handler] = {
    "LOCAL_POSITION_NED": Flights._position, "GLOBAL_POSITION_INT": Flights._place, "ATTITUDE": Flights._attitude,
    "BATTERY_STATUS": Flights._battery, "STATUSTEXT": Flights._text, "MISSION_ACK": Flights._accepted,
    "HOME_POSITION": Flights._home}
