"""A second implementation of two autopilots, ArduCopter and PX4, as far as a companion computer meets them.

Written from what was observed of both (docs/external_autopilots.md), not from our vehicle's code, so that the companion
is not tested against its own ideas. No socket and no clock: `step` is told the time; serve_autopilot.py has both.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mav

from tests.autopilot_missions import StubMissions
from tests.point_mass import PointMass

DT = 0.02
M_PER_DEG = 111_194.9
COPTER = {"STABILIZE": 0, "AUTO": 3, "GUIDED": 4, "LOITER": 5, "RTL": 6, "LAND": 9, "BRAKE": 17}
PX4 = {"MANUAL": 1 << 16, "POSCTL": 3 << 16, "TAKEOFF": 0x02040000, "HOLD": 0x03040000, "MISSION": 0x04040000,
       "RTL": 0x05040000, "LAND": 0x06040000, "OFFBOARD": 6 << 16}
HOLDS = ("HOLD", "BRAKE", "MANUAL", "POSCTL", "STABILIZE", "AUTO", "MISSION")
"""Modes in which this stub stays where it is in the air; LOITER sinks on a copter without a transmitter."""
ACCEPTED, TEMPORARILY, DENIED, UNSUPPORTED = 0, 1, 2, 3


class AutopilotStub:
    """One autopilot. `kind` is "px4" or "ardupilot"."""

    def __init__(self, kind: str, system: int = 1, at: tuple[float, float, float] = (52.2205, 6.8861, 40.0),
                 ready_s: float | None = None) -> None:
        """at: latitude, longitude, altitude above mean sea level where it stands. ready_s: armable after so long."""
        self.px4, self.system = kind == "px4", system
        self.modes = PX4 if self.px4 else COPTER
        self.ready_s = (6.0 if self.px4 else 41.0) if ready_s is None else ready_s
        self.home, self.local_origin = at, np.array([3.0, -2.0, 0.5])
        """The local frame's origin is not where it stands: it was booted somewhere else."""
        self.air = PointMass()
        self.missions = StubMissions(self.px4, at)
        self.mode, self.armed, self.t = ("HOLD" if self.px4 else "STABILIZE"), False, 0.0
        self.battery_percent: float | None = 100.0
        self.drain_percent_s = 0.0
        self.refuse_arming, self.disarms = "", True
        self.history: list[str] = [self.mode]
        self.armings = self.setpoints = self.refused_disarms = 0
        self.commands: list[int] = []
        self.parameters: dict[str, tuple[float, int]] = dict(_PX4_PARAMETERS if self.px4 else _COPTER_PARAMETERS)
        self.sender = mav.MAVLink(None, srcSystem=system, srcComponent=1)
        self.parser = mav.MAVLink(None)
        self.parser.robust_parsing = True
        self.out: list[bytes] = []
        defaults = {33: 4.0, 32: 4.0, 30: 10.0, 245: 1.0, 147: 0.5, 1: 1.0} if self.px4 else {}
        self._rates: dict[int, float] = {0: 1.0} | defaults
        self._due: dict[int, float] = {}
        self._target: tuple[Any, Any, Any, float] | None = None
        self._target_t, self._stream_t0 = -math.inf, math.inf
        self._takeoff_height: float | None = None
        self._armed_t = self._landed_t = self._critical_t = math.inf
        self._ground_t = -math.inf

    # --- time and motion

    def step(self, t: float) -> list[bytes]:
        """Up to time t; what it sends."""
        while self.t + DT <= t + 1e-9:
            self.t += DT
            self._tick()
        for number, hz in list(self._rates.items()):
            if hz > 0 and self.t >= self._due.get(number, 0.0) - 1e-9:
                self._due[number] = self.t + 1.0 / hz
                self._send_stream(number)
        out, self.out = self.out, []
        return out

    def _tick(self) -> None:
        if self.battery_percent is not None and self.armed:
            self.battery_percent = max(0.0, self.battery_percent - self.drain_percent_s * DT)
        for message in self.missions.step(self.t):
            self._send(message)
        self._fail_safe()
        if not self.armed:
            self.air.rest()
            return
        self._fly()
        self._disarm_on_ground()

    def _fly(self) -> None:
        air, still = self.air, np.zeros(3)
        if self._takeoff_height is not None:
            goal = np.array([*air.position[:2], -self._takeoff_height])
            air.keep_speed(np.array([0.0, 0.0, np.clip(goal[2] - air.position[2], -1.5, 1.5)]), DT)
            if abs(goal[2] - air.position[2]) < 0.3:
                self._takeoff_height = None
                if self.px4:
                    self._set_mode("HOLD")
        elif self.mode in ("OFFBOARD", "GUIDED"):
            self._guided(still)
        elif self.mode in ("LAND", "LOITER"):
            air.keep_speed(np.array([0.0, 0.0, 0.7]), DT)
        elif self.mode == "RTL":
            over = np.linalg.norm(air.position[:2]) < 0.5
            level = np.append(np.clip(-air.position[:2], -3.0, 3.0), 0.7 if over else 0.0)
            air.keep_speed(level, DT)
        elif self.mode in HOLDS and not air.on_ground:
            air.keep_speed(still, DT)

    def _guided(self, still: Any) -> None:
        if self._target is None or self.air.on_ground:
            if not self.air.on_ground:
                self.air.keep_speed(still, DT)
            return
        if not self.px4 and self.t - self._target_t > self.parameters["GUID_TIMEOUT"][0]:
            self.air.keep_speed(still, DT)
            return
        position, velocity, acceleration, yaw = self._target
        age = self.t - self._target_t
        self.air.follow(position + velocity * min(age, 0.1), velocity, acceleration, yaw, DT)

    def _disarm_on_ground(self) -> None:
        if not self.air.on_ground:
            self._landed_t = math.inf
            return
        self._landed_t = min(self._landed_t, self.t)
        waits = self._takeoff_height is not None
        descended = self.mode in ("LAND", "RTL", "LOITER") and self.t - self._landed_t > (2.0 if self.px4 else 0.5)
        forgotten = not waits and self.t - max(self._armed_t, self._landed_t) > 10.0
        if self.disarms and (descended or forgotten):
            self.armed = False
            self._send_stream(0)

    def _fail_safe(self) -> None:
        """Loss of set-points and an empty battery, as each of the two does it."""
        lost = self.t - self._target_t > self._real("COM_OF_LOSS_T") if self.px4 else False
        if self.mode == "OFFBOARD" and lost and self.armed:
            self._set_mode({3: "RTL", 4: "LAND"}.get(int(self._real("COM_OBL_RC_ACT")), "HOLD"))
        if self.px4 and self.armed and self._real("NAV_DLL_ACT") == 2 and self.t - self._ground_t > 10.0 \
                and self.mode not in ("RTL", "LAND"):
            self._set_mode("RTL")
        if self.battery_percent is None or not self.armed or self.mode in ("RTL", "LAND"):
            return
        if self.px4 and self.battery_percent < 7.0:
            self._critical_t = min(self._critical_t, self.t)
            self._set_mode("HOLD" if self.t - self._critical_t < 5.0 else "RTL")
        elif not self.px4 and self.battery_percent < 10.0:
            self._set_mode("RTL")

    def _set_mode(self, mode: str) -> None:
        if mode != self.mode:
            self.mode, self._takeoff_height = mode, None
            self.history.append(mode)
            self._send_stream(0)

    # --- what comes in

    def receive(self, data: bytes) -> None:
        """Bytes from the wire."""
        for message in self.parser.parse_buffer(data) or []:
            if getattr(message, "target_system", self.system) not in (0, self.system):
                continue
            answers = self.missions.handle(message, self.t)
            for answer in answers or []:
                self._send(answer)
            handler = getattr(self, "_on_" + message.get_type().lower(), None)
            if answers is None and handler is not None:
                handler(message)

    def _on_heartbeat(self, m: Any) -> None:
        if m.type == mav.MAV_TYPE_GCS:
            self._ground_t = self.t

    def _on_command_long(self, m: Any) -> None:
        self.commands.append(m.command)
        handler = {511: self._cmd_interval, 400: self._cmd_arm, 176: self._cmd_mode, 22: self._cmd_takeoff,
                   21: lambda _: self._changed("LAND"), 20: lambda _: self._changed("RTL")}.get(m.command)
        if handler is None and m.command == 193 and not self.px4:
            handler = lambda _: self._changed("BRAKE")  # noqa: E731
        result = UNSUPPORTED if handler is None else handler(m)
        self._send(mav.MAVLink_command_ack_message(m.command, result, 0, 0, m.get_srcSystem(), m.get_srcComponent()))

    def _changed(self, mode: str) -> int:
        self._set_mode(mode)
        return ACCEPTED

    def _cmd_interval(self, m: Any) -> int:
        self._rates[int(m.param1)] = 1e6 / m.param2 if m.param2 > 0 else 0.0
        return ACCEPTED

    def _cmd_arm(self, m: Any) -> int:
        if m.param1 == 0.0:
            if not self.air.on_ground:
                self.refused_disarms += 1
                return DENIED
            self.armed = False
            return ACCEPTED
        why = self.refuse_arming or ("" if self.t >= self.ready_s else "still initialising")
        why = why or ("" if self.px4 or self.mode != "AUTO" else "AUTO mode not armable")
        if self.px4 and self._real("NAV_DLL_ACT") > 0 and self.t - self._ground_t > 10.0:
            why = "No connection to the ground control station"
        if why:
            self._send(mav.MAVLink_statustext_message(4, f"Arming denied: {why}".encode()))
            return TEMPORARILY if self.px4 else 4
        if not self.armed:
            self.armed, self._armed_t = True, self.t
            self.armings += 1
            self._send_stream(0)
        return ACCEPTED

    def _cmd_mode(self, m: Any) -> int:
        number = int(m.param2) << 16 | int(m.param3) << 24 if self.px4 else int(m.param2)
        mode = next((name for name, n in self.modes.items() if n == number), None)
        if mode is None or not int(m.param1) & 1:
            return DENIED
        if mode == "OFFBOARD" and not (self.t - self._target_t < 0.5 and self.t - self._stream_t0 >= 0.9):
            return TEMPORARILY
        if mode == "AUTO" and (why := self.missions.startable):
            self._send(mav.MAVLink_statustext_message(3, f"Mode change to AUTO failed: {why}".encode()))
            return 4
        return self._changed(mode)

    def _cmd_takeoff(self, m: Any) -> int:
        if self.px4:
            amsl = m.param7 if math.isfinite(m.param7) else self.home[2] + self._real("MIS_TAKEOFF_ALT")
            self._set_mode("TAKEOFF")
            self._takeoff_height = amsl - self.home[2]
            return ACCEPTED
        if self.mode != "GUIDED" or not self.armed or not self.air.on_ground:
            return 4
        self._takeoff_height = float(m.param7)
        return ACCEPTED

    def _on_set_position_target_local_ned(self, m: Any) -> None:
        self.setpoints += 1
        if self.t - self._target_t > 0.5:
            self._stream_t0 = self.t
        self._target_t = self.t
        position = np.array([m.x, m.y, m.z]) + self.local_origin
        self._target = position, np.array([m.vx, m.vy, m.vz]), np.array([m.afx, m.afy, m.afz]), float(m.yaw)

    def _on_param_request_read(self, m: Any) -> None:
        if m.param_id in self.parameters:
            self._send_parameter(m.param_id)

    def _on_param_set(self, m: Any) -> None:
        if m.param_id not in self.parameters:
            return
        kind, value = self.parameters[m.param_id][1], m.param_value
        if self.px4 and kind == 6:
            value = float(struct.unpack("<i", struct.pack("<f", value))[0])
        self.parameters[m.param_id] = (value, kind)
        self._send_parameter(m.param_id)

    def _send_parameter(self, name: str) -> None:
        value, kind = self.parameters[name]
        if self.px4 and kind == 6:
            value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        self._send(mav.MAVLink_param_value_message(name.encode(), value, kind, len(self.parameters), 0))

    def _real(self, name: str) -> float:
        return self.parameters[name][0]

    # --- what goes out

    def _send(self, message: Any) -> None:
        self.out.append(bytes(message.pack(self.sender)))
        self.sender.seq = (self.sender.seq + 1) % 256

    def _send_stream(self, number: int) -> None:
        make = {0: self._heartbeat, 33: self._global, 32: self._local, 30: self._attitude, 245: self._extended,
                147: self._battery, 1: self._sys_status}.get(number)
        if make is not None:
            self._send(make())

    def _heartbeat(self) -> Any:
        low = self.battery_percent is not None and self.battery_percent < 10.0
        return mav.MAVLink_heartbeat_message(2, 12 if self.px4 else 3, 1 | (128 if self.armed else 0),
                                             self.modes[self.mode], 5 if low else 4 if self.armed else 3, 3)

    def _global(self) -> Any:
        north, east, down = self.air.position
        lat = self.home[0] + north / M_PER_DEG
        lon = self.home[1] + east / (M_PER_DEG * math.cos(math.radians(self.home[0])))
        if self.t < 3.0:
            lat = lon = 0.0  # no fix yet
        return mav.MAVLink_global_position_int_message(
            self._ms, round(lat * 1e7), round(lon * 1e7), round((self.home[2] - down) * 1e3), round(-down * 1e3),
            *(round(float(v) * 100) for v in self.air.velocity), 65535)

    def _local(self) -> Any:
        p, v = self.air.position - self.local_origin, self.air.velocity + self.air.wind * self.armed
        return mav.MAVLink_local_position_ned_message(self._ms, *map(float, p), *map(float, v))

    def _attitude(self) -> Any:
        yaw = (self.air.yaw + math.pi) % math.tau - math.pi
        return mav.MAVLink_attitude_message(self._ms, 0.0, 0.0, yaw, 0.0, 0.0, 0.0)

    def _extended(self) -> Any:
        return mav.MAVLink_extended_sys_state_message(0, 1 if self.air.on_ground else 2)

    def _battery(self) -> Any:
        percent = self.battery_percent
        state = 1 if percent is None or percent > 15.0 else 2 if percent > 7.0 or not self.px4 else 3
        return mav.MAVLink_battery_status_message(0, 0, 1, 32767, [3900] * 4 + [65535] * 6, -1 if self.px4 else 1500, 0,
                                                  -1, -1 if percent is None else int(percent), 0, state)

    def _sys_status(self) -> Any:
        prearm = 0x10000000 if self.t > self.ready_s - (0.0 if self.px4 else 18.0) else 0
        return mav.MAVLink_sys_status_message(0x1000002F, 0x1000002F, 0x2F | prearm, 0, 15600, -1, -1, 0, 0, 0, 0, 0, 0)

    @property
    def _ms(self) -> int:
        return round(self.t * 1000)


REAL32, INT32 = 9, 6
_PX4_PARAMETERS = {
    "COM_OF_LOSS_T": (1.0, REAL32), "COM_OBL_RC_ACT": (0.0, INT32), "NAV_DLL_ACT": (2.0, INT32),
    "MPC_XY_VEL_MAX": (12.0, REAL32), "MPC_Z_VEL_MAX_UP": (3.0, REAL32), "MPC_Z_VEL_MAX_DN": (1.5, REAL32),
    "MIS_TAKEOFF_ALT": (2.5, REAL32)}
_COPTER_PARAMETERS = {
    "GUID_TIMEOUT": (3.0, REAL32), "WPNAV_SPEED": (1000.0, REAL32), "WPNAV_SPEED_UP": (250.0, REAL32),
    "WPNAV_SPEED_DN": (150.0, REAL32)}
