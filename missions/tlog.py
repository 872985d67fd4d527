"""Telemetry logs as MAVProxy, QGroundControl and pymavlink keep them: every frame as it was on the link, with its time.

A record is the time in µs since 1970, eight bytes with the highest first, and the frame. Written while the flight goes
on, so that a process that dies takes at most the last second of simulated time with it.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

from missions.clock import SECOND_NS
from missions.errors import UserError
from missions.mavlink import Endpoint
from missions.signing import SIGNATURE_BYTES, SIGNED

log = logging.getLogger(__name__)

STAMP_BYTES = 8


class Tlog:
    """A log that is being written; no file stays open in between."""

    def __init__(self, path: Path, epoch_utc: str) -> None:
        """epoch_utc: simulated time zero, ISO 8601."""
        self._path = path
        self._epoch_us = round(datetime.fromisoformat(epoch_utc).timestamp() * 1e6)
        self._records: list[bytes] = []
        self._due_ns = SECOND_NS
        self._size = 0
        path.write_bytes(b"")

    def write(self, frames: list[bytes], t_ns: int) -> None:
        """These frames were on the link at simulated time t_ns."""
        stamp = (self._epoch_us + t_ns // 1000).to_bytes(8, "big")
        self._records += [stamp + frame for frame in frames]
        if t_ns >= self._due_ns:
            self._due_ns = t_ns + SECOND_NS
            self.flush()

    def flush(self) -> None:
        """Put on disk what is still in memory; a disk that takes nothing now may do so later."""
        data = b"".join(self._records)
        try:
            with self._path.open("ab") as f:
                f.write(data)
        except OSError as e:
            log.error("%s: %s; what is missing is tried again", self._path, e)
            os.truncate(self._path, self._size)
            return
        self._size += len(data)
        self._records.clear()

    def rewind(self) -> None:
        """Forget on disk what came after this state was kept."""
        os.truncate(self._path, self._size)


def read_tlog(path: Path, epoch_utc: str) -> Iterator[tuple[float, Any]]:
    """(simulated time in s, message) of every whole frame, in order; the end may be torn. Raises UserError."""
    try:
        data = path.read_bytes()
    except OSError as e:
        raise UserError(f"{path}: no telemetry log ({e.strerror}); give the folder of a run that has flown.") from e
    epoch_us, parser, at = round(datetime.fromisoformat(epoch_utc).timestamp() * 1e6), Endpoint(0, 0), 0
    while at + STAMP_BYTES + 3 <= len(data):
        stamp_us = int.from_bytes(data[at:at + STAMP_BYTES], "big")
        begin, length = at + STAMP_BYTES, data[at + STAMP_BYTES + 1]
        at = begin + 12 + length + SIGNATURE_BYTES * (data[begin + 2] & SIGNED)
        if at > len(data):
            return
        for message in parser.parse([data[begin:at]]):
            yield (stamp_us - epoch_us) / 1e6, message
