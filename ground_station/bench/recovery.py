"""`swarmscan bench recovery MISSION`: flies a mission and kills a process of it time and again, at random moments.

Each time `swarmscan resume` takes the mission of a killed ground station up; vehicles and sim_bridge are started again
as `swarmscan fly` does it. Recovered is who takes part in the clock again and has done its first turn. Afterwards what
was flown is held against what may not happen: a view lost or taken twice, a picture twice, a vehicle armed in the air.
"""

from __future__ import annotations

import argparse
import logging
import math
import os
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
import psutil
from msgspec import structs
from rich.console import Console, Group
from rich.table import Table

from ground_station.after_flight import in_charge
from ground_station.bench.mishaps import wrong
from ground_station.mission_setup import add_mission_options, prepare
from ground_station.processes import Flight, free_endpoint, process_table
from missions import topics
from missions.bus import Bus
from missions.clock import BRIDGE, GROUND, SECOND_NS, vehicle_name
from missions.console import print_result
from missions.messages import Status, Tick
from missions.mission import Mission
from missions.run_folder import RunFolder

FLEET = "recovery"
GIVE_UP_S = 60.0
HOMEWARD_S = 1.5
"""On the way home, which is short, kills come so soon after each other at most."""


@dataclass(frozen=True)
class Recovery:
    """One kill. absent_s: simulated time without the process."""

    name: str
    phase: str
    killed_at_s: float
    recovered_after_s: float
    cpu_s: float
    """Processor time that the successor had used by then: what is left on a machine with nothing else to do."""
    absent_s: float


@dataclass
class Watch:
    """What is seen of the mission from outside, and of the process that is to be killed."""

    name: str = GROUND
    tick: Tick | None = None
    together: int = 0
    """Ticks in a row in which it takes part, up to the newest one."""
    absent: int = 0
    """Ticks in which it did not."""
    phase: str = "start"
    over: bool = False
    lock: threading.Condition = field(default_factory=threading.Condition)

    def look(self, endpoint: str) -> None:
        """Until it is over; a thread's work."""
        with Bus("watch", FLEET, connect=endpoint) as bus:
            bus.subscribe(topics.TICK)
            bus.subscribe(topics.STATUS)
            while not self.over:
                for delivery in bus.poll(timeout_s=0.2):
                    self._see(delivery.message)

    def recovered(self, absent: int) -> Tick | None:
        """The first tick after one in which the process takes part once more, after it was absent in more ticks
        than so many: it has done a turn. None when the mission ends, or none comes in time."""
        with self.lock:
            self.lock.wait_for(lambda: self.over or (self.absent > absent and self.together > 1), GIVE_UP_S)
            return self.tick if self.absent > absent and self.together > 1 else None

    def reach(self, t_s: float) -> bool:
        """Wait for a simulated time; False when the mission is over first."""
        with self.lock:
            self.lock.wait_for(lambda: self.over or (self.tick is not None and self.tick.t_ns >= t_s * SECOND_NS))
            return not self.over

    def homeward(self, pause_s: float) -> bool:
        """Wait until everybody is on the way home, and so long in simulated time; False when the mission is over
        first."""
        with self.lock:
            self.lock.wait_for(lambda: self.over or self.phase == "return")
            now_s = self.tick.t_ns / SECOND_NS if self.tick is not None else 0.0
        return self.reach(now_s + pause_s)

    def end(self) -> None:
        """The mission is over."""
        with self.lock:
            self.over = True
            self.lock.notify_all()

    def _see(self, message: Tick | Status) -> None:
        with self.lock:
            if isinstance(message, Tick):
                self.tick = message
                there = not message.again if self.name == BRIDGE else self.name in message.participants
                self.together, self.absent = (self.together + 1, self.absent) if there else (0, self.absent + 1)
            else:
                self.phase = message.phase
            self.lock.notify_all()


def main(argv: list[str] | None = None) -> int:
    """The benchmark: 0 when nothing happened that may not."""
    options = _parser().parse_args(argv)
    logging.getLogger("ground_station").setLevel(logging.CRITICAL)
    mission, run = prepare(options)
    moments_s = moments(options.kills - options.homeward, options.over, options.seed)
    moments_s += [math.inf] * options.homeward
    recoveries, complaints = fly_and_kill(mission, run, options.process, moments_s, options.seed,
                                          Console(stderr=True, quiet=options.json))
    wrongs = {"complaints": complaints, **wrong(mission, run)}
    times = [r.recovered_after_s for r in recoveries]
    summary = {"kills": len(times), "median_s": _median(times),
               "worst_s": max(times, default=None), "median_cpu_s": _median([r.cpu_s for r in recoveries]),
               "worst_cpu_s": max((r.cpu_s for r in recoveries), default=None),
               "phases": dict(Counter(r.phase for r in recoveries)), "load": round(os.getloadavg()[0], 1)}
    print_result({"recoveries": recoveries, "summary": summary, "wrong": wrongs, "run": str(run.root)},
                 Group(_table(recoveries), str(summary), str(wrongs)), options.json)
    return 1 if any(wrongs.values()) or len(times) < options.kills else 0


def moments(kills: int, over_s: float, seed: int) -> list[float]:
    """When to kill, simulated seconds: at random, one in each of so many equal parts of the time."""
    rng = np.random.default_rng(seed)
    return [float(t) for t in (np.arange(kills) + rng.random(kills)) * over_s / kills]


def fly_and_kill(mission: Mission, run: RunFolder, process: str, moments_s: list[float], seed: int,
                 console: Console) -> tuple[list[Recovery], list[str]]:
    """Fly it; what became of every kill, and what the launcher complains of. A moment that is inf is one on the way
    home."""
    endpoint, watch = free_endpoint(), Watch()
    mission = structs.replace(mission, fleet=structs.replace(mission.fleet, restarts=len(moments_s)))
    run.endpoint.write_text(endpoint, encoding="ascii")
    complaints: list[str] = []
    recoveries: list[Recovery] = []
    with in_charge(run):
        flight = Flight(process_table(mission, run, endpoint, FLEET, quiet=True), run, keep={})

        def wait() -> None:
            complaints.extend(flight.wait())
            watch.end()

        threads = [threading.Thread(target=wait), threading.Thread(target=watch.look, args=(endpoint,))]
        try:
            for thread in threads:
                thread.start()
            victim = GroundStation(flight, run) if process == GROUND else Restarted(flight, process, mission)
            _kill_again_and_again(victim, watch, recoveries, moments_s, seed, console)
            victim.wait()
        except BaseException:
            flight.stop()
            raise
        finally:
            for thread in threads:
                thread.join()
    return recoveries, complaints


class GroundStation:
    """Killed, and its mission taken up by the command that a person would give."""

    def __init__(self, flight: Flight, run: RunFolder) -> None:
        self._process, self._run = flight.running["ground"], run

    def choose(self, rng: np.random.Generator) -> str:
        """The name on the clock of who is killed next; "" when there is nobody to kill."""
        return GROUND if self._process.poll() is None else ""

    def kill(self) -> None:
        """End the one that was chosen, and see to its successor."""
        with suppress(ProcessLookupError):
            os.kill(self._process.pid, signal.SIGKILL)
        self._process = subprocess.Popen([sys.executable, "-m", "ground_station.resume", str(self._run.root), "--fleet",
                                          FLEET, "--quiet"], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)

    @property
    def pid(self) -> int:
        """Of the newest successor."""
        return self._process.pid

    def wait(self) -> None:
        """Until the last successor is done."""
        self._process.wait()


class Restarted:
    """sim_bridge or any of the vehicles: killed, and started again by the launcher."""

    def __init__(self, flight: Flight, process: str, mission: Mission) -> None:
        self._running = flight.running
        vehicles = [vehicle_name(k) for k in range(1, mission.fleet.vehicles + 1)]
        self._names, self._name = [BRIDGE] if process == BRIDGE else vehicles, ""

    def choose(self, rng: np.random.Generator) -> str:
        """The name on the clock of who is killed next; "" when there is nobody to kill."""
        self._name = self._names[int(rng.integers(len(self._names)))]
        return self._name if self._name in self._running else ""

    def kill(self) -> None:
        """End the one that was chosen."""
        with suppress(ProcessLookupError):
            os.kill(self._running[self._name].pid, signal.SIGKILL)

    @property
    def pid(self) -> int:
        """Of the newest successor."""
        return self._running[self._name].pid

    def wait(self) -> None:
        """The launcher sees to it."""


def _kill_again_and_again(victim: GroundStation | Restarted, watch: Watch, recoveries: list[Recovery],
                          moments_s: list[float], seed: int, console: Console) -> None:
    rng = np.random.default_rng([seed, 1])
    tick = watch.recovered(-1)
    for moment_s in moments_s:
        if tick is None:
            break
        if not (watch.reach(moment_s) if math.isfinite(moment_s) else watch.homeward(HOMEWARD_S * rng.random())):
            break
        watch.name = victim.choose(rng)
        if not watch.name:
            break
        begin, phase, killed, absent = time.monotonic(), watch.phase, watch.tick, watch.absent
        victim.kill()
        assert killed is not None
        tick = watch.recovered(absent)
        if tick is not None:
            recoveries.append(Recovery(watch.name, phase, round(killed.t_ns / SECOND_NS, 2),
                                       round(time.monotonic() - begin, 2), round(_cpu_s(victim.pid), 2),
                                       round((tick.t_ns - killed.t_ns) / SECOND_NS, 2)))
            console.print(f"{len(recoveries)} of {len(moments_s)}: {recoveries[-1]}")


def _cpu_s(pid: int) -> float:
    """Processor time of a process so far."""
    with suppress(psutil.NoSuchProcess):
        times = psutil.Process(pid).cpu_times()
        return float(times.user + times.system)
    return math.nan


def _median(values: list[float]) -> float | None:
    return round(statistics.median(values), 2) if values else None


def _table(recoveries: Sequence[Recovery]) -> Table:
    table = Table("kill", "process", "phase", "at (simulated s)", "recovered after (s)", "of it processor (s)",
                  "absent (simulated s)")
    for n, r in enumerate(recoveries, start=1):
        table.add_row(str(n), r.name, r.phase, *(f"{x:.2f}" for x in (r.killed_at_s, r.recovered_after_s, r.cpu_s,
                                                                  r.absent_s)))
    return table


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="swarmscan bench recovery", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    add_mission_options(parser)
    parser.add_argument("--process", choices=(GROUND, BRIDGE, "vehicle"), default=GROUND,
                        help="whom to kill; of the vehicles any (default %(default)s)")
    parser.add_argument("--kills", type=int, default=20, help="(default %(default)s)")
    parser.add_argument("--homeward", type=int, default=0, metavar="N",
                        help="of the kills so many come when everybody is on the way home (default %(default)s)")
    parser.add_argument("--over", type=float, default=80.0, metavar="S",
                        help="simulated seconds that the other kills are spread over (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the moments (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")
    return parser
