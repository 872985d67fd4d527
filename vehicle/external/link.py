"""A companion's end of the MAVLink link to one autopilot. No socket and no clock: bytes and seconds in, frames out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mav

from missions.frames import Array
from missions.mavlink import AUTOPILOT_COMPONENT, GROUND_COMPONENT, GROUND_SYSTEM, Endpoint
from vehicle.dialects import Dialect, Mode
from vehicle.external.goals import Goal, Order, modes_of, next_order, setpoint_mode
from vehicle.external.parameters import Setup
from vehicle.external.telemetry import Telemetry, heard

HEARTBEAT_S = 1.0
RELAYED_S = 5.0
"""After the last sign of the ground station its heartbeat is passed on for so long: it may be in a long computation."""
SETPOINT_S = 0.05
ORDER_S = 1.0
"""How often what is not yet so is commanded again."""
WARM_UP_S = 1.0
"""Set-points flow for so long before the autopilot is asked to follow them; PX4 refuses otherwise."""
ASK_AGAIN_S, ASK_ANYWAY_S = 2.0, 15.0
BLIND_S, DEAD_S = 3.0, 10.0
"""An autopilot that has told no position, or sent no heartbeat, for so long is lost."""
PATIENCE_S = {Goal.CLIMB: 120.0, Goal.FOLLOW: 20.0, Goal.LAND: 20.0, Goal.RETURN: 20.0}
"""So long may it take until the autopilot is in a goal's mode and armed; ArduPilot is armable after a minute or so."""
STREAMS_HZ = {mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20.0, mav.MAVLINK_MSG_ID_ATTITUDE: 20.0,
              mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 2.0, mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
              mav.MAVLINK_MSG_ID_BATTERY_STATUS: 2.0}
"""Asked of every autopilot: ArduPilot sends hardly anything unasked, PX4 some of it too slowly."""
YAW_RATE_UNUSED = mav.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE


@dataclass
class _Pursuit:
    """A goal on its way. Replaced as a whole by whoever sets the goal; changed by the link's thread alone."""

    goal: Goal = Goal.NOTHING
    height_m: float = 0.0
    modes_before: frozenset[Mode | None] = frozenset()
    """In which the autopilot may still be."""
    since_s: float | None = None
    held: bool = False
    """Whether the autopilot was at it."""


@dataclass(frozen=True)
class Setpoint:
    """Where to be now, in the autopilot's local frame (north, east, down), each (3,)."""

    position_m: Array
    velocity_m_s: Array
    acceleration_m_s2: Array
    heading_rad: float


class AutopilotLink:
    """What the autopilot says, what is wanted of it, and who has control.

    One thread feeds `receive` and `poll`; another one may set the goal. Control is lost for good, until `regain`, when
    the autopilot leaves the mode in which it works at the goal: a person's switch or its own failsafe goes first.
    """

    def __init__(self, system: int, aim: Callable[[float], Setpoint | None] = lambda t_s: None) -> None:
        """aim: the set-point of a time, None for as long as there is none."""
        self.system, self.aim = system, aim
        self.said = Telemetry()
        self.strangers: set[int] = set()
        """Other systems that speak on this wire."""
        self.let_go = ""
        """Why control was lost, in words; empty while there is control."""
        self.setup: Setup | None = None
        """Parameters that are being checked."""
        self.parameters: dict[str, tuple[float, int]] = {}
        """Value as it travelled and MAV_PARAM_TYPE of those that were told."""
        self.ground_s = -1e9
        """When the ground station was last known to be there."""
        self._endpoint = Endpoint(system, mav.MAV_COMP_ID_ONBOARD_COMPUTER)
        self._ground = Endpoint(GROUND_SYSTEM, GROUND_COMPONENT)
        self._pursuit = _Pursuit()
        self._heartbeat_s = self._order_s = self._setpoint_s = -1e9
        self._heard_s: dict[int, float] = {}
        self._asked_s: dict[int, float] = {}

    @property
    def goal(self) -> Goal:
        """What is wanted."""
        return self._pursuit.goal

    @property
    def held(self) -> bool:
        """Whether the autopilot is at it."""
        return self._pursuit.held

    def pursue(self, goal: Goal, height_m: float = 0.0) -> None:
        """Want this from now on. height_m: of a climb, above the ground."""
        before, said = self._pursuit, self.said
        if (goal, height_m) != (before.goal, before.height_m):
            at_it = modes_of(before.goal, said.dialect) if said.dialect is not None else frozenset()
            self._pursuit = _Pursuit(goal, height_m, at_it | {said.mode})

    def regain(self) -> None:
        """Have control again: the aircraft stands on the ground."""
        self.pursue(Goal.NOTHING)
        self.let_go = ""

    def receive(self, data: bytes, t_s: float) -> None:
        """Bytes from the wire."""
        for message in self._endpoint.parse([data]):
            if message.get_srcSystem() != self.system:
                self.strangers.add(message.get_srcSystem())
            elif message.get_srcComponent() == AUTOPILOT_COMPONENT:
                self._receive(message, t_s)

    def poll(self, t_s: float) -> list[bytes]:
        """Frames that are due. To be called at least every 50 ms."""
        out: list[mav.MAVLink_message] = []
        frames = []
        if t_s - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = t_s
            out.append(_heartbeat(mav.MAV_TYPE_ONBOARD_CONTROLLER))
            frames = [self._ground.pack(_heartbeat(mav.MAV_TYPE_GCS))] if t_s - self.ground_s < RELAYED_S else []
        if self.said.dialect is not None:
            out += self._ask_for_streams(t_s)
            out += self.setup.poll(self.parameters, t_s) if self.setup is not None else []
            pursuit = self._pursuit
            self._watch(pursuit, self.said.dialect, t_s)
            if not self.let_go:
                out += self._pursue(pursuit, t_s)
        return frames + [self._endpoint.pack(message) for message in out]

    def _receive(self, message: Any, t_s: float) -> None:
        self._heard_s[message.get_msgId()] = t_s
        self.said = heard(self.said, message, t_s)
        if message.get_type() == "PARAM_VALUE":
            self.parameters[message.param_id] = (message.param_value, message.param_type)

    def _ask_for_streams(self, t_s: float) -> list[mav.MAVLink_message]:
        """Again for as long as one does not come, and now and then anyway: that it comes does not say how often."""
        out = []
        for number, rate_hz in STREAMS_HZ.items():
            asked_s = self._asked_s.get(number, -1e9)
            silent = t_s - self._heard_s.get(number, -1e9) > ASK_AGAIN_S
            if t_s - asked_s > (ASK_AGAIN_S if silent else ASK_ANYWAY_S):
                self._asked_s[number] = t_s
                every_us = 1e6 / rate_hz
                out.append(self._command(Order(mav.MAV_CMD_SET_MESSAGE_INTERVAL,
                                               (float(number), every_us, 0.0, 0.0, 0.0, 0.0, 0.0))))
        return out

    def _watch(self, pursuit: _Pursuit, dialect: Dialect, t_s: float) -> None:
        """Whether the autopilot still does what is wanted of it."""
        if self.let_go or pursuit.goal is Goal.NOTHING:
            return
        if pursuit.since_s is None:
            pursuit.since_s = t_s
        said, at_it = self.said, self.said.mode in modes_of(pursuit.goal, dialect)
        known = at_it or (not pursuit.held and said.mode in pursuit.modes_before)
        waited_s = 0.0 if pursuit.held and pursuit.goal is not Goal.CLIMB else t_s - pursuit.since_s
        if t_s - said.position_s > BLIND_S or t_s - said.heartbeat_s > DEAD_S:
            self.let_go = "the autopilot is silent"
        elif said.armed and not known:
            self.let_go = f"mode changed to {said.mode or 'unknown'}"
        elif pursuit.held and not said.armed and pursuit.goal is Goal.FOLLOW:
            self.let_go = "motors disarmed"
        elif waited_s > PATIENCE_S[pursuit.goal]:
            self.let_go = f"it does not {pursuit.goal.value}"
        elif at_it and said.armed:
            pursuit.held = True

    def _pursue(self, pursuit: _Pursuit, t_s: float) -> list[mav.MAVLink_message]:
        """Set-points, and the next command where one is needed."""
        out, follow = [], pursuit.goal is Goal.FOLLOW
        if (follow or self._still_follows(pursuit)) and t_s - self._setpoint_s >= SETPOINT_S:
            setpoint = self.aim(t_s)
            if setpoint is not None:
                self._setpoint_s = max(self._setpoint_s + SETPOINT_S, t_s - SETPOINT_S)
                out.append(self._packed(setpoint, t_s))
        warm = not follow or (pursuit.since_s is not None and t_s - pursuit.since_s >= WARM_UP_S)
        settled = pursuit.held and pursuit.goal not in (Goal.CLIMB, Goal.LAND)  # these take several commands
        if warm and not settled and t_s - self._order_s >= ORDER_S:
            order = next_order(pursuit.goal, self.said, pursuit.height_m)
            if order is not None:
                self._order_s = t_s
                out.append(self._command(order))
        return out

    def _still_follows(self, pursuit: _Pursuit) -> bool:
        """Whether the next goal's mode is yet to come: without set-points its failsafe might act before that."""
        dialect = self.said.dialect
        return pursuit.goal in (Goal.LAND, Goal.RETURN) and not pursuit.held and dialect is not None \
            and self.said.mode == setpoint_mode(dialect)

    def _command(self, order: Order) -> mav.MAVLink_message:
        return mav.MAVLink_command_long_message(self.system, AUTOPILOT_COMPONENT, order.command, 0, *order.params)

    def _packed(self, setpoint: Setpoint, t_s: float) -> mav.MAVLink_message:
        p, v, a = setpoint.position_m, setpoint.velocity_m_s, setpoint.acceleration_m_s2
        return mav.MAVLink_set_position_target_local_ned_message(
            round(t_s * 1000.0) % 2**32, self.system, AUTOPILOT_COMPONENT, mav.MAV_FRAME_LOCAL_NED, YAW_RATE_UNUSED,
            *(float(c) for c in (*p, *v, *a)), setpoint.heading_rad, 0.0)


def _heartbeat(kind: int) -> mav.MAVLink_message:
    return mav.MAVLink_heartbeat_message(kind, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3)
