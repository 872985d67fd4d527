"""One MAVLink link of a vehicle: frames in, frames out, in the form that its other end expects."""

from __future__ import annotations

import calendar
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mav

from missions.mavlink import AUTOPILOT_COMPONENT, Endpoint, Item
from missions.signing import Signing
from vehicle.autopilot.commands import COMMANDS, NEEDS_LEASE
from vehicle.autopilot.craft import Craft
from vehicle.autopilot.mission_service import WINDOW, Accept, MissionService, TransferStyle
from vehicle.autopilot.payload import CAMERA_COMPONENT, GIMBAL_COMPONENT, image_captured, image_lost
from vehicle.autopilot.request import Request, requests_of
from vehicle.autopilot.services import answer_service
from vehicle.autopilot.setpoints import Setpoints
from vehicle.autopilot.telemetry import STREAMS, Sight, Stream, heartbeat, mission_current, shown_mode
from vehicle.dialects import PX4, Dialect, Mode
from vehicle.lease import Lease
from vehicle.simulator import NS, Kinematics

TEXT_BYTES = 50
TELL_REFUSED_NS = 10 * NS
COMPONENTS = (AUTOPILOT_COMPONENT, CAMERA_COMPONENT, GIMBAL_COMPONENT)
OURS = (AUTOPILOT_COMPONENT,)


@dataclass
class _Due:
    every_ns: int
    next_ns: int = 0

    def now(self, t_ns: int) -> bool:
        if self.every_ns <= 0 or t_ns < self.next_ns:
            return False
        self.next_ns = (t_ns // self.every_ns + 1) * self.every_ns
        return True


@dataclass
class Face:
    """What one link sees of a vehicle. Without a lease it is our own ground station, which may do everything."""

    craft: Craft
    dialect: Dialect
    accept: Accept
    epoch_us: int = 0
    """UNIX time of simulated time zero."""
    lease: Lease | None = None
    selected: Mode = "hold"
    """The mode chosen while on the ground."""
    signing: Signing | None = None
    """With it only who holds the key is heard."""
    setpoints: Setpoints = field(init=False)
    missions: MissionService = field(init=False)
    _due: dict[Stream, _Due] = field(init=False)
    _queue: list[tuple[int, Any]] = field(default_factory=list)
    _texts: int = 0
    _shown: dict[Any, tuple[Any, ...]] = field(default_factory=dict)
    """What was told last, by the message that tells it."""
    _refused: int = 0
    """Frames that signing had refused when it was told of last."""
    _refusals: _Due = field(default_factory=lambda: _Due(TELL_REFUSED_NS))
    _now: Kinematics | None = None

    def __post_init__(self) -> None:
        own = self.lease is None
        home = self._home_item if self.dialect.item_zero_is_home else None
        style = TransferStyle(WINDOW if own else 1, self.dialect.request_ints, home)
        self.missions = MissionService(self.craft.shelves, self.accept, self.craft.executor.jump, style)
        self.setpoints = Setpoints(self.craft)
        components = OURS if own else COMPONENTS
        self.endpoints = {c: Endpoint(self.craft.system, c, self.signing) for c in components}
        self._due = {s: _Due(round(s.every_s * NS)) for s in STREAMS if s.ours or not own}

    def receive(self, frames: list[bytes], t_ns: int) -> None:
        """Handle incoming frames; answers go out with the next `frames`."""
        for message in self.endpoints[AUTOPILOT_COMPONENT].parse(frames):
            if getattr(message, "target_system", 0) in (0, self.craft.system):
                self._handle(message, t_ns)

    def _handle(self, message: Any, t_ns: int) -> None:
        sender = message.get_srcSystem(), message.get_srcComponent()
        if self.lease is not None and message.get_type() == "HEARTBEAT" and message.type == mav.MAV_TYPE_GCS:
            self.lease.heard(sender, t_ns)
        request = requests_of(message, self.dialect)
        if request is not None:
            self._command(request, t_ns)
            return
        if getattr(message, "target_component", 0) not in (0, AUTOPILOT_COMPONENT):
            return
        answers = self.missions.handle(message, t_ns) if self._may_plan(message, sender, t_ns) else \
            [self._plan_denied(message)]
        if answers is None:
            answers = answer_service(self, message, sender, t_ns)
        self.send(*answers)

    def send(self, *messages: Any, component: int = AUTOPILOT_COMPONENT) -> None:
        """Queue messages of a component."""
        self._queue += [(component, message) for message in messages]

    def text(self, text: str, severity: int = mav.MAV_SEVERITY_INFO) -> None:
        """A line for people, in as many pieces as it needs."""
        raw = text.encode()
        self._texts = self._texts % 65535 + 1
        chunks = [raw[n:n + TEXT_BYTES] for n in range(0, max(1, len(raw)), TEXT_BYTES)]
        number = self._texts if len(chunks) > 1 else 0
        self.send(*(mav.MAVLink_statustext_message(severity, chunk, number, n) for n, chunk in enumerate(chunks)))

    def reached(self, items: list[int]) -> None:
        """These items of the flight plan are done."""
        self.send(*(mav.MAVLink_mission_item_reached_message(self.missions.shown_seq(seq)) for seq in items))

    def captured(self, index: int) -> None:
        """The picture with this index is in storage."""
        component = CAMERA_COMPONENT if CAMERA_COMPONENT in self.endpoints else AUTOPILOT_COMPONENT
        self.send(image_captured(self.craft, index, self.epoch_us), component=component)

    def lost(self, view_id: int, t_ns: int) -> None:
        """A picture did not come."""
        if CAMERA_COMPONENT in self.endpoints:
            self.send(image_lost(self.craft, view_id, t_ns), component=CAMERA_COMPONENT)

    def frames(self, now: Kinematics, t_ns: int) -> list[bytes]:
        """Everything that is due now, packed."""
        self.send(*self.missions.poll(t_ns))
        sight = self.sight(now, t_ns)
        self._tell_changes(sight)
        for stream, due in self._due.items():
            if due.now(t_ns):
                message = stream.build(sight)
                if message is not None:
                    self.send(message, component=stream.component)
        out = [self.endpoints[component].pack(message) for component, message in self._queue]
        self._queue.clear()
        return out

    def _tell_changes(self, sight: Sight) -> None:
        """A heartbeat comes at once when mode or arming have changed, MISSION_CURRENT when the plan or its next item
        have."""
        executor, plan = self.craft.executor, self.craft.plan
        shown = {heartbeat: (shown_mode(executor.mode, executor.idle, self.selected, self.dialect), executor.armed),
                 mission_current: (plan.current, len(plan.items), executor.mode, executor.progress.left)}
        for stream, due in self._due.items():
            if stream.build in shown and shown[stream.build] != self._shown.get(stream.build):
                due.next_ns = sight.t_ns
        self._shown = shown

    def step(self, now: Kinematics, t_ns: int) -> None:
        """What this link has to watch every tick."""
        self._now = now
        self._tell_refused(t_ns)
        if self.setpoints.stale(t_ns):
            self.craft.executor.hold(t_ns)
            self.text("set-points have stopped: holding", mav.MAV_SEVERITY_WARNING)

    def _tell_refused(self, t_ns: int) -> None:
        refused = self.signing.refused if self.signing is not None else Counter()
        if refused.total() > self._refused and self._refusals.now(t_ns):
            self._refused = refused.total()
            counts = ", ".join(f"{count} {reason}" for reason, count in sorted(refused.items()))
            self.text(f"frames refused at the door: {counts}", mav.MAV_SEVERITY_WARNING)

    def sight(self, now: Kinematics, t_ns: int) -> Sight:
        """What telemetry is made of."""
        return Sight(self.craft, self.dialect, self.selected, now, t_ns, self.epoch_us + t_ns // 1000)

    @property
    def now(self) -> Kinematics:
        """How the body moves as of this tick."""
        assert self._now is not None, "a face is stepped before it is spoken to"
        return self._now

    @property
    def takes_setpoints(self) -> bool:
        """Whether the mode that was chosen follows set-points without being told: ArduPilot's GUIDED does."""
        return self.selected == "guided" and "offboard" not in self.dialect.mode_numbers

    def set_interval(self, number: int, component: int, interval_us: int) -> bool:
        """Change how often a message is sent: -1 stops it, 0 is as before; False when there is no such message."""
        found = [s for s in self._due if s.number == number and s.component == component]
        for stream in found:
            default = round(stream.every_s * NS)
            self._due[stream].every_ns = default if interval_us == 0 else max(0, interval_us) * 1000
            self._due[stream].next_ns = 0
        return bool(found)

    def interval_us(self, number: int, component: int) -> int | None:
        """How often a message is sent; None when it is not known here."""
        due = next((d for s, d in self._due.items() if (s.number, s.component) == (number, component)), None)
        return None if due is None else due.every_ns // 1000 or -1

    def _command(self, request: Request, t_ns: int) -> None:
        """Acknowledge to the sender first, then send what was asked for; commands may come twice."""
        component = request.component or AUTOPILOT_COMPONENT
        if component not in self.endpoints:
            return
        handler = COMMANDS.get(request.command)
        answers: list[Any] = []
        if handler is None:
            result = mav.MAV_RESULT_UNSUPPORTED
        elif request.command in NEEDS_LEASE and not self.leads(request.sender, t_ns):
            result = mav.MAV_RESULT_DENIED
        else:
            result, answers = handler(self, request, t_ns)
        if request.wants_ack:
            self.send(mav.MAVLink_command_ack_message(request.command, result, 0, 0, *request.sender),
                      component=component)
        self.send(*answers, component=component)

    def leads(self, sender: tuple[int, int], t_ns: int) -> bool:
        """Whether this sender may make the vehicle fly; others are told who leads."""
        if self.lease is None or self.lease.take(sender, t_ns):
            return True
        self.text(f"{self.lease.holder_name} leads this vehicle; you may watch, hold, return or land it",
                  mav.MAV_SEVERITY_NOTICE)
        return False

    def may_go_on(self, sender: tuple[int, int], t_ns: int) -> bool:
        """Whether this sender may have the plan flown: it leads, or it was the one that paused it."""
        return sender == self.craft.executor.paused_by or self.leads(sender, t_ns)

    def _may_plan(self, message: Any, sender: tuple[int, int], t_ns: int) -> bool:
        changes = message.get_type() in ("MISSION_COUNT", "MISSION_CLEAR_ALL", "MISSION_SET_CURRENT")
        return not changes or self.leads(sender, t_ns)

    def _plan_denied(self, message: Any) -> Any:
        return mav.MAVLink_mission_ack_message(message.get_srcSystem(), message.get_srcComponent(),
                                               mav.MAV_MISSION_DENIED, getattr(message, "mission_type", 0))

    def _home_item(self) -> Item:
        lat, lon, alt, _ = self.craft.home
        return Item(mav.MAV_FRAME_GLOBAL_INT, mav.MAV_CMD_NAV_WAYPOINT, (0.0, 0.0, 0.0, 0.0), lat, lon, alt / 1000.0)


def epoch_us(epoch_utc: str) -> int:
    """UNIX time in microseconds of an ISO 8601 instant such as 2026-06-01T10:00:00Z."""
    return calendar.timegm(time.strptime(epoch_utc, "%Y-%m-%dT%H:%M:%SZ")) * 1_000_000


OWN_DIALECT = PX4
"""In which our own ground station is spoken to, whatever the mission's dialect."""
