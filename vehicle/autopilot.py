"""The MAVLink face of the vehicle: telemetry out, commands in."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions.frames import Site, heading_deg_from_yaw_enu, ned_from_enu
from missions.mavlink import AUTOPILOT_COMPONENT, Endpoint
from missions.messages import PictureMeta
from vehicle.executor import EMERGENCY, HOLD, LAND, MISSION, RETURN, STANDBY, TAKEOFF, Executor
from vehicle.mission_service import MissionService
from vehicle.simulator import NS, Kinematics, vector

SLOW_NS, FAST_NS = NS, NS // 5
_PX4_MODES = {STANDBY: (4, 3), TAKEOFF: (4, 2), MISSION: (4, 4), HOLD: (4, 3), RETURN: (4, 5), LAND: (4, 6),
              EMERGENCY: (4, 6)}
"""PX4's main and sub mode numbers (AUTO.LOITER, TAKEOFF, MISSION, RTL, LAND)."""
_LANDED = {STANDBY: mav.MAV_LANDED_STATE_ON_GROUND, TAKEOFF: mav.MAV_LANDED_STATE_TAKEOFF,
           LAND: mav.MAV_LANDED_STATE_LANDING, EMERGENCY: mav.MAV_LANDED_STATE_LANDING}
_SENSORS = (mav.MAV_SYS_STATUS_SENSOR_3D_GYRO | mav.MAV_SYS_STATUS_SENSOR_3D_ACCEL | mav.MAV_SYS_STATUS_SENSOR_3D_MAG
            | mav.MAV_SYS_STATUS_SENSOR_GPS | mav.MAV_SYS_STATUS_PREARM_CHECK)
_ACCEPTED, _DENIED, _REJECTED = (mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_DENIED, mav.MAV_RESULT_TEMPORARILY_REJECTED)


@dataclass
class _Due:
    every_ns: int
    next_ns: int = 0

    def now(self, t_ns: int) -> bool:
        if t_ns < self.next_ns:
            return False
        self.next_ns = (t_ns // self.every_ns + 1) * self.every_ns
        return True


class Autopilot:
    """Speaks MAVLink 2 as a PX4 quadrotor with this system id."""

    def __init__(self, vehicle_id: int, site: Site, executor: Executor, missions: MissionService) -> None:
        self.endpoint = Endpoint(vehicle_id, AUTOPILOT_COMPONENT)
        self.armed = False
        self._system = vehicle_id
        self._site, self._executor, self._missions = site, executor, missions
        self._slow, self._fast = _Due(SLOW_NS), _Due(FAST_NS)
        self._queue: list[mav.MAVLink_message] = []
        self._pictures = 0
        self._images: list[mav.MAVLink_message] = []

    def receive(self, frames: list[bytes], t_ns: int) -> None:
        """Handle incoming frames; answers go out with the next `frames`."""
        for message in self.endpoint.parse(frames):
            answers = self._missions.handle(message, t_ns)
            if answers is not None:
                self._queue += answers
            elif message.get_type() == "COMMAND_LONG" and message.target_system in (0, self._system):
                self._command(message, t_ns)

    def text(self, text: str, severity: int = mav.MAV_SEVERITY_INFO) -> None:
        """A line for people."""
        self._queue.append(mav.MAVLink_statustext_message(severity, text.encode()[:50]))

    def reached(self, items: list[int]) -> None:
        """These mission items are done."""
        self._queue += [mav.MAVLink_mission_item_reached_message(seq) for seq in items]
        if items:
            self._missions.current = min(items[-1] + 1, max(0, len(self._missions.items) - 1))
            self._queue.append(mav.MAVLink_mission_current_message(self._missions.current))

    def captured(self, meta: PictureMeta) -> None:
        """A picture is in storage."""
        lat, lon, alt, relative = self._geodetic(meta.pose.position_enu_m)
        quaternion = [float(q) for q in meta.pose.quaternion_wxyz]
        message = mav.MAVLink_camera_image_captured_message(
            meta.t_capture_ns // 1_000_000, 0, 0, lat, lon, alt, relative, quaternion, self._pictures, 1,
            f"view/{meta.view_id}".encode())
        self._pictures += 1
        self._images.append(message)
        self._queue.append(message)

    def frames(self, now: Kinematics, t_ns: int) -> list[bytes]:
        """Everything that is due now, packed."""
        self._queue += self._missions.poll(t_ns)
        if self._slow.now(t_ns):
            self._queue += self._status()
        if self._fast.now(t_ns):
            self._queue += self._motion(now, t_ns)
        out = [self.endpoint.pack(message) for message in self._queue]
        self._queue.clear()
        return out

    def _status(self) -> list[mav.MAVLink_message]:
        executor = self._executor
        base = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mav.MAV_MODE_FLAG_AUTO_ENABLED
        base |= mav.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
        main, sub = _PX4_MODES[executor.mode]
        state = mav.MAV_STATE_ACTIVE if executor.flying else mav.MAV_STATE_STANDBY
        state = mav.MAV_STATE_EMERGENCY if executor.mode == EMERGENCY else state
        percent = round(executor.battery.level_percent)
        return [
            mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PX4, base,
                                          main << 16 | sub << 24, state, 3),
            mav.MAVLink_sys_status_message(_SENSORS, _SENSORS, _SENSORS, 0, 0, -1, percent, 0, 0, 0, 0, 0, 0),
            mav.MAVLink_battery_status_message(0, mav.MAV_BATTERY_FUNCTION_ALL, mav.MAV_BATTERY_TYPE_LIPO, 32767,
                                               [65535] * 10, -1, -1, -1, percent, 0, self._charge_state(), [0] * 4),
            mav.MAVLink_extended_sys_state_message(mav.MAV_VTOL_STATE_UNDEFINED,
                                                   _LANDED.get(executor.mode, mav.MAV_LANDED_STATE_IN_AIR)),
            mav.MAVLink_mission_current_message(self._missions.current),
        ]

    def _charge_state(self) -> int:
        executor = self._executor
        low = executor.battery.level_percent <= executor.threshold_percent
        states = {True: mav.MAV_BATTERY_CHARGE_STATE_LOW, False: mav.MAV_BATTERY_CHARGE_STATE_OK}
        return int(mav.MAV_BATTERY_CHARGE_STATE_EMERGENCY if executor.mode == EMERGENCY else states[low])

    def _motion(self, now: Kinematics, t_ns: int) -> list[mav.MAVLink_message]:
        ms = t_ns // 1_000_000
        lat, lon, alt, relative = self._geodetic(vector(now.state.position))
        p, v = ned_from_enu(now.state.position), ned_from_enu(now.state.velocity)
        centimetres = [round(100.0 * float(c)) for c in v]
        heading = heading_deg_from_yaw_enu(now.yaw_enu_rad)
        return [
            mav.MAVLink_global_position_int_message(ms, lat, lon, alt, relative, *centimetres,
                                                    round(heading * 100) % 36000),
            mav.MAVLink_local_position_ned_message(ms, *(float(c) for c in (*p, *v))),
            mav.MAVLink_attitude_message(ms, 0.0, 0.0, math.remainder(math.radians(heading), math.tau), 0.0, 0.0, 0.0),
        ]

    def _command(self, message: Any, t_ns: int) -> None:
        """Acknowledge to the sender first, then send what was asked for; commands may come twice."""
        handler = _COMMANDS.get(message.command)
        result, answers = handler(self, message, t_ns) if handler else (mav.MAV_RESULT_UNSUPPORTED, [])
        self._queue.append(mav.MAVLink_command_ack_message(
            message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()))
        self._queue += answers

    def _arm(self, message: Any, t_ns: int) -> tuple[int, list[mav.MAVLink_message]]:
        if message.param1 == 0.0 and self._executor.flying:
            return _DENIED, []  # also when forced: propellers stay on in flight
        self.armed = message.param1 != 0.0
        return _ACCEPTED, []

    def _start(self, message: Any, t_ns: int) -> tuple[int, list[mav.MAVLink_message]]:
        if not self._executor.start():
            return _REJECTED, []
        self.armed = True
        return _ACCEPTED, []

    def _pause(self, message: Any, t_ns: int) -> tuple[int, list[mav.MAVLink_message]]:
        if message.param1 == 0.0:
            self._executor.hold(t_ns)
            return _ACCEPTED, []
        return self._start(message, t_ns) if self._executor.flying else (_REJECTED, [])

    def _return(self, message: Any, t_ns: int) -> tuple[int, list[mav.MAVLink_message]]:
        self._executor.go_home(t_ns)
        return _ACCEPTED, []

    def _land(self, message: Any, t_ns: int) -> tuple[int, list[mav.MAVLink_message]]:
        self._executor.land_here(t_ns)
        return _ACCEPTED, []

    def _request(self, message: Any, t_ns: int) -> tuple[int, list[mav.MAVLink_message]]:
        wanted = int(message.param1)
        if wanted == mav.MAVLINK_MSG_ID_HOME_POSITION:
            return _ACCEPTED, [self._home()]
        if wanted == mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            return _ACCEPTED, [self._version()]
        if wanted == mav.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED and 0 <= int(message.param2) < len(self._images):
            return _ACCEPTED, [self._images[int(message.param2)]]
        return mav.MAV_RESULT_UNSUPPORTED, []

    def _home(self) -> mav.MAVLink_message:
        lat, lon, alt, _ = self._geodetic(vector(self._executor.pad))
        north, east, down = (float(c) for c in ned_from_enu(self._executor.pad))
        return mav.MAVLink_home_position_message(lat, lon, alt, north, east, down, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)

    def _version(self) -> mav.MAVLink_message:
        can = (mav.MAV_PROTOCOL_CAPABILITY_MISSION_INT | mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2
               | mav.MAV_PROTOCOL_CAPABILITY_COMMAND_INT)
        nothing = [0] * 8
        return mav.MAVLink_autopilot_version_message(can, 0, 0, 0, 0, nothing, nothing, nothing, 0, 0,
                                                     self._system)

    def _geodetic(self, position_enu_m: tuple[float, float, float]) -> tuple[int, int, int, int]:
        """degE7, degE7, mm AMSL, mm above home."""
        lat, lon, alt = self._site.geodetic_from_enu(np.array(position_enu_m))
        above = position_enu_m[2] - float(self._executor.pad[2])
        return round(lat * 1e7), round(lon * 1e7), round(alt * 1000), round(above * 1000)


_COMMANDS: dict[int, Callable[[Autopilot, Any, int], tuple[int, list[mav.MAVLink_message]]]] = {
    mav.MAV_CMD_COMPONENT_ARM_DISARM: Autopilot._arm,
    mav.MAV_CMD_NAV_TAKEOFF: Autopilot._start,
    mav.MAV_CMD_MISSION_START: Autopilot._start,
    mav.MAV_CMD_DO_PAUSE_CONTINUE: Autopilot._pause,
    mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: Autopilot._return,
    mav.MAV_CMD_NAV_LAND: Autopilot._land,
    mav.MAV_CMD_REQUEST_MESSAGE: Autopilot._request,
}
