"""Starting the live page beside a ground station: a process of its own, so that drawing never slows the mission."""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

DEFAULT_PORT = 8090
GRACE_S = 5.0


def add_live_options(parser: argparse.ArgumentParser) -> None:
    """--live, --port, --wait."""
    parser.add_argument("--live", action="store_true", help="serve a live page on 127.0.0.1")
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help="of the live page (default %(default)s)")
    parser.add_argument("--wait", action="store_true", help="begin when somebody says so: on the page, or a program")


def live_options(options: argparse.Namespace) -> tuple[str, ...]:
    """The same options again, for the ground station that a launcher starts."""
    wanted = ("--live", "--port", str(options.port)) if options.live else ()
    return (*wanted, *(("--wait",) if options.wait else ()))


@contextmanager
def live_page(endpoint: str, fleet: str, port: int) -> Iterator[None]:
    """Serve the page while the mission is under way; it shows the end for a moment before it goes."""
    command = [sys.executable, "-m", "ground_station.live", "--connect", endpoint, "--fleet", fleet,
               "--port", str(port)]
    page = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=sys.stderr)
    try:
        yield
    finally:
        try:
            page.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            page.terminate()
            page.wait()
