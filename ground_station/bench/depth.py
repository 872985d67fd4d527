"""`swarmscan bench depth`: depth of exploration pictures beside true depth, along walks over the view lattice.

`python -m sim_bridge.depth_walks` takes the pictures and writes the truth apart from them; depth is estimated online,
one move after the other, from the pictures alone, before the truth is opened.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from ground_station.bench.depth_causes import causes, places, verdicts
from ground_station.bench.depth_fit import fit
from ground_station.bench.depth_page import Shown, write_page
from ground_station.bench.depth_scores import Pixels, Row, counted, ghosts, judged, summary
from ground_station.bench.depth_walking import online_depths, picture, ray_lengths
from missions.console import print_result
from missions.errors import UserError
from missions.walks import Walks, truth_path, walks_path
from perception.warm_up import warm_up

BUILT_IN = ("bridge", "building", "powerline", "statue")
FIELDS = {"answered": "answered", "abs_rel": "abs rel", "delta_1_25": "δ<1.25", "abs_rel_all": "abs rel, all",
          "delta_1_25_all": "δ<1.25, all", "complete": "found", "complete_thin": "thin found",
          "abs_rel_thin": "thin abs rel", "called_open": "called open", "ghosts": "ghosts",
          "false_water": "false water", "ause": "AUSE", "oracle": "oracle", "calibration": "ECE",
          "cpu_seconds": "CPU s"}


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    options = _parse(argv)
    warm_up()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.data or Path(scratch)
        take_pictures(folder, options)
        if options.fit:
            sys.stdout.write(f"{json.dumps(fit(folder, options.scenes, options.fit))}\n")
            return 0
        results = [evaluate(folder, scene) for scene in track(options.scenes, "depth", console=Console(stderr=True),
                                                              disable=options.json)]
    rows = [row for row, _, _, _ in results]
    pixels = Pixels.joined([p for _, p, _, _ in results])
    if len(rows) > 1:
        pictures = sum(row.pictures for row in rows)
        cpu_seconds = sum(row.cpu_seconds * row.pictures for row in rows) / pictures
        ghost = np.sum([ghost for _, _, ghost, _ in results], axis=0)
        rows.append(summary("all", pictures, pixels, ghost, cpu_seconds))
    if options.page:
        write_page(options.page, rows, pixels, [shown for _, _, _, shown in results])
    print_result(rows, _table(rows), options.json)
    return 0


def evaluate(folder: Path, scene: str) -> tuple[Row, Pixels, NDArray[np.int64], list[Shown]]:
    """Depth of all pictures of a scene's walks against the truth."""
    walks = msgspec.msgpack.decode(walks_path(folder, scene).read_bytes(), type=Walks)
    start = time.process_time()
    depths = [online.depth(i) for online in online_depths(walks) for i in range(len(online))]
    cpu_seconds = (time.process_time() - start) / len(walks.shots)
    with np.load(truth_path(folder, scene)) as truth:
        true, on_object, on_water = truth["depth_m"], truth["on_object"], truth["on_water"]
    rays_m = ray_lengths(walks.camera)
    parts, shown, ghost = [], [], np.zeros(4, np.int64)
    for i, depth in enumerate(depths):
        count = counted(true[i], rays_m, walks.sensing_range_m)
        parts.append(judged(depth, true[i], on_object[i], on_water[i], count))
        if depth is not None:
            ghost += ghosts(depth, true[i], on_water[i], rays_m, walks.sensing_range_m)
            rgb, verdict = picture(walks.jpegs[i]), verdicts(depth, true[i], rays_m, walks.sensing_range_m)
            found = causes(verdict, places(rgb, true[i], on_water[i]), depth, true[i])
            shown.append(Shown(scene, i, rgb, true[i], depth, verdict, found))
    pixels = Pixels.joined(parts)
    return summary(scene, len(depths), pixels, ghost, cpu_seconds), pixels, ghost, shown


def take_pictures(folder: Path, options: argparse.Namespace) -> None:
    """Walk the scenes that the folder does not hold yet. Raises UserError."""
    missing = [s for s in options.scenes if not (walks_path(folder, s).is_file() and truth_path(folder, s).is_file())]
    if not missing:
        return
    numbers = [f"--{name}={getattr(options, name)}" for name in ("walks", "moves", "seed")]
    done = subprocess.run([sys.executable, "-m", "sim_bridge.depth_walks", str(folder), "--scenes", *missing, *numbers])
    if done.returncode:
        raise UserError("the pictures could not be taken; the message above says why.")


def add_walk_arguments(parser: argparse.ArgumentParser, scenes: Sequence[str]) -> None:
    """Which walks, through which scenes."""
    parser.add_argument("--scenes", nargs="+", default=list(scenes), help="built-in structures, family:NAME:SEED, or "
                        "files (default: %(default)s)")
    parser.add_argument("--walks", type=int, default=2, help="walks per scene (default %(default)s)")
    parser.add_argument("--moves", type=int, default=7, help="lattice moves per walk (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the walks and the sensor noise (default %(default)s)")
    parser.add_argument("--data", type=Path, help="folder that keeps pictures and truth for the next run; scenes that "
                        "it already holds are not walked anew")


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="swarmscan bench depth", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    add_walk_arguments(parser, BUILT_IN)
    parser.add_argument("--page", type=Path, help="write the worst pictures and the curves to this HTML page")
    parser.add_argument("--fit", type=Path, metavar="FILE", help="train the confidence on these scenes, write its "
                        "weights to this safetensors file, and score nothing")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    return parser.parse_args(argv)


def _table(rows: Sequence[Row]) -> Table:
    table = Table(title="Depth against true depth within the sensing range")
    table.add_column("scene")
    for heading in FIELDS.values():
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(row.scene, *(f"{getattr(row, name):.3f}" for name in FIELDS))
    return table
