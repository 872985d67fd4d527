"""The journal of a mission: everything the ground station heard, turn by turn, and a digest of what it said.

Decisions depend on what was heard alone, so the journal holds them too: `replay.py` makes them again. Written as the
mission goes on, one record a turn, so that a process that dies takes at most the turn under way with it; a torn last
record is left out when it is read. Pictures are not copied: they are in the run's folder, and pieces of them are put
back from there.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from ground_station.exif import without_metadata
from missions import topics
from missions.bus import Delivery
from missions.clock import Turn
from missions.disk import Answer
from missions.errors import UserError
from missions.messages import MAX_CHUNK, SPEC_HASH, PictureChunk, SiteBrief
from missions.mission import Mission, without_scene
from missions.mission_file import load_mission
from missions.records import RecordFile, read_records
from missions.run_folder import RunFolder
from missions.topics import Topic

log = logging.getLogger(__name__)

TOPICS: dict[str, Topic[Any]] = {t.path: t for t in vars(topics).values() if isinstance(t, Topic)}


class Head(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The first record."""

    spec_hash: str
    mission_hash: str
    site: SiteBrief
    waits: bool
    """Whether time begins when an operator says so."""


class Heard(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A delivery."""

    path: str
    who: str
    sender: str
    t_ns: int
    body: bytes


class Entry(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """One turn: what was heard, and the SHA-256 (first 16 bytes) of what was said in it."""

    tick: int
    t_ns: int
    stop: bool
    participants: list[str]
    deliveries: list[Heard]
    beside: list[Heard]
    said: bytes
    resumed: bool
    """Whether the ground station was away before: there are turns between the last one and this that nobody heard."""
    disk: list[Answer] = []
    """What the run folder's disk answered, when not all was well; see `missions/disk.py`."""


class Journal:
    """A journal that is being written, by one process at a time. What the disk does not take waits in memory."""

    def __init__(self, path: Path) -> None:
        """Go on with one after its last whole record. Raises UserError."""
        self._path, self._troubled = path, False
        try:
            self._file = RecordFile(path)
        except BlockingIOError as e:
            raise UserError(f"{path}: its ground station is still there; there is nothing to take up.") from e

    @classmethod
    def begin(cls, path: Path, mission_hash: str, site: SiteBrief, waits: bool = False) -> Journal:
        """A new one."""
        journal = cls(path)
        journal._file.clear()
        journal._put(Head(SPEC_HASH, mission_hash, site, waits))
        return journal

    @property
    def size(self) -> int:
        """Bytes so far."""
        return self._file.size_bytes

    @property
    def whole(self) -> bool:
        """Whether all turns are on disk."""
        return not self._file.error

    def write(self, turn: Turn, beside: Iterable[Delivery], said: bytes, disk: Sequence[Answer] = ()) -> None:
        """A turn is over. beside: what operators have said in it. disk: what the disk has answered."""
        self._put(Entry(turn.tick, turn.t_ns, turn.stop, sorted(turn.participants),
                        [_heard(d) for d in turn.deliveries], [_heard(d) for d in beside], said, turn.resumed,
                        list(disk)))

    def close(self) -> None:
        """The mission is over."""
        self._file.close()
        if not self.whole:
            log.error("%s: ends early, the disk took no more: %s", self._path, self._file.error)

    def _put(self, record: msgspec.Struct) -> None:
        self._file.put(msgspec.msgpack.encode(record))
        if self.whole == self._troubled:
            self._troubled = not self.whole
            log.warning("%s: %s", self._path, f"turns wait in memory: {self._file.error}" if self._troubled else
                        "all turns are on disk")


def read_head(path: Path) -> Head:
    """What the journal is of. Raises UserError."""
    first, _ = next(_records(path), (None, 0))
    if first is None:
        raise UserError(f"{path}: the journal is empty; the mission had not begun.")
    try:
        head = msgspec.msgpack.decode(first, type=Head)
    except msgspec.DecodeError as e:
        raise UserError(f"{path}: not a journal ({e}); give the folder of a run.") from e
    if head.spec_hash != SPEC_HASH:
        raise UserError(f"{path}: written by another version of swarmscan ({head.spec_hash}, this is {SPEC_HASH}); "
                        "replay it with that one.")
    return head


def journalled_mission(run: RunFolder) -> tuple[Mission, Head]:
    """The mission that a run's journal is of, as the ground station knows it, and the journal's head. Raises
    UserError."""
    if not run.mission.is_file():
        raise UserError(f"{run.root}: no mission.toml; give the folder of a run.")
    mission, head = without_scene(load_mission(run.mission)), read_head(run.journal)
    if head.mission_hash != mission.mission_hash:
        raise UserError(f"{run.mission}: not the mission that {run.journal} is of; put the file back that was flown.")
    return mission, head


def count_turns(path: Path) -> int:
    """How many whole turns the journal has."""
    return sum(1 for _ in _records(path)) - 1


def read_turns(run: RunFolder, begin: int = 0) -> Iterator[tuple[Turn, bytes]]:
    """Every whole turn of a run's journal, with the digest of what was said in it; from the byte `begin` on, where a
    record ends. Raises UserError."""
    records = _records(run.journal, begin)
    if begin == 0:
        next(records, None)
    for record, _ in records:
        e = msgspec.msgpack.decode(record, type=Entry)
        yield Turn(e.tick, e.t_ns, [_delivery(h, run) for h in e.deliveries], frozenset(e.participants), e.stop,
                   tuple(_delivery(h, run) for h in e.beside), e.resumed, tuple(e.disk)), e.said


def _records(path: Path, begin: int = 0) -> Iterator[tuple[bytes, int]]:
    """Every whole record, and where it ends. Raises UserError."""
    try:
        yield from read_records(path, begin)
    except OSError as e:
        raise UserError(f"{path}: no journal ({e.strerror}); give the folder of a run that has flown.") from e


def _heard(delivery: Delivery) -> Heard:
    message = delivery.message
    if isinstance(message, PictureChunk):
        message = msgspec.structs.replace(message, data=b"")
    return Heard(delivery.topic.path, delivery.who, delivery.sender, delivery.t_ns, msgspec.msgpack.encode(message))


def _delivery(heard: Heard, run: RunFolder) -> Delivery:
    topic = TOPICS[heard.path]
    message = msgspec.msgpack.decode(heard.body, type=topic.type)
    if isinstance(message, PictureChunk):
        message = msgspec.structs.replace(message, data=_piece(message, run))
    return Delivery(topic, heard.who, heard.sender, heard.t_ns, message)


def _piece(chunk: PictureChunk, run: RunFolder) -> bytes:
    """The bytes of a chunk, from the picture as it was kept; nothing of one that never became whole."""
    path = run.picture(chunk.meta.vehicle_id, chunk.meta.view_id)
    if not path.is_file():
        return b""
    return without_metadata(path.read_bytes())[chunk.index * MAX_CHUNK:(chunk.index + 1) * MAX_CHUNK]
