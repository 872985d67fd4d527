"""`swarmscan thesis RUN`: the thesis's planning experiment on a run's views, with both costs, without flying it."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from ground_station.report.run_data import read_run
from ground_station.report.thesis_page import comparison_rows
from ground_station.report.thesis_run import ThesisRun, plan_run, reported_plan, write_waypoints
from missions.errors import UserError
from missions.run_folder import RunFolder
from planning.allocate.thesis_experiment import Experiment


def main(argv: list[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="swarmscan thesis", description=__doc__)
    parser.add_argument("run", help="a run folder that 'swarmscan fly' made")
    parser.add_argument("--percent-per-m", type=float, help="consumption; the mission's when left out")
    parser.add_argument("--stop-at", type=int, metavar="INDEX",
                        help="instead, the consumption at which the vehicle with most points meets the threshold at "
                             "this waypoint with the distance cost")
    parser.add_argument("--npz", type=Path, help="write the waypoints with their ids of origin, by the mission's cost")
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    options = parser.parse_args(argv)
    if not Path(options.run).is_dir():
        raise UserError(f"{options.run}: no such run folder; give the folder that 'swarmscan fly' made.")
    data = read_run(RunFolder(Path(options.run).resolve()))
    found = plan_run(data, options.percent_per_m, options.stop_at)
    if options.npz is not None:
        write_waypoints(found.plans[data.mission.survey.cost], options.npz)
    if options.json:
        told = {cost: document(found, plan) for cost, plan in found.plans.items()}
        sys.stdout.write(json.dumps(told, indent=1) + "\n")
        return 0
    head, *rows = comparison_rows(found, reported_plan(data.mission))
    table = Table(*head)
    for row in rows:
        table.add_row(*row)
    Console(width=None if sys.stdout.isatty() else 160).print(table)
    return 0


def document(run: ThesisRun, plan: Experiment) -> dict[str, Any]:
    """One cost's plan as plain numbers."""
    return {
        "percent_per_m": plan.discharge.percent_per_m, "views": len(run.positions_enu_m),
        "left_over": plan.left_over,
        "vehicles": {str(k): {
            "views": int((tour.own.view >= 0).sum()), "points": len(tour.own.view),
            "original_m": tour.original_m, "optimised_m": tour.optimised_m, "stop_index": tour.stop,
            "stop_percent": None if tour.stop is None else float(tour.forecast.level_percent[tour.stop]),
            "end_percent": float(plan.forecast(k).level_percent[-1]) if len(tour.own.view) else None,
            "handed_over": tour.left, "taken_over": [int(v) for v in tour.added.view if v >= 0],
            "refused_legs": {**tour.own.refused, **tour.added.refused},
        } for k, tour in plan.tours.items()},
    }
