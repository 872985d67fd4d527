"""`swarmscan simulate` as a subprocess, for tests with clients that we did not write."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import trimesh

MISSION = Path(__file__).parent / "missions" / "doors.toml"
GRACE_S = 300.0


def free_udp_port() -> int:
    """A UDP port on loopback that nobody has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def house(folder: Path) -> Path:
    """A box of 6 x 6 x 5 m on the ground."""
    path = folder / "house.ply"
    box = trimesh.creation.box((6.0, 6.0, 5.0))
    box.apply_translation((0.0, 0.0, 2.5))
    box.export(path)
    return path


@contextmanager
def simulated(folder: Path, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """The command with these options, told to end at the end."""
    command = [sys.executable, "-m", "ground_station.cli", "simulate", str(MISSION), "--scene", str(house(folder)),
               "--run", str(folder / "run"), *options]
    with (folder / "simulate.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder)
        try:
            yield process
        finally:
            process.send_signal(signal.SIGTERM)  # SIGINT may be ignored where the tests run in the background
            process.wait(GRACE_S)
