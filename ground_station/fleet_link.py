"""The ground side of MAVLink for one vehicle: telemetry in, a queue of commands and plans out, one at a time.

No bus and no clock: messages and times come in, an `Outbox` goes out. Everything that may be lost is repeated on
simulated time; a command or plan that fails empties the queue and leaves its reason in `failure`.
"""

from __future__ import annotations

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
RETURN_MODES = ("return", "land", "emergency")
"""VehicleState.mode of a vehicle that is on its way to the ground."""
NAN = float("nan")


@dataclass
class Command:
    """A COMMAND_LONG that is repeated until it is acknowledged."""

    command: int
    params: tuple[float, float, float, float, float, float, float]
    deadline_ns: int = 0
    resend_ns: int = 0


def arm() -> Command:
    """Arm the motors."""
    return Command(mav.MAV_CMD_COMPONENT_ARM_DISARM, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def takeoff(altitude_m: float) -> Command:
    """Climb to this altitude (param 7, AMSL as in COMMAND_LONG NAV_TAKEOFF)."""
    return Command(mav.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, NAN, NAN, NAN, altitude_m))


def start_mission() -> Command:
    """Fly the accepted plan from its first item."""
    return Command(mav.MAV_CMD_MISSION_START, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def return_to_launch() -> Command:
    """Fly home and land."""
    return Command(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


@dataclass
class Telemetry:
    """What a vehicle last said of itself. `state` is None until the first VehicleState."""

    state: VehicleState | None = None
    battery_percent: float = 100.0
    reached: set[int] = field(default_factory=set)


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
        self.failure = ""
        self._endpoint = Endpoint(GROUND_SYSTEM, GROUND_COMPONENT)
        self._queue: deque[Command | PlanUpload] = deque()
        self._heartbeat_ns = 0

    @property
    def busy(self) -> bool:
        """Whether commands or plans are still on their way."""
        return bool(self._queue)

    @property
    def plan_finished(self) -> bool:
        """Whether the last item of the plan that was accepted last has been reached."""
        return self._last_seq in self.telemetry.reached

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

    def fly(self, route: Route) -> None:
        """Queue a plan and its start."""
        self._queue.extend((PlanUpload(route, self._site), start_mission()))

    def cancel(self) -> None:
        """Drop whatever is queued."""
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
        while self._queue:
            head = self._queue[0]
            if isinstance(head, Command):
                messages.extend(self._poll_command(head, t_ns))
                break
            out.plan_hash, transfer = head.poll(t_ns, self.vehicle_id)
            messages.extend(transfer)
            if not head.over:
                break
            self._finish_upload(head)
        out.frames = [self._endpoint.pack(m) for m in messages]
        return out

    def _poll_command(self, command: Command, t_ns: int) -> list[mav.MAVLink_message]:
        if not command.deadline_ns:
            command.deadline_ns, command.resend_ns = t_ns + round(COMMAND_DEADLINE_S * SECOND_NS), t_ns
        if t_ns >= command.deadline_ns:
            self._fail(f"command {command.command} not acknowledged")
        elif t_ns >= command.resend_ns:
            command.resend_ns = t_ns + round(COMMAND_RESEND_S * SECOND_NS)
            return [mav.MAVLink_command_long_message(self.vehicle_id, AUTOPILOT_COMPONENT, command.command, 0,
                                                     *command.params)]
        return []

    def _finish_upload(self, upload: PlanUpload) -> None:
        if upload.state == "accepted":
            self._queue.popleft()
            self.route, self._last_seq = upload.route, len(upload.items) - 1
            self.telemetry.reached.clear()
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
        elif kind == "COMMAND_ACK":
            self._on_command_ack(message)
        elif self._queue and isinstance(self._queue[0], PlanUpload):
            self._queue[0].on_message(message)

    def _on_command_ack(self, message: Any) -> None:
        head = self._queue[0] if self._queue else None
        if not isinstance(head, Command) or not head.deadline_ns or message.command != head.command:
            return
        if message.result == mav.MAV_RESULT_ACCEPTED:
            self._queue.popleft()
        elif message.result not in (mav.MAV_RESULT_IN_PROGRESS, mav.MAV_RESULT_TEMPORARILY_REJECTED):
            self._fail(f"command {head.command} refused with result {message.result}")
