"""`swarmscan bench reconstruct-growth`: how seconds and memory of reconstruction grow with the number of pictures.

The first 100, 200, ... survey pictures of a run are reconstructed in a process and a folder of their own each. Seconds
of processor hardly depend on what else the machine does; wall times do, so the load is told too. Peak memory is
that of each stage alone.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
from rich.console import Console

from ground_station.report.run_data import RunData, read_run
from missions.console import print_rows
from missions.errors import UserError
from missions.mission_file import write_mission
from missions.run_folder import RunFolder, write_views

NEEDED = ("pictures", "flight.json")
"""Of the run's folder: the pictures, and where the object is."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    parser = argparse.ArgumentParser(prog="swarmscan bench reconstruct-growth", description=__doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="a run folder with survey pictures; it is left as it is")
    parser.add_argument("--pictures", type=int, nargs="+", default=[100, 200, 400, 600], metavar="N")
    parser.add_argument("--depth-width-px", type=int, metavar="PX", help="instead of the mission's")
    parser.add_argument("--memory-gib", type=float, metavar="GIB", help="instead of the mission's")
    parser.add_argument("--work", type=Path, help="folder for what is made on the way (default: the system's)")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    options = parser.parse_args(argv)
    data = read_run(RunFolder(options.run.resolve()))
    counts = _counts(options.pictures, data)
    rows = [row for n in counts for row in _measured(data, n, options)]
    print_rows(rows, options.json)
    return 0


def _counts(asked: list[int], data: RunData) -> list[int]:
    """Numbers of pictures, ascending. Raises UserError when the run has not as many."""
    there = len(data.survey_pictures())
    wrong = [n for n in asked if not 3 <= n <= there]
    if wrong:
        raise UserError(f"--pictures {wrong[0]}: {data.run.root} has {there} survey pictures; give numbers from 3 on.")
    return sorted(set(asked))


def _measured(data: RunData, count: int, options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """A row per stage, and one for the whole."""
    Console(stderr=True).print(f"{count} pictures ...")
    with TemporaryDirectory(dir=options.work) as folder:
        run = _part_of(data, count, Path(folder), options)
        command = [sys.executable, "-m", "ground_station.stages", "reconstruct", str(run.root), "--json"]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=False)
    if done.returncode:
        raise UserError(f"{data.run.root}: {count} pictures gave no model; 'swarmscan reconstruct' on it says why.")
    found = json.loads(done.stdout)
    total = {"cpu_s": sum(s["cpu_s"] for s in found["stages"].values()), "wall_s": found["wall_s"],
             "peak_memory_mib": max(s["peak_memory_mib"] for s in found["stages"].values())}
    for name, stage in {**found["stages"], "all": total}.items():
        yield {"pictures": count, "stage": name, "CPU s": round(stage["cpu_s"], 1),
               "CPU s / picture": round(stage["cpu_s"] / count, 2), "wall s": round(stage["wall_s"], 1),
               "peak MiB": round(stage["peak_memory_mib"]), "points": found["points"] if name == "all" else "",
               "load": round(os.getloadavg()[0], 1) if name == "all" else ""}


def _part_of(data: RunData, count: int, folder: Path, options: argparse.Namespace) -> RunFolder:
    """A run with the first so many survey pictures of another one, linked to."""
    run = RunFolder(folder / "run")
    run.root.mkdir()
    asked = {"depth_width_px": options.depth_width_px, "memory_gib": options.memory_gib}
    spec = msgspec.structs.replace(data.mission.reconstruct, **{name: v for name, v in asked.items() if v is not None})
    write_mission(msgspec.structs.replace(data.mission, reconstruct=spec), run.mission)
    rows = sorted((v for v in data.views if v.phase == "survey"), key=lambda v: v.view_id)[:count]
    write_views(run.views_csv, [list(msgspec.structs.astuple(v)) for v in rows])
    for there in (data.run.root / name for name in NEEDED):
        if there.exists():
            (run.root / there.name).symlink_to(there)
    return run
