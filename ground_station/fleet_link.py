"""The ground side of MAVLink for one vehicle: telemetry in, a queue of commands and plans out, one at a time.

No bus and no clock: messages and times come in, an `Outbox` goes out. Everything that may be lost is repeated on
simulated time; a command or plan that fails empties the queue and leaves its reason in `failure`.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mav

from ground_station.plan_upload import PlanUpload
from missions.clock import SECOND_NS
from missions.frames import Site
from missions.mavlink import AUTOPILOT_COMPONENT, GROUND_COMPONENT, GROUND_SYSTEM, Endpoint, Route
from missions.messages import PlanHash, PlanVerdict, VehicleState

COMMAND_RESEND_S, COMMAND_DEADLINE_S = 1.0, 15.0
HEARTBEAT_S = 1.0
LANDING_OUT_MODES = ("descend", "emergency")
"""VehicleState.mode of a vehicle that lands where it is."""
RETURN_MODES = ("return", "land", *LANDING_OUT_MODES)
"""VehicleState.mode of a vehicle that is on its way to the ground."""
NO_ANSWER = -1
ARM = mav.MAV_CMD_COMPONENT_ARM_DISARM
URGENT_TEXTS = mav.MAV_SEVERITY_WARNING
"""STATUSTEXTs of this severity or worse are kept for people."""
NAN = float("nan")


@dataclass
class Command:
    """A COMMAND_LONG that is repeated until it is acknowledged."""

    command: int
    params: tuple[float, float, float, float, float, float, float]
    deadline_ns: int = 0
    resend_ns: int = 0
    result: int | None = None
    """MAV_RESULT of the acknowledgement; NO_ANSWER when none came in time, None before."""


def arm() -> Command:
    """Arm the motors."""
    return Command(ARM, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def takeoff(altitude_m: float) -> Command:
    """Climb to this altitude (param 7, AMSL as in COMMAND_LONG NAV_TAKEOFF)."""
    return Command(mav.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, NAN, NAN, NAN, altitude_m))


def start_mission() -> Command:
    """Fly the accepted plan from its first item."""
    return Command(mav.MAV_CMD_MISSION_START, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def return_to_launch() -> Command:
    """Fly home and land."""
    return Command(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def pause() -> Command:
    """Hold where it is, and keep the plan."""
    return Command(mav.MAV_CMD_DO_PAUSE_CONTINUE, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def go_on() -> Command:
    """Go on with the plan after a pause."""
    return Command(mav.MAV_CMD_DO_PAUSE_CONTINUE, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def land() -> Command:
    """Go straight down."""
    return Command(mav.MAV_CMD_NAV_LAND, (0.0, 0.0, 0.0, NAN, NAN, NAN, 0.0))


@dataclass
class Telemetry:
    """What a vehicle last said of itself. `state` is None until the first VehicleState."""

    state: VehicleState | None = None
    battery_percent: float = 100.0
    reached: set[int] = field(default_factory=set)
    warning: str = ""
    """The newest urgent text."""


@dataclass
class Outbox:
    """What to publish for one vehicle: an announcement that goes ahead of the frames."""

    plan_hash: PlanHash | None = None
    frames: list[bytes] = field(default_factory=list)

    def __bool__(self) -> bool:
        return self.plan_hash is not None or bool(self.frames)


class VehicleLink:
    """One vehicle as the ground talks to it."""

    def __init__(self, vehicle_id: int, site: Site) -> None:
        self.vehicle_id, self._site = vehicle_id, site
        self.telemetry = Telemetry()
        self.route: Route | None = None
        self._last_seq = -1
        self._waypoint_seqs: list[int] = []
        self.failure = ""
        self._endpoint = Endpoint(GROUND_SYSTEM, GROUND_COMPONENT)
        self._queue: deque[Command | PlanUpload] = deque()
        self._orders: deque[Command] = deque()
        self._held = False
        self._heartbeat_ns = 0
        self.away = False
        """Whether nothing was heard since this ground station took the mission up again; it asks for nothing then."""

    @property
    def busy(self) -> bool:
        """Whether commands or plans are still on their way."""
        return bool(self._queue) or bool(self._orders)

    @property
    def uploading(self) -> bool:
        """Whether a plan is on its way."""
        return any(isinstance(q, PlanUpload) for q in self._queue)

    @property
    def held(self) -> bool:
        """Whether the mission's commands wait for an operator."""
        return self._held

    @held.setter
    def held(self, held: bool) -> None:
        self._held = held
        if not held and self._queue and isinstance(self._queue[0], Command):
            self._queue[0].deadline_ns = 0

    @property
    def plan_finished(self) -> bool:
        """Whether the last item of the plan that was accepted last has been reached."""
        return self._last_seq in self.telemetry.reached

    @property
    def next_waypoint(self) -> int:
        """Index in `route` of the waypoint that the vehicle flies to, as far as it has told."""
        return bisect_right(self._waypoint_seqs, max(self.telemetry.reached, default=-1))

    @property
    def returning(self) -> bool:
        """Whether the vehicle says that it is on its way home or landing."""
        state = self.telemetry.state
        return state is not None and state.mode in RETURN_MODES

    @property
    def rejected(self) -> int:
        """Frames that failed their checks."""
        return self._endpoint.rejected

    def command(self, *commands: Command) -> None:
        """Queue commands."""
        self._queue.extend(commands)

    def order(self, command: Command) -> Command:
        """Send a person's command, past whatever the mission has queued; its `result` tells what became of it."""
        self._orders.append(command)
        return command

    def fly(self, route: Route) -> None:
        """Queue a plan and its start."""
        self.telemetry.reached.clear()
        self._queue.extend((PlanUpload(route, self._site), start_mission()))

    def take_up_again(self) -> None:
        """What was on its way is sent once more, as if for the first time; a vehicle in the air is not armed again."""
        self.away = False
        flying = self.telemetry.state is not None and self.telemetry.state.flying
        if flying and self._queue and isinstance(self._queue[0], Command) and self._queue[0].command == ARM:
            self._queue.popleft()
        for due in (self._queue, self._orders):
            if due and isinstance(due[0], Command):
                due[0].deadline_ns = 0
        if self._queue and isinstance(self._queue[0], PlanUpload):
            self._queue[0] = PlanUpload(self._queue[0].route, self._site)

    def begin_anew(self) -> None:
        """The vehicle's computer was started again: nothing that was under way with it counts any more."""
        for order in self._orders:
            order.result = NO_ANSWER if order.result is None else order.result
        self._orders.clear()
        self.cancel()
        self._endpoint = Endpoint(GROUND_SYSTEM, GROUND_COMPONENT)
        self.route, self._last_seq, self._waypoint_seqs, self.failure = None, -1, [], ""
        self.telemetry.reached.clear()

    def cancel(self) -> None:
        """Drop whatever the mission has queued."""
        self._queue.clear()

    def on_frames(self, frames: list[bytes]) -> None:
        """MAVLink frames of this vehicle."""
        for message in self._endpoint.parse(frames):
            if message.get_srcSystem() == self.vehicle_id:
                self._on_message(message)

    def on_state(self, state: VehicleState) -> None:
        """A state, unless it is older than the one known."""
        known = self.telemetry.state
        if known is None or state.t_ns >= known.t_ns:
            self.telemetry.state = state

    def on_verdict(self, verdict: PlanVerdict) -> None:
        """The vehicle's decision about a plan."""
        if self._queue and isinstance(self._queue[0], PlanUpload):
            self._queue[0].on_verdict(verdict)

    def take_failure(self) -> str:
        """Why the queue was emptied, once."""
        failure, self.failure = self.failure, ""
        return failure

    def poll(self, t_ns: int) -> Outbox:
        """What is to be sent at t_ns."""
        out = Outbox()
        messages: list[mav.MAVLink_message] = []
        if t_ns >= self._heartbeat_ns:
            self._heartbeat_ns = t_ns + round(HEARTBEAT_S * SECOND_NS)
            messages.append(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0,
                                                          mav.MAV_STATE_ACTIVE, 3))
        messages.extend([] if self.away else self._poll_orders(t_ns))
        while self._queue and not self.away:
            head = self._queue[0]
            if isinstance(head, Command):
                messages.extend([] if self._held else self._poll_command(head, t_ns))
                break
            out.plan_hash, transfer = head.poll(t_ns, self.vehicle_id)
            messages.extend(transfer)
            if not head.over:
                break
            self._finish_upload(head)
        out.frames = [self._endpoint.pack(m) for m in messages]
        return out

    def _poll_orders(self, t_ns: int) -> list[mav.MAVLink_message]:
        while self._orders and self._orders[0].result is not None:
            self._orders.popleft()
        if not self._orders:
            return []
        order = self._orders[0]
        if order.deadline_ns and t_ns >= order.deadline_ns:
            order.result = NO_ANSWER
        return self._due(order, t_ns)

    def _poll_command(self, command: Command, t_ns: int) -> list[mav.MAVLink_message]:
        if command.deadline_ns and t_ns >= command.deadline_ns:
            self._fail(f"command {command.command} not acknowledged")
            return []
        return self._due(command, t_ns)

    def _due(self, command: Command, t_ns: int) -> list[mav.MAVLink_message]:
        """The command, when it is to be sent for the first time or again."""
        if not command.deadline_ns:
            command.deadline_ns, command.resend_ns = t_ns + round(COMMAND_DEADLINE_S * SECOND_NS), t_ns
        if command.result is not None or t_ns < command.resend_ns:
            return []
        command.resend_ns = t_ns + round(COMMAND_RESEND_S * SECOND_NS)
        return [mav.MAVLink_command_long_message(self.vehicle_id, AUTOPILOT_COMPONENT, command.command, 0,
                                                 *command.params)]

    def _finish_upload(self, upload: PlanUpload) -> None:
        if upload.state == "accepted":
            self._queue.popleft()
            self.route, self._last_seq = upload.route, len(upload.items) - 1
            self._waypoint_seqs = [n for n, i in enumerate(upload.items) if i.command == mav.MAV_CMD_NAV_WAYPOINT]
        else:
            self._fail(f"plan {upload.state}: {upload.reason}")

    def _fail(self, reason: str) -> None:
        self._queue.clear()
        self.failure = reason

    def _on_message(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "BATTERY_STATUS" and message.battery_remaining >= 0:
            self.telemetry.battery_percent = float(message.battery_remaining)
        elif kind == "MISSION_ITEM_REACHED":
            self.telemetry.reached.add(message.seq)
        elif kind == "STATUSTEXT" and message.severity <= URGENT_TEXTS:
            self.telemetry.warning = message.text
        elif kind == "COMMAND_ACK" and not self._ends_order(message):
            self._on_command_ack(message)
        elif self._queue and isinstance(self._queue[0], PlanUpload):
            self._queue[0].on_message(message)

    def _ends_order(self, message: Any) -> bool:
        """Whether this acknowledges a person's command, which is then over, whatever the result."""
        order = self._orders[0] if self._orders else None
        if order is None or not order.deadline_ns or order.result is not None or message.command != order.command:
            return False
        if message.result != mav.MAV_RESULT_IN_PROGRESS:
            order.result = message.result
        return True

    def _on_command_ack(self, message: Any) -> None:
        head = self._queue[0] if self._queue else None
        if not isinstance(head, Command) or not head.deadline_ns or message.command != head.command:
            return
        if message.result == mav.MAV_RESULT_ACCEPTED:
            self._queue.popleft()
        elif message.result not in (mav.MAV_RESULT_IN_PROGRESS, mav.MAV_RESULT_TEMPORARILY_REJECTED):
            self._fail(f"command {head.command} refused with result {message.result}")
