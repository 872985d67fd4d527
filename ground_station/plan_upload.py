"""The ground side of one plan transfer: hash first, then COUNT, REQUEST_INT, ITEM_INT, ACK, and the vehicle's verdict.

Only a verdict that names this plan and its SHA-256 makes the plan accepted; everything else ends in refusal or
failure, never in a part of a plan. What is lost is sent again after RESEND_S of simulated time, until the deadline.
"""

from __future__ import annotations

from typing import Any, Literal

from pymavlink.dialects.v20 import common as mav

from missions.clock import SECOND_NS
from missions.frames import Site
from missions.mavlink import AUTOPILOT_COMPONENT, Route, item_message, items_from_route, plan_sha256
from missions.messages import PlanHash, PlanVerdict

RESEND_S = 0.5
DEADLINE_S = 30.0

UploadState = Literal["new", "transfer", "accepted", "refused", "failed"]


class PlanUpload:
    """One route on its way to one vehicle. Feed it what arrives; `poll` gives what is to be sent."""

    def __init__(self, route: Route, site: Site) -> None:
        self.route = route
        self.items = items_from_route(route, site)
        self.sha256 = plan_sha256(self.items)
        self.state: UploadState = "new"
        self.reason = ""
        self._asked: list[int] = []
        self._deadline_ns = self._resend_ns = 0
        self._ack = "no answer"

    @property
    def plan_hash(self) -> PlanHash:
        """The announcement that precedes the MAVLink transfer."""
        return PlanHash(plan_id=self.route.plan_id, count=len(self.items), sha256=self.sha256)

    @property
    def over(self) -> bool:
        """Whether the outcome is known."""
        return self.state in ("accepted", "refused", "failed")

    def on_message(self, message: Any) -> None:
        """A MAVLink message of the vehicle; everything but requests and acknowledgements of missions is ignored."""
        kind = message.get_type()
        if self.state != "transfer" or getattr(message, "mission_type", 0) != mav.MAV_MISSION_TYPE_MISSION:
            return
        if kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and message.seq < len(self.items):
            self._asked.append(message.seq)
        elif kind == "MISSION_ACK":
            self._ack = f"acknowledged with {message.type}, no verdict"

    def on_verdict(self, verdict: PlanVerdict) -> None:
        """The vehicle's decision about a whole plan."""
        if self.state != "transfer" or verdict.plan_id != self.route.plan_id:
            return
        if verdict.accepted and verdict.sha256 == self.sha256:
            self.state = "accepted"
        elif verdict.accepted:
            self.state, self.reason = "failed", "the vehicle holds another plan than the one sent"
        else:
            self.state, self.reason = "refused", verdict.reason

    def poll(self, t_ns: int, system: int) -> tuple[PlanHash | None, list[mav.MAVLink_message]]:
        """What to send at t_ns to this MAVLink system: perhaps the hash, and mission messages."""
        if self.over:
            return None, []
        if self.state == "new":
            self.state, self._deadline_ns = "transfer", t_ns + round(DEADLINE_S * SECOND_NS)
            self._resend_ns = t_ns
        if t_ns >= self._deadline_ns:
            self.state, self.reason = "failed", f"plan {self.route.plan_id} not delivered in time ({self._ack})"
            return None, []
        messages = [item_message(self.items[seq], seq, system, AUTOPILOT_COMPONENT) for seq in self._asked]
        announce = t_ns >= self._resend_ns and not messages
        if announce:
            messages = [mav.MAVLink_mission_count_message(system, AUTOPILOT_COMPONENT, len(self.items),
                                                          mav.MAV_MISSION_TYPE_MISSION)]
        if messages:
            self._resend_ns = t_ns + round(RESEND_S * SECOND_NS)
        self._asked.clear()
        return (self.plan_hash if announce else None), messages
