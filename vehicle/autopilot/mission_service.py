"""The vehicle's side of the MAVLink mission protocol, for flight plan, geofence and rally points.

Double-buffered: a plan takes effect whole when its last item has arrived and it was accepted; a broken upload leaves
the old one. Items of our own ground station are requested several at a time; others get one request at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mav

from missions.mavlink import Item, item_from_message, item_message
from vehicle.autopilot.craft import MISSION, Shelf

MAX_ITEMS = 4000
REQUEST_AGAIN_NS = 250_000_000
GIVE_UP_AFTER = 20
"""Silent rounds of re-requests after which an upload is dropped."""
SAME_UPLOAD_NS = 1_000_000_000
"""A COUNT this long after the last item begins anew: its sender may have another plan of the same length by now."""
WINDOW = 64


@dataclass
class _Upload:
    system: int
    component: int
    count: int
    kind: int
    window: int
    heard_ns: int
    items: dict[int, Item] = field(default_factory=dict)
    requested_ns: int = 0
    rounds: int = 0
    asked: set[int] = field(default_factory=set)

    def wanted(self) -> list[int]:
        missing = (seq for seq in range(self.count) if seq not in self.items)
        return [seq for seq, _ in zip(missing, range(self.window), strict=False)]


Accept = Callable[[int, list[Item]], int]
"""Judges the whole list of items of a mission type: MAV_MISSION_ACCEPTED makes it the plan."""


@dataclass(frozen=True)
class TransferStyle:
    """How one face transfers missions."""

    window: int = 1
    """Items asked for at a time."""
    request_ints: bool = True
    home: Callable[[], Item] | None = None
    """Item 0 of the flight plan where that is the home position, which is not flown."""


class MissionService:
    """Holds at most one upload under way; accepted items go to the shelves that all faces share."""

    def __init__(self, shelves: dict[int, Shelf], accept: Accept, jump: Callable[[int], None],
                 style: TransferStyle) -> None:
        """jump: goes on with this item of the flight plan."""
        self._shelves, self._accept, self._jump, self._style = shelves, accept, jump, style
        self._upload: _Upload | None = None
        self._last: tuple[int, int, int] | None = None
        """Result, count and mission type of the upload that ended last."""

    def handle(self, message: Any, t_ns: int) -> list[mav.MAVLink_message] | None:
        """Answers to a mission message; None when it is not one."""
        handler = _HANDLERS.get(message.get_type())
        if handler is None:
            return None
        kind = getattr(message, "mission_type", MISSION)
        if kind not in self._shelves and not (kind == mav.MAV_MISSION_TYPE_ALL and
                                              message.get_type() == "MISSION_CLEAR_ALL"):
            return [self._ack(message, mav.MAV_MISSION_UNSUPPORTED, kind)]
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
                                                    mav.MAV_MISSION_OPERATION_CANCELLED, upload.kind)]
        upload.asked.clear()
        return self._requests(t_ns)

    def shown_seq(self, seq: int) -> int:
        """The number by which this face knows item `seq` of the flight plan."""
        return seq + self._before(MISSION)

    def _before(self, kind: int) -> int:
        """Items that stand before the first one of ours."""
        return int(kind == MISSION and self._style.home is not None)

    def _count(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        sender = message.get_srcSystem(), message.get_srcComponent()
        kind, count = message.mission_type, message.count
        if count == 0:
            return self._clear(message, t_ns)
        if count > MAX_ITEMS:
            return [self._ack(message, mav.MAV_MISSION_NO_SPACE, kind)]
        running = self._upload
        if running is not None and (running.system, running.component) != sender:
            return [self._ack(message, mav.MAV_MISSION_DENIED, kind)]
        same = running is not None and (running.count, running.kind) == (count, kind)
        if running is None or not same or t_ns - running.heard_ns >= SAME_UPLOAD_NS:
            self._upload = _Upload(*sender, count, kind, self._style.window, t_ns)
        else:
            running.asked.clear()
        return self._requests(t_ns)

    def _item(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        upload = self._upload
        if upload is None or upload.kind != message.mission_type:
            late = self._last is not None and (message.seq, message.mission_type) == (self._last[1] - 1, self._last[2])
            return [self._ack(message, self._last[0], self._last[2])] if late and self._last is not None else []
        if message.seq >= upload.count:
            return [self._ack(message, mav.MAV_MISSION_INVALID_SEQUENCE, upload.kind)]
        if message.seq in upload.items:
            return []  # answering a duplicate with a request would set off a storm of both
        upload.items[message.seq] = item_from_message(message)
        upload.rounds, upload.requested_ns, upload.heard_ns = 0, t_ns, t_ns
        if len(upload.items) < upload.count:
            return self._requests(t_ns) if upload.asked <= upload.items.keys() else []
        return [self._finish(upload, message)]

    def _finish(self, upload: _Upload, message: Any) -> mav.MAVLink_message:
        self._upload = None
        items = [upload.items[seq] for seq in range(self._before(upload.kind), upload.count)]
        result = self._accept(upload.kind, items)
        if result == mav.MAV_MISSION_ACCEPTED:
            self._shelves[upload.kind].put(items)
        self._last = (result, upload.count, upload.kind)
        return self._ack(message, result, upload.kind)

    def _request_list(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        return [mav.MAVLink_mission_count_message(message.get_srcSystem(), message.get_srcComponent(),
                                                  len(self._shown(message.mission_type)), message.mission_type)]

    def _request(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        items = self._shown(message.mission_type)
        if message.seq >= len(items):
            return [self._ack(message, mav.MAV_MISSION_INVALID_SEQUENCE, message.mission_type)]
        return [item_message(items[message.seq], message.seq, message.get_srcSystem(), message.get_srcComponent(),
                             message.mission_type)]

    def _shown(self, kind: int) -> list[Item]:
        """The items as this face shows them."""
        items, home = self._shelves[kind].items, self._style.home
        return [home(), *items] if items and home is not None and kind == MISSION else items

    def _clear(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        wanted = message.mission_type
        kinds = [k for k in self._shelves if wanted in (k, mav.MAV_MISSION_TYPE_ALL)]
        results = [self._accept(kind, []) for kind in kinds]
        refused = next((r for r in results if r != mav.MAV_MISSION_ACCEPTED), None)
        if refused is None:
            self._upload, self._last = None, None
            for kind in kinds:
                self._shelves[kind].put([])
        return [self._ack(message, mav.MAV_MISSION_ACCEPTED if refused is None else refused, wanted)]

    def _set_current(self, message: Any, t_ns: int) -> list[mav.MAVLink_message]:
        if not self.go_on_with(message.seq):
            return [self._ack(message, mav.MAV_MISSION_INVALID_SEQUENCE)]
        return [mav.MAVLink_mission_current_message(message.seq)]

    def go_on_with(self, shown_seq: int) -> bool:
        """Make this item, as the face numbers them, the next one; False when there is none such."""
        plan, seq = self._shelves[MISSION], max(0, shown_seq - self._before(MISSION))
        if seq >= len(plan.items):
            return False
        plan.current = seq
        self._jump(seq)
        return True

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
        request = (mav.MAVLink_mission_request_int_message if self._style.request_ints
                   else mav.MAVLink_mission_request_message)
        return [request(upload.system, upload.component, seq, upload.kind) for seq in wanted]

    def _ack(self, message: Any, result: int, kind: int = MISSION) -> mav.MAVLink_message:
        return mav.MAVLink_mission_ack_message(message.get_srcSystem(), message.get_srcComponent(), result, kind)


_HANDLERS: dict[str, Callable[[MissionService, Any, int], list[mav.MAVLink_message]]] = {
    "MISSION_COUNT": MissionService._count,
    "MISSION_ITEM_INT": MissionService._item,
    "MISSION_ITEM": MissionService._item,
    "MISSION_REQUEST_LIST": MissionService._request_list,
    "MISSION_REQUEST_INT": MissionService._request,
    "MISSION_REQUEST": MissionService._request,
    "MISSION_CLEAR_ALL": MissionService._clear,
    "MISSION_SET_CURRENT": MissionService._set_current,
    "MISSION_ACK": MissionService._cancel,
}
