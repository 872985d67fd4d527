"""A method under test as a pilot: a process of its own, which sees nothing but what it is sent."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from types import TracebackType

from missions.errors import ProtocolError, UserError
from missions.nbv_trial import Answer, Ask, Failure, Frame, ToMethod, TrialBrief, read_from_method, write_message

MODULE = "ground_station.nbv.player"
LAST_WORDS = 2000
"""Characters of a dead method's stderr that are told."""


class Player:
    """Starts the method's process; use as a context, so that it ends."""

    wants_pictures = True

    def __init__(self, brief: TrialBrief, threads: int) -> None:
        """threads: how many the method's libraries may start."""
        limits = {name: str(threads) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
                                                  "NUMBA_NUM_THREADS")}
        self._name = brief.method
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115, closed with the player
        self._process = subprocess.Popen([sys.executable, "-m", MODULE], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                         stderr=self._stderr, env={**os.environ, **limits})
        self._send(brief)

    def see(self, frame: Frame) -> None:
        """Send a picture."""
        self._send(frame)

    def choose(self, ask: Ask) -> Answer:
        """Ask, and wait as long as it takes. Raises UserError or ProtocolError when the method cannot go on."""
        self._send(ask)
        assert self._process.stdout is not None
        message = read_from_method(self._process.stdout)
        if isinstance(message, Answer):
            return message
        raise self._failed(message)

    def __enter__(self) -> Player:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        if error is not None:
            self._process.kill()
        with suppress(BrokenPipeError):
            self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()
        self._stderr.close()

    def _send(self, message: ToMethod) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            write_message(self._process.stdin, message)
        except BrokenPipeError:
            raise self._failed(read_from_method(self._process.stdout)) from None

    def _failed(self, message: object) -> UserError | ProtocolError:
        """What to raise when the method has said why, or has died."""
        if isinstance(message, Failure):
            return (UserError if message.wrong_input else ProtocolError)(f"method {self._name}: {message.reason}")
        self._process.wait()
        self._stderr.seek(0)
        words = self._stderr.read().decode(errors="replace")[-LAST_WORDS:]
        return ProtocolError(f"method {self._name} ended with code {self._process.returncode}: {words}")
