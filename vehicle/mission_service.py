"""The vehicle's side of the MAVLink mission protocol: upload, download, clear, set current.

Double-buffered: a plan takes effect whole when its last item has arrived and it was accepted; a broken upload leaves
the old one. Items of our own ground station are requested several at a time; others get one request at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mav

from missions.mavlink import GROUND_COMPONENT, GROUND_SYSTEM, Item, item_from_message, item_message

MAX_ITEMS = 4000
REQUEST_AGAIN_NS = 250_000_000
GIVE_UP_AFTER = 20
"""Silent rounds of re-requests after which an upload is dropped."""
WINDOW = 64


@dataclass
class _Upload:
    system: int
    component: int
    count: int
    items: dict[int, Item] = field(default_factory=dict)
    requested_ns: int = 0
    rounds: int = 0
    asked: set[int] = field(default_factory=set)

    @property
    def window(self) -> int:
        ours = (self.system, self.component) == (GROUND_SYSTEM, GROUND_COMPONENT)
        return WINDOW if ours else 1

    def wanted(self) -> list[int]:
        missing = (seq for seq in range(self.count) if seq not in self.items)
        return [seq for seq, _ in zip(missing, range(self.window), strict=False)]


class MissionService:
    """Holds the accepted plan's items and at most one upload under way."""

    def __init__(self, accept: Callable[[list[Item]], bool], jump: Callable[[int], None]) -> None:
        """accept: judges a complete plan; True makes it the plan. jump: goes on with this item of it."""
        self.items: list[Item] = []
        self.current = 0
        self._accept, self._jump = accept, jump
        self._upload: _Upload | None = None
        self._last_ack: tuple[int, int, int] | None = None

    def handle(self, message: Any, t_ns: int) -> list[mav.MAVLink_message] | None:
        """Answers to a mission message; None when it is not one, or not for the flight plan."""
        handler = _HANDLERS.get(message.get_type())
        if handler is None:
            return None
        if getattr(message, "mission_type", 0) not in (mav.MAV_MISSION_TYPE_MISSION, mav.MAV_MISSION_TYPE_ALL):
            return [self._ack(message, mav.MAV_MISSION_UNSUPPORTED, message.mission_type)]
        return handler(self, message, t_ns)

    def poll(self, t_ns: int) -> list[mav.MAVLink_message]:
        """Requests that are due again."""
        upload = self._upload
        if upload is None or t_ns - upload.requested_ns < REQUEST_AGAIN_NS:
            return []
        upload.rounds += 1
        if upload.rounds > GIVE_UP_AFTER:
            self._upload = None
            return [mav.MAVLink_mission_ack_message(upload.system, upload.component,
                                                    mav.MAV_MISSION_OPERATION_CANCELLED)]
        upload.asked.clear()
        return self._requests(t_ns)

    def _count(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        sender = message.get_srcSystem(), message.get_srcComponent()
        if message.count == 0:
            return self._clear(message, t_ns)
        if message.count > MAX_ITEMS:
            return [self._ack(message, mav.MAV_MISSION_NO_SPACE)]
        running = self._upload
        if running is None or (running.system, running.component, running.count) != (*sender, message.count):
            self._upload = _Upload(*sender, message.count)
        else:
            running.asked.clear()
        return self._requests(t_ns)

    def _item(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        upload = self._upload
        if upload is None:
            late = self._last_ack is not None and message.seq == self._last_ack[1] - 1
            return [self._ack(message, self._last_ack[0])] if late and self._last_ack is not None else []
        if message.seq >= upload.count:
            return [self._ack(message, mav.MAV_MISSION_INVALID_SEQUENCE)]
        if message.seq in upload.items:
            return []  # answering a duplicate with a request would set off a storm of both
        upload.items[message.seq] = item_from_message(message)
        upload.rounds, upload.requested_ns = 0, t_ns
        if len(upload.items) < upload.count:
            return self._requests(t_ns) if upload.asked <= upload.items.keys() else []
        self._upload = None
        items = [upload.items[seq] for seq in range(upload.count)]
        accepted = self._accept(items)
        if accepted:
            self.items, self.current = items, 0
        result = mav.MAV_MISSION_ACCEPTED if accepted else mav.MAV_MISSION_DENIED
        self._last_ack = (result, upload.count, t_ns)
        return [self._ack(message, result)]

    def _request_list(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        return [mav.MAVLink_mission_count_message(message.get_srcSystem(), message.get_srcComponent(),
                                                  len(self.items))]

    def _request(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        if message.seq >= len(self.items):
            return [self._ack(message, mav.MAV_MISSION_INVALID_SEQUENCE)]
        return [item_message(self.items[message.seq], message.seq, message.get_srcSystem(),
                             message.get_srcComponent())]

    def _clear(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        self._upload, self._last_ack = None, None
        self.items, self.current = [], 0
        self._accept([])
        return [self._ack(message, mav.MAV_MISSION_ACCEPTED)]

    def _set_current(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        if message.seq >= len(self.items):
            return [self._ack(message, mav.MAV_MISSION_INVALID_SEQUENCE)]
        self.current = message.seq
        self._jump(message.seq)
        return [mav.MAVLink_mission_current_message(message.seq)]

    def _cancel(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        if message.type == mav.MAV_MISSION_OPERATION_CANCELLED:
            self._upload = None
        return []

    def _requests(self, t_ns: int) -> list[mav.MAVLink_message]:
        upload = self._upload
        assert upload is not None, "requests belong to an upload"
        upload.requested_ns = t_ns
        wanted = upload.wanted()
        upload.asked = set(wanted)
        return [mav.MAVLink_mission_request_int_message(upload.system, upload.component, seq) for seq in wanted]

    def _ack(self, message: Any, result: int, mission_type: int = 0) -> mav.MAVLink_message:
        return mav.MAVLink_mission_ack_message(message.get_srcSystem(), message.get_srcComponent(), result,
                                               mission_type)


_HANDLERS: dict[str, Callable[[MissionService, Any, int], list[mav.MAVLink_message]]] = {
    "MISSION_COUNT": MissionService._count,
    "MISSION_ITEM_INT": MissionService._item,
    "MISSION_REQUEST_LIST": MissionService._request_list,
    "MISSION_REQUEST_INT": MissionService._request,
    "MISSION_CLEAR_ALL": MissionService._clear,
    "MISSION_SET_CURRENT": MissionService._set_current,
    "MISSION_ACK": MissionService._cancel,
}
