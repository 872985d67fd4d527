"""The mission protocol of the two stub autopilots: how each asks for items, what it refuses, keeps, and gives back."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

TAKEOFF, WAYPOINT = 22, 16
PLACES = (16, 17, 18, 19, 21, 22, 82, 201)
EMPTY = 65535


@dataclass
class _Transfer:
    sender: tuple[int, int]
    count: int
    items: dict[int, Any] = field(default_factory=dict)
    asked: int = 0
    asked_t: float = 0.0


class StubMissions:
    """One mission (type 0). PX4 keeps what it was sent; ArduPilot rewrites much of it."""

    def __init__(self, px4: bool, home: tuple[float, float, float]) -> None:
        self.px4, self.home = px4, home
        self.items: list[Any] = []
        self.current = 0
        self._transfer: _Transfer | None = None

    @property
    def total(self) -> int:
        """MISSION_CURRENT.total."""
        if self.px4:
            return len(self.items) or EMPTY
        return max(0, len(self.items) - 1)

    @property
    def startable(self) -> str:
        """Why AUTO would not fly it; empty when it would."""
        flown = self.items if self.px4 else self.items[1:]
        if not flown:
            return "no mission"
        return "" if self.px4 or flown[0].command == TAKEOFF else "Missing Takeoff Cmd"

    def handle(self, m: Any, t: float) -> list[Any] | None:
        """Answers; None for what is no mission message."""
        handler = getattr(self, "_on_" + m.get_type().lower(), None)
        return None if handler is None else handler(m, t)

    def step(self, t: float) -> list[Any]:
        """Asks again, and gives up: PX4 with a text alone, ArduPilot with an acknowledgement."""
        transfer = self._transfer
        if transfer is None or t - transfer.asked_t < (0.25 if self.px4 else 0.9):
            return []
        if transfer.asked >= (20 if self.px4 else 9):
            self._transfer = None
            if self.px4:
                return [mav.MAVLink_statustext_message(4, b"Operation timeout")]
            return [mav.MAVLink_mission_ack_message(*transfer.sender, mav.MAV_MISSION_OPERATION_CANCELLED)]
        return [self._ask(transfer, t)]

    def _on_mission_count(self, m: Any, t: float) -> list[Any]:
        self._transfer = _Transfer((m.get_srcSystem(), m.get_srcComponent()), m.count)
        if m.count == 0:
            return [self._done([])]
        return [self._ask(self._transfer, t)]

    def _on_mission_item_int(self, m: Any, t: float) -> list[Any]:
        transfer = self._transfer
        if transfer is None or m.seq != len(transfer.items):
            return []
        result = mav.MAV_MISSION_ACCEPTED if self.px4 else _refusal(m)
        if result != mav.MAV_MISSION_ACCEPTED:
            self._transfer = None
            return [mav.MAVLink_mission_ack_message(*transfer.sender, result)]
        transfer.items[m.seq], transfer.asked = m, 0
        if len(transfer.items) == transfer.count:
            return [self._done([transfer.items[n] for n in range(transfer.count)])]
        return [self._ask(transfer, t)]

    def _on_mission_request_list(self, m: Any, t: float) -> list[Any]:
        return [mav.MAVLink_mission_count_message(m.get_srcSystem(), m.get_srcComponent(), len(self.items))]

    def _on_mission_request_int(self, m: Any, t: float) -> list[Any]:
        kept = self.items[m.seq] if self.px4 else self._rewritten(self.items[m.seq])
        return [mav.MAVLink_mission_item_int_message(
            m.get_srcSystem(), m.get_srcComponent(), m.seq, kept.frame, kept.command, int(m.seq == self.current), 1,
            kept.param1, kept.param2, kept.param3, kept.param4, kept.x, kept.y, kept.z)]

    def _on_mission_clear_all(self, m: Any, t: float) -> list[Any]:
        self._transfer = _Transfer((m.get_srcSystem(), m.get_srcComponent()), 0)
        return [self._done([])]

    def _on_mission_set_current(self, m: Any, t: float) -> list[Any]:
        if m.seq < len(self.items):
            self.current = m.seq
        return [mav.MAVLink_mission_current_message(self.current, self.total)]

    def _done(self, items: list[Any]) -> Any:
        assert self._transfer is not None
        sender, self._transfer = self._transfer.sender, None
        self.items, self.current = items, 0
        return mav.MAVLink_mission_ack_message(*sender, mav.MAV_MISSION_ACCEPTED)

    def _ask(self, transfer: _Transfer, t: float) -> Any:
        transfer.asked, transfer.asked_t = transfer.asked + 1, t
        make = mav.MAVLink_mission_request_int_message if self.px4 else mav.MAVLink_mission_request_message
        return make(*transfer.sender, len(transfer.items))

    def _rewritten(self, item: Any) -> Any:
        """Home at the height it knows; frames 6 and 2 as 3 and 0; of a waypoint no acceptance radius."""
        kept = type("Kept", (), {n: getattr(item, n) for n in (
            "frame", "command", "param1", "param2", "param3", "param4", "x", "y", "z")})()
        kept.frame = {6: 3, 2: 0}.get(item.frame, item.frame)
        for name in ("param1", "param2", "param3", "param4"):
            if math.isnan(getattr(kept, name)):
                setattr(kept, name, 0.0)
        if item.command == WAYPOINT:
            kept.param2 = 0.0
        if item.seq == 0:
            kept.frame, kept.z = 0, self.home[2]
        return kept


def _refusal(m: Any) -> int:
    """Of ArduPilot: numbers that cannot be."""
    if math.isnan(m.param1):
        return int(mav.MAV_MISSION_INVALID_PARAM1)
    if m.command in PLACES and abs(m.x) > 90 * 10**7:
        return int(mav.MAV_MISSION_INVALID_PARAM5_X)
    return int(mav.MAV_MISSION_ACCEPTED)
