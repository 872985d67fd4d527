"""A stub autopilot in real time on a UDP port, in a thread or as a program."""

from __future__ import annotations

import argparse
import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from tests.autopilot_stub import DT, AutopilotStub

MOST_S = 0.25


@contextmanager
def served(stub: AutopilotStub, port: int, host: str = "127.0.0.1") -> Iterator[AutopilotStub]:
    """The stub in real time in a thread of its own, sending to a port where somebody waits (udpin)."""
    over = threading.Event()
    thread = threading.Thread(target=_serve, args=(stub, (host, port), over), daemon=True)
    thread.start()
    try:
        yield stub
    finally:
        over.set()
        thread.join()


@contextmanager
def served_on(stub: AutopilotStub, descriptor: int) -> Iterator[AutopilotStub]:
    """The same on an open stream: a connection, or the far end of a serial line."""
    over = threading.Event()
    thread = threading.Thread(target=_serve_stream, args=(stub, descriptor, over), daemon=True)
    os.set_blocking(descriptor, False)
    thread.start()
    try:
        yield stub
    finally:
        over.set()
        thread.join()


class _Clock:
    """Seconds since the beginning. It stands still while this machine has no time for the stub: an autopilot always
    has, and would have heard meanwhile what has come."""

    def __init__(self) -> None:
        self._begin_s = self._last_s = time.monotonic()

    def now_s(self) -> float:
        """Goes on by MOST_S at once."""
        before_s, self._last_s = self._last_s, time.monotonic()
        self._begin_s += max(0.0, self._last_s - before_s - MOST_S)
        return self._last_s - self._begin_s


def _serve_stream(stub: AutopilotStub, descriptor: int, over: threading.Event) -> None:
    clock = _Clock()
    while not over.wait(DT / 2):
        with suppress(BlockingIOError):
            stub.receive(os.read(descriptor, 4096))
        for frame in stub.step(clock.now_s()):
            with suppress(BlockingIOError):
                os.write(descriptor, frame)


def _serve(stub: AutopilotStub, peer: tuple[str, int], over: threading.Event) -> None:
    clock = _Clock()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.setblocking(False)
        while not over.wait(DT / 2):
            with suppress(BlockingIOError, ConnectionRefusedError):
                while True:
                    stub.receive(s.recv(4096))
            for frame in stub.step(clock.now_s()):
                with suppress(ConnectionRefusedError, BlockingIOError):
                    s.sendto(frame, peer)


def main() -> None:
    """`python -m tests.serve_autopilot px4|ardupilot --system 1 --port 14550`, in place of a simulated autopilot."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("kind", choices=["px4", "ardupilot"])
    parser.add_argument("--system", type=int, default=1)
    parser.add_argument("--port", type=int, default=14550, help="where somebody waits on 127.0.0.1")
    options = parser.parse_args()
    _serve(AutopilotStub(options.kind, options.system), ("127.0.0.1", options.port), threading.Event())


if __name__ == "__main__":
    main()
