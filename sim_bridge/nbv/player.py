"""A method under test as a pilot: a process of its own, which sees nothing but what it is sent."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import TracebackType

from missions.errors import ProtocolError, UserError
from missions.nbv_trial import Answer, Ask, Failure, Frame, ToMethod, TrialBrief, read_from_method, write_message

MODULE = "ground_station.nbv.player"
LAST_WORDS = 2000
"""Characters of a dead method's stderr that are told."""


class Player:
    """Starts the method's process; use as a context, so that it ends."""

    wants_pictures = True

    def __init__(self, brief: TrialBrief, threads: int, patience_s: float) -> None:
        """threads: how many the method's libraries may start; patience_s: how long it may take, of wall time, to read
        a message or to answer one."""
        limits = {name: str(threads) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
                                                  "NUMBA_NUM_THREADS")}
        self._name, self._patience_s, self._hung = brief.method, patience_s, False
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115, closed with the player
        self._process = subprocess.Popen([sys.executable, "-m", MODULE], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                         stderr=self._stderr, env={**os.environ, **limits})
        self._send(brief)

    def see(self, frame: Frame) -> None:
        """Send a picture."""
        self._send(frame)

    def choose(self, ask: Ask) -> Answer:
        """Ask, and wait. Raises UserError or ProtocolError when the method cannot go on, or takes too long."""
        self._send(ask)
        assert self._process.stdout is not None
        with self._patience():
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
            with self._patience():
                write_message(self._process.stdin, message)
        except BrokenPipeError:
            raise self._failed(read_from_method(self._process.stdout)) from None

    @contextmanager
    def _patience(self) -> Iterator[None]:
        """Ends the method when what is done here takes too long."""
        timer = threading.Timer(self._patience_s, self._give_up)
        timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _give_up(self) -> None:
        self._hung = True
        self._process.kill()

    def _failed(self, message: object) -> UserError | ProtocolError:
        """What to raise when the method has said why, or has died."""
        if isinstance(message, Failure):
            return (UserError if message.wrong_input else ProtocolError)(f"method {self._name}: {message.reason}")
        self._process.wait()
        if self._hung:
            return ProtocolError(f"method {self._name} gave no answer within {self._patience_s:g} s and was ended; "
                                 "mend it, or allow more with --patience.")
        self._stderr.seek(0)
        words = self._stderr.read().decode(errors="replace")[-LAST_WORDS:]
        return ProtocolError(f"method {self._name} ended with code {self._process.returncode}: {words}")
