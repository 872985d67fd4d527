"""The processes of a mission on this machine: started, watched, ended together."""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from missions.clock import GROUND
from missions.mission import Mission
from missions.run_folder import RunFolder

log = logging.getLogger(__name__)

GRACE_S = 30.0
"""Between asking a process to end and killing it: it may be in a long computation on a busy machine, and what it has
not written then is lost."""
HOME_S = 300.0
"""For a vehicle with a real autopilot, which first brings its aircraft home."""
POLL_S = 0.1
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Process:
    """One row of the process table. threads limits numeric libraries; 0 leaves them alone."""

    name: str
    module: str
    arguments: tuple[str, ...]
    essential: bool
    threads: int = 0
    grace_s: float = GRACE_S
    restarts: int = 0
    """How often it is started again when it is killed."""


def process_table(mission: Mission, run: RunFolder, endpoint: str, fleet: str, *, ground: bool = True,
                  quiet: bool = False, live: tuple[str, ...] = (),
                  autopilots: Mapping[int, str] | None = None) -> list[Process]:
    """Everything that runs during the flight, in starting order. ground: whether a ground station of ours takes part;
    quiet and live: its options. autopilots: addresses of the vehicles that are real ones."""
    common = (str(run.mission), "--run", str(run.root), "--fleet", fleet)
    wired = {k: ("--autopilot", url) for k, url in (autopilots or {}).items()}
    alone, hush = () if ground else ("--no-ground",), ("--quiet",) if quiet else ()
    table = [
        Process("bridge", "sim_bridge", (*common, "--listen", endpoint, *alone), essential=True,
                restarts=mission.fleet.restarts),
        *(Process(f"uav{k}", "vehicle", (*common, "--id", str(k), "--connect", endpoint, *wired.get(k, ())),
                  essential=False, threads=1, grace_s=HOME_S if k in wired else GRACE_S,
                  restarts=0 if k in wired else mission.fleet.restarts)
          for k in range(1, mission.fleet.vehicles + 1)),
    ]
    if ground:
        table.append(Process("ground", "ground_station", (*common, "--connect", endpoint, *hush, *live),
                             essential=True))
    return table


class Flight:
    """The running processes of one mission."""

    def __init__(self, table: list[Process], run: RunFolder, keep: dict[str, str]) -> None:
        self._run = run
        self._table = {p.name: p for p in table}
        self._logs: list[IO[bytes]] = []
        self._keep, self._restarts = keep, {p.name: p.restarts for p in table}
        self._orphaned = 0
        """Exit code of a ground station that was killed."""
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        try:
            for process in table:
                self.running[process.name] = self._start(process)
        except OSError:
            self.stop()
            raise

    def wait(self) -> list[str]:
        """Wait until the ground station and the bridge are done; returns what went wrong, a sentence each."""
        complaints = []
        essential = {name for name, p in self._table.items() if p.essential}
        while essential & self.running.keys():
            for name, child in list(self.running.items()):
                code = child.poll()
                if code is None or (code < 0 and self._start_again(name, code)):
                    continue
                del self.running[name]
                if name == "ground" and code < 0 and "bridge" in self.running:
                    self._orphaned = code
                    log.error("the ground station was killed (signal %d): vehicles finish their plans and come home; "
                              "'swarmscan resume %s' takes the mission up again", -code, self._run.root)
                    essential.discard(name)
                    continue
                if code != 0:
                    where = "its messages above" if name == "ground" else str(self._log_path(name))
                    complaints.append(f"{name} ended with code {code}; read {where}.")
                    log.warning(complaints[-1])
                if code != 0 and name in essential:
                    self.stop()
                    return complaints
            time.sleep(POLL_S)
        if self._orphaned and not self._run.has_process_record(GROUND):
            complaints.append(f"ground ended with code {self._orphaned}, and nobody took the mission up again.")
        self._await_exit()
        self.stop()
        return complaints

    def stop(self) -> None:
        """Ask everybody to end, wait for as long as each is given, then end them."""
        for child in self.running.values():
            child.send_signal(signal.SIGINT)
        self._await_exit()
        for child in self.running.values():
            child.kill()
        for child in self.running.values():
            child.wait()
        self.running.clear()
        for stream in self._logs:
            stream.close()

    def _await_exit(self) -> None:
        begin = time.monotonic()
        for name, child in list(self.running.items()):
            try:
                child.wait(max(0.0, begin + self._table[name].grace_s - time.monotonic()))
                del self.running[name]
            except subprocess.TimeoutExpired:
                log.warning("%s is still running", name)

    def _start_again(self, name: str, code: int) -> bool:
        """Whether a process that was killed has a successor, which goes on where it was."""
        if not self._restarts[name]:
            return False
        self._restarts[name] -= 1
        log.warning("%s was killed (signal %d) and is started again", name, -code)
        self.running[name] = self._start(self._table[name])
        return True

    def _start(self, process: Process) -> subprocess.Popen[bytes]:
        environment = dict(os.environ) | self._keep
        if process.threads:
            environment |= dict.fromkeys(THREAD_VARIABLES, str(process.threads))
        stderr: IO[bytes] | None = None
        if process.name != "ground":
            stderr = self._log_path(process.name).open("ab")
            self._logs.append(stderr)
        return subprocess.Popen([sys.executable, "-m", process.module, *process.arguments], env=environment,
                                stdin=subprocess.DEVNULL, stdout=sys.stderr, stderr=stderr, start_new_session=True)

    def _log_path(self, name: str) -> Path:
        return self._run.logs / f"{name}.log"


def fly(table: list[Process], run: RunFolder) -> list[str]:
    """Start the processes and wait for the end of the mission. SIGINT and SIGTERM end all of them."""
    previous = signal.signal(signal.SIGTERM, signal.default_int_handler)
    flight = Flight(table, run, keep={"PYTHONUNBUFFERED": "1"})
    try:
        return flight.wait()
    finally:
        flight.stop()
        signal.signal(signal.SIGTERM, previous)


def free_endpoint() -> str:
    """Where the bus may listen on this machine."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{s.getsockname()[1]}"
