"""`swarmscan bench nbv`: methods that choose views, side by side with oracles that know the truth.

The protocol is that of MACARONS (Guedon et al., CVPR 2023): one grid step of a 5-D lattice per decision. Coverage is
the share of points on the object's exposed surface that the visited key poses truly see within the sensing range. AUC
is its mean over the key poses, final its last value, ceiling what all collision-free views see together; mean and
standard deviation are over the starts.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from missions.console import print_result
from missions.errors import UserError
from missions.mission import CameraSpec
from missions.scene_names import BUILT_IN, PREFIX, check_scene_name
from missions.simulation import RenderSpec
from sim_bridge.nbv.campaign import Campaign, Row, Run, outcomes, short_name
from sim_bridge.nbv.ledger import Ledger
from sim_bridge.nbv.page import grouped, write_page
from sim_bridge.nbv.rules import Rules

METHODS = ("random", "frontier", "volumetric", "macarons", "swarmscan", "greedy_oracle", "beam_oracle")


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code, 1 when a method failed."""
    options = _parse(argv)
    campaign = Campaign(_rules(options), _settings(options.option), options.threads, options.patience)
    runs = [Run(scene, method, start, vehicles) for scene in options.scenes for vehicles in options.vehicles
            for method in options.methods for start in range(options.starts)]
    rows, failed = _fly(runs, campaign, options.jobs, Ledger(options.rows, campaign))
    if options.html:
        write_page(options.html, rows)
    document = {"rules": msgspec.to_builtins(campaign.rules), "options": campaign.options, "rows": rows}
    print_result(document, _table(rows), options.json)
    return 1 if failed else 0


def _fly(runs: list[Run], campaign: Campaign, jobs: int, ledger: Ledger) -> tuple[list[Row], int]:
    """Rows in the order of the runs, and how many runs failed. Each that ends is told, with the time left."""
    console = Console(stderr=True)
    columns = (TextColumn("runs"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    rows = {run: row for run in runs if (row := ledger.row(run)) is not None}
    left = [run for run in runs if run not in rows]
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("runs", total=len(left))
        for run, outcome in outcomes(left, campaign, jobs):
            told = f"{short_name(run.scene)} {run.method} start {run.start} vehicles {run.vehicles}: "
            if isinstance(outcome, Row):
                rows[run] = outcome
                ledger.add(run, outcome)
                told += f"AUC {outcome.auc:.3f}, final {outcome.final:.3f} in {outcome.wall_s:.0f} s"
            else:
                told += str(outcome)
            console.print(told, markup=False, highlight=False, soft_wrap=True)
            progress.advance(task)
    return [rows[run] for run in runs if run in rows], len(runs) - len(rows)


def _table(rows: list[Row]) -> Table:
    table = Table(title="Next best views: mean ± standard deviation over starts")
    for heading in ("scene", "fleet", "method", "runs", "AUC", "final", "ceiling", "hits", "unsafe", "m", "s",
                    "s to 80 %", "s to 90 %", "s/step", "s/round (CPU)", "MiB"):
        table.add_column(heading, justify="left" if heading in ("scene", "method") else "right")
    for (scene, vehicles), methods in grouped(rows).items():
        for method, group in methods.items():
            table.add_row(
                scene, str(vehicles), method, str(len(group)), _spread([r.auc for r in group]),
                _spread([r.final for r in group]), f"{group[0].ceiling:.3f}", str(sum(r.collisions for r in group)),
                str(sum(r.unsafe_views for r in group)), f"{np.mean([r.metres for r in group]):.0f}",
                f"{np.mean([r.seconds for r in group]):.0f}", _reached([r.seconds_to_80 for r in group]),
                _reached([r.seconds_to_90 for r in group]), f"{np.mean([r.seconds_per_decision for r in group]):.3f}",
                _whole_rounds(group),
                f"{max(r.peak_memory_mib for r in group):.0f}")
        table.add_section()
    return table


def _spread(values: list[float]) -> str:
    return f"{np.mean(values):.3f} ± {np.std(values):.3f}"


def _whole_rounds(rows: list[Row]) -> str:
    """Seconds, and processor seconds, of deciding for the whole fleet at once, where it ever arrived together."""
    found = [(r.seconds_per_round[r.vehicles], r.processor_seconds_per_round[r.vehicles]) for r in rows
             if r.vehicles in r.seconds_per_round]
    return "{:.2f} ({:.2f})".format(*np.mean(found, axis=0)) if found else "–"


def _reached(seconds: list[float | None]) -> str:
    """Mean over the runs that got there, and how many did where not all."""
    there = [s for s in seconds if s is not None]
    if not there:
        return "–"
    return f"{np.mean(there):.0f}" + (f" ({len(there)}/{len(seconds)})" if len(there) < len(seconds) else "")


def _rules(options: argparse.Namespace) -> Rules:
    camera = CameraSpec(diagonal_fov_deg=options.diagonal_fov_deg)
    return Rules(poses=options.poses, positions=options.positions, seed=options.seed, camera=camera,
                 render=RenderSpec(backend=options.backend), in_step=options.in_step)


def _settings(given: list[str]) -> dict[str, str]:
    """NAME=VALUE pairs. Raises UserError."""
    pairs = [item.split("=", 1) for item in given]
    for item, pair in zip(given, pairs, strict=True):
        if len(pair) != 2 or not pair[0]:
            raise UserError(f"--option {item}: write it as NAME=VALUE.")
    return {pair[0]: pair[1] for pair in pairs}


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    cores = os.cpu_count() or 1
    parser = argparse.ArgumentParser(prog="swarmscan bench nbv", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=list(BUILT_IN), metavar="SCENE",
                        help="built-in structures, scenes of families (family:NAME:SEED), files; default: built-in")
    parser.add_argument("--methods", nargs="+", default=list(METHODS), metavar="NAME",
                        help=f"default: {' '.join(METHODS)}")
    parser.add_argument("--starts", type=int, default=5, help="starts per scene (default %(default)s)")
    parser.add_argument("--poses", type=int, default=101,
                        help="key poses of all vehicles together, the starts included (default %(default)s)")
    parser.add_argument("--vehicles", type=int, nargs="+", default=[1], metavar="N", help="fleet sizes (default 1)")
    parser.add_argument("--in-step", action="store_true",
                        help="vehicles wait for each other, so that every decision is one for the whole fleet")
    parser.add_argument("--positions", type=int, default=200,
                        help="free lattice positions, about (default %(default)s)")
    parser.add_argument("--diagonal-fov-deg", type=float, default=CameraSpec().diagonal_fov_deg,
                        help="of the camera (default %(default)s; that of MACARONS is 99.4)")
    parser.add_argument("--seed", type=int, default=1, help="of starts, sensor noise and methods (default %(default)s)")
    parser.add_argument("--backend", choices=["auto", "egl", "raycast"], default="auto", help="of the pictures")
    parser.add_argument("--option", action="append", default=[], metavar="NAME=VALUE", help="a setting for the methods")
    parser.add_argument("--jobs", type=int, default=max(1, cores // 2), help="runs at a time (default %(default)s)")
    parser.add_argument("--threads", type=int, default=0, help="per run (default: cores / jobs)")
    parser.add_argument("--patience", type=float, default=600.0, metavar="S",
                        help="wall time that a method may take over a decision, then it is ended (default %(default)s)")
    parser.add_argument("--rows", type=Path, metavar="FILE",
                        help="append every row as it comes; runs that the file has are not repeated")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write the curves as a page")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    options = parser.parse_args(argv)
    for name, least in (("starts", 1), ("poses", 2), ("positions", 2), ("jobs", 1), ("threads", 0), ("seed", 0)):
        if getattr(options, name) < least:
            raise UserError(f"--{name} must be at least {least}; give a larger number.")
    if min(options.vehicles) < 1 or max(options.vehicles) >= options.poses:
        raise UserError("--vehicles must be at least 1 each and fewer than --poses; correct it.")
    if not options.patience > 0.0:
        raise UserError("--patience must be a number of seconds above 0; correct it.")
    if not 10.0 < options.diagonal_fov_deg < 150.0:
        raise UserError("--diagonal-fov-deg must lie between 10 and 150; correct it.")
    for scene in options.scenes:
        if scene.startswith(PREFIX) or not Path(scene).exists():
            _check_scene(scene)
    options.threads = options.threads or max(1, cores // options.jobs)
    return options


def _check_scene(scene: str) -> None:
    if not scene.startswith(PREFIX) and (Path(scene).suffix or len(Path(scene).parts) > 1):
        raise UserError(f"--scenes {scene}: there is no such file; correct the path.")
    check_scene_name(scene)
