"""`swarmscan fly`: every process of a mission on this machine, then the model, the measurements and the report."""

from __future__ import annotations

import argparse
import json
import logging
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

import msgspec

from missions.errors import UserError
from missions.mission import Mission
from missions.mission_file import find_mission, load_mission, write_mission
from missions.prior_file import load_prior
from missions.run_folder import RunFolder
from missions.scene_names import BUILT_IN, check_scene_name, is_scene_name
from planning.trajectories.power import fit

log = logging.getLogger(__name__)

GRACE_S = 30.0
"""Between asking a process to end and killing it: it may be in a long computation on a busy machine, and what it has
not written then is lost."""
POLL_S = 0.1
STAGES = ("reconstruct", "evaluate", "report")
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Process:
    """One row of the process table. threads limits numeric libraries; 0 leaves them alone."""

    name: str
    module: str
    arguments: tuple[str, ...]
    essential: bool
    threads: int = 0


def process_table(mission: Mission, run: RunFolder, endpoint: str, fleet: str, quiet: bool) -> list[Process]:
    """Everything that runs during the flight, in starting order."""
    common = (str(run.mission), "--run", str(run.root), "--fleet", fleet)
    ground = (*common, "--connect", endpoint, *(("--quiet",) if quiet else ()))
    return [
        Process("bridge", "sim_bridge", (*common, "--listen", endpoint), essential=True),
        *(Process(f"uav{k}", "vehicle", (*common, "--id", str(k), "--connect", endpoint), essential=False, threads=1)
          for k in range(1, mission.fleet.vehicles + 1)),
        Process("ground", "ground_station", ground, essential=True),
    ]


class Flight:
    """The running processes of one mission."""

    def __init__(self, table: list[Process], run: RunFolder, keep: dict[str, str]) -> None:
        self._run = run
        self._table = {p.name: p for p in table}
        self._logs: list[IO[bytes]] = []
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        try:
            for process in table:
                self.running[process.name] = self._start(process, keep)
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
                if code is None:
                    continue
                del self.running[name]
                if code != 0:
                    where = "its messages above" if name == "ground" else str(self._log_path(name))
                    complaints.append(f"{name} ended with code {code}; read {where}.")
                    log.warning(complaints[-1])
                if code != 0 and name in essential:
                    self.stop()
                    return complaints
            time.sleep(POLL_S)
        self._await_exit(GRACE_S)
        self.stop()
        return complaints

    def stop(self) -> None:
        """Ask everybody to end, wait GRACE_S, then end them."""
        for child in self.running.values():
            child.send_signal(signal.SIGINT)
        self._await_exit(GRACE_S)
        for child in self.running.values():
            child.kill()
        for child in self.running.values():
            child.wait()
        self.running.clear()
        for stream in self._logs:
            stream.close()

    def _await_exit(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        for name, child in list(self.running.items()):
            try:
                child.wait(max(0.0, deadline - time.monotonic()))
                del self.running[name]
            except subprocess.TimeoutExpired:
                log.warning("%s is still running", name)

    def _start(self, process: Process, keep: dict[str, str]) -> subprocess.Popen[bytes]:
        environment = dict(os.environ) | keep
        if process.threads:
            environment |= dict.fromkeys(THREAD_VARIABLES, str(process.threads))
        stderr: IO[bytes] | None = None
        if process.name != "ground":
            stderr = self._log_path(process.name).open("wb")
            self._logs.append(stderr)
        return subprocess.Popen([sys.executable, "-m", process.module, *process.arguments], env=environment,
                                stdin=subprocess.DEVNULL, stdout=sys.stderr, stderr=stderr, start_new_session=True)

    def _log_path(self, name: str) -> Path:
        return self._run.logs / f"{name}.log"


def main(argv: list[str] | None = None) -> int:
    """The command: 0 when the mission flew and was measured, 1 when something went wrong, 2 for bad input."""
    options = _parse(argv)
    mission, run = prepare(options)
    if not logging.getLogger().handlers:
        logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(name)s %(message)s")
    log.info("run folder %s", run.root)
    table = process_table(mission, run, f"tcp/127.0.0.1:{_free_port()}", "default", quiet=False)
    complaints = fly(table, run)
    essential_failed = any(c.startswith(("ground ", "bridge ")) for c in complaints)
    if essential_failed:
        log.error("the mission was cut short; what was received is kept in %s", run.root)
        return 1
    stages = STAGES if mission.reconstruct.enabled else STAGES[1:]
    failed = [stage for stage in stages if not run_stage(stage, run, options.keep_depth)]
    _print_result(run, options.json)
    return 1 if failed else 0


def fly(table: list[Process], run: RunFolder) -> list[str]:
    """Start the processes and wait for the end of the mission. SIGINT and SIGTERM end all of them."""
    previous = signal.signal(signal.SIGTERM, signal.default_int_handler)
    flight = Flight(table, run, keep={"PYTHONUNBUFFERED": "1"})
    try:
        return flight.wait()
    finally:
        flight.stop()
        signal.signal(signal.SIGTERM, previous)


def run_stage(stage: str, run: RunFolder, keep_depth: bool) -> bool:
    """Run one stage after the flight in its own process; False when it failed."""
    log.info("%s ...", stage)
    options = ["--keep-depth"] if keep_depth and stage == "reconstruct" else []
    code = subprocess.run([sys.executable, "-m", "ground_station.stages", stage, str(run.root), *options],
                          stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, check=False).returncode
    if code != 0:
        log.error("%s failed with code %d; mend the cause and run 'swarmscan %s %s'", stage, code, stage, run.root)
    return code == 0


def prepare(options: argparse.Namespace) -> tuple[Mission, RunFolder]:
    """The merged mission, written into a fresh run folder; what cannot be flown is refused before anything starts."""
    path = find_mission(options.mission)
    mission = load_mission(path, overrides(options))
    if options.scene and not is_scene_name(options.scene) and not Path(options.scene).exists():
        raise UserError(f"--scene {options.scene}: neither a file or folder, nor one of {', '.join(BUILT_IN)}, nor a "
                        "family's scene such as family:girder_bridge:1; check the name.")
    if not mission.scene.path:
        check_scene_name(mission.scene.name)
    if mission.prior_path:
        load_prior(Path(mission.prior_path))
    fit(mission.airframe)
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    root = Path(options.run) if options.run else Path("runs") / f"{stamp}-{path.stem}"
    if root.exists() and any(root.iterdir()):
        raise UserError(f"--run {root}: the folder is not empty; give a fresh one.")
    root.mkdir(parents=True, exist_ok=True)
    run = RunFolder(root.resolve())
    write_mission(mission, run.mission)
    return mission, run


def overrides(options: argparse.Namespace) -> dict[str, str]:
    """Dotted field names and TOML values that the command line asks for."""
    out: dict[str, str] = {}
    for pair in options.set:
        key, equals, value = pair.partition("=")
        if not equals:
            raise UserError(f"--set {pair}: no '='; write --set section.field=value.")
        out[key.strip()] = value.strip()
    if options.scene:
        named = is_scene_name(options.scene)
        out["scene.path"] = json.dumps("" if named else str(Path(options.scene).resolve()))
        if named:
            out["scene.name"] = json.dumps(options.scene)
    if options.views:
        out |= {"explore.enabled": "false", "survey.enabled": "true", "survey.views": '"file"',
                "survey.views_path": json.dumps(str(Path(options.views).resolve()))}
    if options.vehicles is not None:
        out["fleet.vehicles"] = str(options.vehicles)
    if options.speed is not None:
        out["clock.speed"] = str(options.speed)
    return out


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="swarmscan fly", description=__doc__)
    parser.add_argument("mission", help="a mission file, or the name of one in missions/")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.FIELD=VALUE", help="override a field")
    parser.add_argument("--scene", default="",
                        help="a built-in structure, family:NAME:SEED, or a mesh file or scene folder")
    parser.add_argument("--views", default="", metavar="FILE", help="survey these views (CSV) without exploring")
    parser.add_argument("--run", default="", help="run folder (default runs/<UTC time>-<mission>)")
    parser.add_argument("--vehicles", type=int, help="number of vehicles")
    parser.add_argument("--speed", type=float, help="simulated seconds per wall second; 0 is as fast as possible")
    parser.add_argument("--json", action="store_true", help="print metrics.json on stdout")
    parser.add_argument("--keep-depth", action="store_true", help="keep the depth maps of the reconstruction")
    return parser.parse_args(argv)


def _free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def _print_result(run: RunFolder, as_json: bool) -> None:
    metrics = msgspec.json.decode(run.metrics.read_bytes()) if run.metrics.is_file() else {}
    if as_json:
        sys.stdout.write(json.dumps(metrics, indent=2) + "\n")
        return
    coverage, c2c = metrics.get("coverage", {}), metrics.get("c2c", {}).get("completeness", {})
    fleet = metrics.get("fleet", {})
    lines = [f"collisions {metrics.get('collisions', 'unknown')}",
             f"coverage {coverage.get('final', 'unknown')} of a ceiling of {coverage.get('ceiling', 'unknown')}",
             f"C2C completeness at 0.25 m {c2c.get('0.25', 'unknown')}",
             f"makespan {fleet.get('makespan_s', 'unknown')} s, views flown {fleet.get('views_flown', 'unknown')}, "
             f"reassigned {fleet.get('views_reassigned', 'unknown')}",
             f"report {run.report}" if run.report.is_file() else f"run folder {run.root} (no report was written)"]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    sys.exit(main())
