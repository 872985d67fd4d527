"""The ground's side of the MAVLink mission protocol over bad links: upload, download, and proof by comparison.

No sockets and no clock: messages and seconds come in, messages go out, until `over`. An upload counts as delivered only
when the vehicle's items, downloaded again, have the SHA-256 of those that were sent; its acknowledgement may be lost or
belong to another transfer, so it is believed only where it refuses. Everything lost is sent again until the deadline;
what is not proven by then has failed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from pymavlink.dialects.v20 import common as mav

from missions.flight_plan import has_place, with_wire_frames
from missions.mavlink import AUTOPILOT_COMPONENT, Item, item_from_message, item_message, plan_sha256

Answers = list[mav.MAVLink_message]
Outcome = Literal["under way", "done", "refused", "failed"]

FIRST_RESEND_S, LEAST_RESEND_S, MOST_RESEND_S = 0.25, 0.05, 1.0
QUIET_S = 1.5
"""A vehicle that asks for nothing as long as this has forgotten the upload, or never heard of it."""
UNCONFIRMED_AFTER = 8
"""Silent repeats of the last item after which the plan is looked at instead of waiting for an acknowledgement."""
CUT_M = 0.02
"""More than what is lost where an altitude is cut to centimetres."""
_REFUSALS = {
    mav.MAV_MISSION_UNSUPPORTED_FRAME: "a frame is not supported", mav.MAV_MISSION_UNSUPPORTED: "not supported",
    mav.MAV_MISSION_NO_SPACE: "too many items", mav.MAV_MISSION_INVALID: "an item is invalid",
    **{mav.MAV_MISSION_INVALID_PARAM1 + n: f"parameter {n + 1} of an item is invalid" for n in range(7)},
    mav.MAV_MISSION_DENIED: "denied"}
"""Results that another try will not change, in words. Others mean that the vehicle is busy or out of step."""


class Transfer(Protocol):
    """What `missions.mavlink_link.run` drives."""

    outcome: Outcome
    reason: str
    """In words, when it failed or was refused."""

    @property
    def over(self) -> bool:
        """Whether the outcome is known."""

    @property
    def progress(self) -> float:
        """Share 0-1 of what is to be done."""

    def receive(self, message: Any, t_s: float) -> Answers:
        """A message of the vehicle; answers to it."""

    def poll(self, t_s: float) -> Answers:
        """What is due at t_s. Call it every few hundredths of a second."""


@dataclass
class _Pace:
    """When to send again: after three times what answers took of late, reckoned from the last sending. On a lossy link
    that is the round trip; on a slow one half of `resend_s` on average, which therefore grows until it suffices."""

    resend_s: float = FIRST_RESEND_S
    sent_s: float = -math.inf
    repeats: int = 0

    def first(self, t_s: float) -> None:
        """Something new was sent."""
        self.sent_s, self.repeats = t_s, 0

    def again(self, t_s: float) -> None:
        """It was sent once more."""
        self.sent_s, self.repeats = t_s, self.repeats + 1

    def answered(self, t_s: float) -> None:
        """The answer came."""
        self.resend_s += 0.25 * (3.0 * (t_s - self.sent_s) - self.resend_s)
        self.resend_s = min(max(self.resend_s, LEAST_RESEND_S), MOST_RESEND_S)

    def due(self, t_s: float) -> bool:
        """Whether it is time to send again."""
        return t_s - self.sent_s >= self.resend_s


class _Exchange:
    """What upload and download have in common: whom with, about which type, and how it ended."""

    def __init__(self, system: int, mission_type: int) -> None:
        self.outcome: Outcome = "under way"
        self.reason = ""
        self.system, self.mission_type = system, mission_type
        self._pace = _Pace()

    @property
    def over(self) -> bool:
        """Whether the outcome is known."""
        return self.outcome != "under way"

    def receive(self, message: Any, t_s: float) -> Answers:
        """A message of anybody; answers, when it belongs to this exchange."""
        theirs = message.get_srcSystem() == self.system and message.get_srcComponent() == AUTOPILOT_COMPONENT
        if self.over or not theirs or getattr(message, "mission_type", None) != self.mission_type:
            return []
        return self._handle(message, t_s)

    def _handle(self, message: Any, t_s: float) -> Answers:
        raise NotImplementedError

    def _end(self, outcome: Outcome, reason: str = "") -> Answers:
        self.outcome, self.reason = outcome, reason
        return []


class Upload(_Exchange):
    """Items on their way. `done` says that the vehicle has asked for all of them, not yet that it holds them."""

    def __init__(self, items: list[Item], system: int, mission_type: int = mav.MAV_MISSION_TYPE_MISSION) -> None:
        super().__init__(system, mission_type)
        self._items = items
        self._last = -1
        """The item sent last."""
        self._furthest = -1
        self._heard_s = -math.inf

    @property
    def progress(self) -> float:
        """Share of the items that have been asked for."""
        return (self._furthest + 1) / max(1, len(self._items))

    def poll(self, t_s: float) -> Answers:
        """The count until the vehicle asks, then the last item until it asks for the next."""
        if self.over or not self._pace.due(t_s):
            return []
        complete = 0 <= self._last == len(self._items) - 1
        if complete and self._pace.repeats >= UNCONFIRMED_AFTER:
            return self._end("done")
        if not complete and t_s - self._heard_s >= QUIET_S:
            self._last, self._heard_s = -1, t_s
        self._pace.again(t_s)
        if self._last >= 0:
            return [self._item(self._last)]
        return [mav.MAVLink_mission_count_message(self.system, AUTOPILOT_COMPONENT, len(self._items),
                                                  self.mission_type)]

    def _handle(self, message: Any, t_s: float) -> Answers:
        kind = message.get_type()
        if kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and message.seq < len(self._items):
            self._heard_s = t_s
            if message.seq == self._last:
                self._pace.again(t_s)
            else:
                self._pace.answered(t_s)
                self._pace.first(t_s)
            self._last, self._furthest = message.seq, max(self._furthest, message.seq)
            return [self._item(message.seq)]
        if kind == "MISSION_ACK":
            self._acknowledged(message.type)
        return []

    def _acknowledged(self, result: int) -> None:
        if result == mav.MAV_MISSION_ACCEPTED:
            if self._last == len(self._items) - 1:  # -1 of no items: cleared
                self._end("done")
        elif result in _REFUSALS:
            self._end("refused", _REFUSALS[result])
        elif result == mav.MAV_MISSION_OPERATION_CANCELLED:
            self._last = -1

    def _item(self, seq: int) -> mav.MAVLink_message:
        return item_message(self._items[seq], seq, self.system, AUTOPILOT_COMPONENT, self.mission_type)


class Download(_Exchange):
    """What the vehicle holds: `items`, complete once done. One request at a time, as all autopilots understand it."""

    def __init__(self, system: int, mission_type: int = mav.MAV_MISSION_TYPE_MISSION,
                 deadline_s: float = math.inf) -> None:
        """deadline_s: on the clock of `poll`."""
        super().__init__(system, mission_type)
        self.items: list[Item] = []
        self._deadline_s = deadline_s
        self._count: int | None = None

    @property
    def progress(self) -> float:
        """Share of the items that have come."""
        return len(self.items) / max(1, self._count or 0)

    def poll(self, t_s: float) -> Answers:
        """The request that is due again."""
        if not self.over and t_s >= self._deadline_s:
            return self._end("failed", f"time was up, {self.progress:.0%} done")
        if self.over or not self._pace.due(t_s):
            return []
        self._pace.again(t_s)
        return [self._request()]

    def _handle(self, message: Any, t_s: float) -> Answers:
        kind = message.get_type()
        if kind == "MISSION_COUNT" and self._count is None:
            self._count = message.count
        elif kind == "MISSION_ITEM_INT" and self._count is not None and message.seq == len(self.items):
            self.items.append(item_from_message(message))
        elif kind == "MISSION_ACK" and message.type in _REFUSALS:
            return self._end("refused", _REFUSALS[message.type])
        elif kind == "MISSION_ACK" and message.type == mav.MAV_MISSION_INVALID_SEQUENCE:
            self.items, self._count = [], None  # the plan was replaced meanwhile
            return []
        else:
            return []
        self._pace.answered(t_s)
        self._pace.first(t_s)
        if len(self.items) < self._count:
            return [self._request()]
        self._end("done")
        return [mav.MAVLink_mission_ack_message(self.system, AUTOPILOT_COMPONENT, mav.MAV_MISSION_ACCEPTED,
                                                self.mission_type)]

    def _request(self) -> mav.MAVLink_message:
        if self._count is None:
            return mav.MAVLink_mission_request_list_message(self.system, AUTOPILOT_COMPONENT, self.mission_type)
        return mav.MAVLink_mission_request_int_message(self.system, AUTOPILOT_COMPONENT, len(self.items),
                                                       self.mission_type)


class VerifiedUpload:
    """Upload, download, compare; again until the vehicle holds exactly these items, or refuses them, or time is up.

    holds: whether what was read back, second, is what was sent, first (see `as_ardupilot_keeps`).
    """

    def __init__(self, items: list[Item], system: int, deadline_s: float,
                 mission_type: int = mav.MAV_MISSION_TYPE_MISSION,
                 holds: Callable[[list[Item], list[Item]], bool] | None = None) -> None:
        """deadline_s: on the clock of `poll`."""
        self.outcome: Outcome = "under way"
        self.reason = ""
        self.attempts = 0
        self._items, self._system, self._type, self._deadline_s = items, system, mission_type, deadline_s
        self._holds = holds or exactly
        self._step: Upload | Download = self._upload()

    @property
    def over(self) -> bool:
        """Whether the outcome is known."""
        return self.outcome != "under way"

    @property
    def progress(self) -> float:
        """Upload and download count half each."""
        return 0.5 * (self._step.progress + isinstance(self._step, Download))

    def receive(self, message: Any, t_s: float) -> Answers:
        """A message of the vehicle; answers to it."""
        return [] if self.over else self._after(self._step.receive(message, t_s))

    def poll(self, t_s: float) -> Answers:
        """What is due at t_s; when time is up, word to the vehicle that nothing more comes."""
        if self.over:
            return []
        if t_s < self._deadline_s:
            return self._after(self._step.poll(t_s))
        doing = "reading it back" if isinstance(self._step, Download) else "sending it"
        self.outcome = "failed"
        self.reason = f"no proof that it arrived; time was up {doing}, {self.progress:.0%} done in try {self.attempts}"
        return [mav.MAVLink_mission_ack_message(self._system, AUTOPILOT_COMPONENT,
                                                mav.MAV_MISSION_OPERATION_CANCELLED, self._type)]

    def _upload(self) -> Upload:
        self.attempts += 1
        return Upload(self._items, self._system, self._type)

    def _after(self, answers: Answers) -> Answers:
        step = self._step
        if step.outcome == "refused":
            self.outcome, self.reason = step.outcome, step.reason
        elif step.outcome == "done" and isinstance(step, Upload):
            self._step = Download(self._system, self._type)
        elif step.outcome == "done" and isinstance(step, Download):
            if self._holds(self._items, step.items):
                self.outcome = "done"
            else:
                self._step = self._upload()
        return answers


def canonical_sha256(items: list[Item]) -> str:
    """Identity of a plan, whichever of the two numbers that most frames have was used for them."""
    return plan_sha256(with_wire_frames(items))


def exactly(sent: list[Item], held: list[Item]) -> bool:
    """Whether a vehicle that keeps items as they are holds these."""
    return canonical_sha256(held) == canonical_sha256(sent)


def as_ardupilot_keeps(sent: list[Item], held: list[Item]) -> bool:
    """Whether ArduPilot holds these, as far as it can be read back: commands and places, altitudes cut to centimetres.
    It rewrites home (item 0), drops frames where there is no place, and keeps parameters in part or in fewer bits."""
    pairs = zip(with_wire_frames(sent[1:]), with_wire_frames(held[1:]), strict=False)
    return len(sent) == len(held) and all(a.command == b.command and _one_place(a, b) for a, b in pairs)


def _one_place(sent: Item, held: Item) -> bool:
    if sent.frame == mav.MAV_FRAME_MISSION:
        return True
    same = not has_place(sent) or (sent.x, sent.y) == (held.x, held.y)
    return same and sent.frame == held.frame and abs(sent.z - held.z) <= CUT_M
