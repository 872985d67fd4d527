"""The port through which pictures are written: whole files or none, in bounded time, and in words why not.

Writes run in a thread of their own. A turn waits for one at most `patience_s`; a disk that takes longer counts as
troubled until it has caught up, and so does one that takes writes but is slow, time after time. What a disk answers is
no function of what was heard, so it can be recorded and relived.
"""

from __future__ import annotations

import contextlib
import errno
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

PATIENCE_S = 2.0
SLOW_S, SLOW_IN_A_ROW = 0.5, 3
"""So many writes that take so long each make a slow disk ..."""
LARGE_BYTES = 4096
"""... with none of this size or more between them that did not; smaller ones say nothing."""
Answer = tuple[bool, str]
"""Whether something was done, and what was wrong with the disk then."""
PROBE_BYTES = 1 << 20
"""A disk that was troubled is believed again when it takes this much."""
DISK_ERRORS = {errno.ENOSPC: "is full", errno.EDQUOT: "has no quota left", errno.EROFS: "is read-only",
               errno.EFBIG: "takes no files of this size", errno.EIO: "has errors"}
"""What can be wrong with a disk itself, to follow "the disk"."""
_WORDS = {**DISK_ERRORS, errno.EACCES: "may not be written to", errno.EPERM: "may not be written to",
          errno.ENOENT: "is gone"}


class Disk:
    """Of one folder."""

    def __init__(self, folder: Path, patience_s: float = PATIENCE_S, slow_s: float = SLOW_S) -> None:
        self.trouble = ""
        """What is wrong with it, to follow "the disk"; "" when nothing is."""
        self.slow_s = slow_s
        self._folder, self._patience_s = folder, patience_s
        self._slow = 0
        """Slow writes in a row."""
        self._answers: list[Answer] = []
        self._past: deque[Answer] | None = None

    def write(self, path: Path, data: bytes) -> bool:
        """Whether the whole file is there; else `trouble` says why."""
        return self._answer(self._do(lambda: _write_whole(path, data), len(data)))

    def append(self, path: Path, data: bytes) -> bool:
        """The same for what is put behind a file's end."""
        return self._answer(self._do(lambda: _append_whole(path, data), len(data)))

    def check(self) -> None:
        """Whether a disk that was troubled still is."""
        if not self.trouble:
            return
        probe = self._folder / ".probe"
        if self._do(lambda: _write_whole(probe, bytes(PROBE_BYTES)), PROBE_BYTES) and not self._slow:
            self.trouble = ""
            self._do(probe.unlink)
        self._answer(not self.trouble)

    def take_answers(self) -> list[Answer]:
        """What it has answered since this was last asked; nothing when all was well."""
        answers, self._answers = self._answers, []
        return answers if any(trouble or not done for done, trouble in answers) else []

    def relive(self, past: Sequence[Answer] | None) -> None:
        """Answer as it did then, whatever it does now; None: as it does."""
        self._past = None if past is None else deque(past)

    def _answer(self, done: bool) -> bool:
        if self._past is not None:
            done, self.trouble = self._past.popleft() if self._past else (True, "")
        self._answers.append((done, self.trouble))
        return done

    def _do(self, job: Callable[[], None], size_bytes: int = 0) -> bool:
        if self._folder in _HANGING and _HANGING[self._folder].is_alive():
            return False
        begin, write = time.monotonic(), _Job(job)
        write.start()
        write.join(self._patience_s)
        if write.is_alive():
            _HANGING[self._folder] = write
            self.trouble = f"has not answered for {self._patience_s:g} s"
        elif write.error is not None:
            self.trouble = _WORDS.get(write.error.errno or 0, f"refuses to write ({write.error.strerror})")
        else:
            self._time(time.monotonic() - begin, size_bytes)
            return True
        return False

    def _time(self, took_s: float, size_bytes: int) -> None:
        """A write has taken so long."""
        if took_s >= self.slow_s:
            self._slow += 1
            if self._slow >= SLOW_IN_A_ROW:
                self.trouble = f"is slow (more than {self.slow_s:g} s for a write)"
        elif size_bytes >= LARGE_BYTES:
            self._slow = 0


class _Job(threading.Thread):
    """One write; nobody waits at the end of the process for one that hangs."""

    def __init__(self, job: Callable[[], None]) -> None:
        super().__init__(name="disk", daemon=True)
        self._job = job
        self.error: OSError | None = None

    def run(self) -> None:
        try:
            self._job()
        except OSError as e:
            self.error = e


_HANGING: dict[Path, _Job] = {}
"""The write that each folder's disk has not answered yet."""


def _write_whole(path: Path, data: bytes) -> None:
    part = path.with_name(f"{path.name}.part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def _append_whole(path: Path, data: bytes) -> None:
    size = path.stat().st_size if path.exists() else 0
    try:
        with path.open("ab") as file:
            file.write(data)
    except OSError:
        with contextlib.suppress(OSError):
            os.truncate(path, size)
        raise
