"""A file of records that grows as things happen: each with its length and a CRC, a torn last one is left out."""

from __future__ import annotations

import contextlib
import fcntl
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

_FRAME = struct.Struct("<II")
"""Length and CRC-32 of a record."""
TRY_AGAIN = 10
"""While the disk takes nothing, every so many records it is tried again."""


class RecordFile:
    """Writes records behind the whole ones that are there; in the hands of the system before `put` returns, or, while
    the disk takes no more, kept in memory to be written before what comes after them. One process at a time."""

    def __init__(self, path: Path) -> None:
        """Raises OSError; BlockingIOError while another process writes it."""
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the kernel lets go of it however a process ends
            self._end = max((end for _, end in read_records(path)), default=0)
            os.ftruncate(self._fd, self._end)
        except OSError:
            os.close(self._fd)
            raise
        self._waiting: list[bytes] = []
        self.error = ""
        """Why records wait; "" when none does."""

    @property
    def size_bytes(self) -> int:
        """Of the records that are in the file."""
        return self._end

    def clear(self) -> None:
        """Begin anew. Raises OSError."""
        os.ftruncate(self._fd, 0)
        self._end = 0

    def put(self, data: bytes) -> None:
        """One record more."""
        self._waiting.append(_FRAME.pack(len(data), zlib.crc32(data)) + data)
        if not self.error or len(self._waiting) % TRY_AGAIN == 0:
            self._flush()

    def close(self) -> None:
        """No more. What still waits is tried once more."""
        self._flush()
        os.close(self._fd)

    def _flush(self) -> None:
        data, done = memoryview(b"".join(self._waiting)), 0
        try:
            while done < len(data):
                done += os.pwrite(self._fd, data[done:], self._end + done)
        except OSError as e:
            self.error = e.strerror or str(e)
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, self._end)
            return
        self._end += len(data)
        self.error = ""
        self._waiting.clear()


def read_records(path: Path, begin: int = 0) -> Iterator[tuple[bytes, int]]:
    """Every whole record from a byte on, and where it ends, up to a torn one. Raises OSError."""
    with path.open("rb") as file:
        file.seek(begin)
        while len(frame := file.read(_FRAME.size)) == _FRAME.size:
            length, crc = _FRAME.unpack(frame)
            data = file.read(length)
            if len(data) < length or zlib.crc32(data) != crc:
                return
            yield data, file.tell()
