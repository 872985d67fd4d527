"""The world's journal: what sim_bridge heard, tick by tick, so that one which takes its place knows what is true.

The world is a function of what it hears. A step is written before its tick is sent: whoever takes over lives through
the rounds that are in the journal and sends the last tick once more.
"""

from __future__ import annotations

import logging
from pathlib import Path

import msgspec

from missions import topics
from missions.bus import Delivery
from missions.errors import UserError
from missions.messages import SPEC_HASH, Message, ShutterRequest, VehicleState
from missions.records import RecordFile, read_records
from missions.topics import Topic
from sim_bridge.clock_server import ClockState, Round

log = logging.getLogger(__name__)

HEARD: tuple[Topic[VehicleState] | Topic[ShutterRequest], ...] = (topics.VEHICLE_STATE, topics.SHUTTER)
"""What the truth depends on. What came through the doors is not told twice."""


class Head(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The first record. boot: under which name the bridge numbers its messages, also after it was started again."""

    spec_hash: str
    mission_hash: str
    boot: str


class Heard(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A delivery to the world: which topic, from whom, and the message."""

    topic: int
    who: str
    body: bytes


class Step(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What was heard in the round before, and the clock as its next tick was sent."""

    t_ns: int
    participants: list[str]
    heard: list[Heard]
    clock: ClockState

    def round(self) -> Round:
        """The round before, as the world knew it."""
        deliveries = [Delivery(HEARD[h.topic], h.who, "", self.t_ns, _decoded(h)) for h in self.heard]
        return Round(self.clock.tick - 1, self.t_ns, deliveries, frozenset(self.participants))


class WorldJournal:
    """The journal of one mission, that of an earlier bridge included. While the disk takes no more, nobody can take the
    bridge's place."""

    def __init__(self, path: Path, mission_hash: str, boot: str) -> None:
        """boot: that of this process. Raises UserError for another mission's journal."""
        self._steps: list[Step] = []
        self.boot = boot
        head = Head(SPEC_HASH, mission_hash, boot)
        if path.exists():
            head, self._steps = _read(path, head)
            self.boot = head.boot
        try:
            self._file = RecordFile(path)
        except BlockingIOError as e:
            raise UserError(f"{path}: another sim_bridge flies in this folder; give a fresh one.") from e
        self._troubled = False
        if not self._steps:
            self._file.clear()
            self._put(head)

    @property
    def begun(self) -> bool:
        """Whether an earlier bridge has sent its first tick."""
        return bool(self._steps)

    def take_past(self) -> list[Step]:
        """What an earlier bridge has lived through, once."""
        past, self._steps = self._steps, []
        return past

    def write(self, before: Round | None, clock: ClockState) -> None:
        """A tick is about to be sent. before: the round before it."""
        heard = [] if before is None else [
            Heard(HEARD.index(d.topic), d.who, msgspec.msgpack.encode(d.message))
            for d in before.deliveries if d.topic in HEARD]
        self._put(Step(0 if before is None else before.t_ns, [] if before is None else sorted(before.participants),
                       heard, clock))

    def close(self) -> None:
        """The mission is over."""
        self._file.close()

    def _put(self, record: msgspec.Struct) -> None:
        self._file.put(msgspec.msgpack.encode(record))
        if bool(self._file.error) != self._troubled:
            self._troubled = bool(self._file.error)
            log.warning("the world's journal %s", f"waits in memory ({self._file.error}): until it is on disk the "
                        "bridge cannot be started again" if self._troubled else "is on disk again")


def _read(path: Path, own: Head) -> tuple[Head, list[Step]]:
    """Raises UserError."""
    records = (record for record, _ in read_records(path))
    first = next(records, None)
    if first is None:
        return own, []
    head = msgspec.msgpack.decode(first, type=Head)
    if (head.spec_hash, head.mission_hash) != (own.spec_hash, own.mission_hash):
        raise UserError(f"{path}: of another mission, or another version of swarmscan; give the folder of this one.")
    return head, [msgspec.msgpack.decode(record, type=Step) for record in records]


def _decoded(heard: Heard) -> Message:
    message: Message = msgspec.msgpack.decode(heard.body, type=HEARD[heard.topic].type)
    return message
