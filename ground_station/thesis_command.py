"""`swarmscan thesis VIEWS`: the thesis's planning experiment with both costs, without flying.

VIEWS is a run folder, whose pads and structure count, or a file of views (as for `swarmscan allocate`), where tours
begin at the first view of their cluster and legs are straight.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from ground_station.allocate.places import read_places
from ground_station.report.run_data import read_run
from ground_station.report.thesis_page import comparison_rows
from ground_station.report.thesis_run import Setting, ThesisRun, plan_both, plan_run, reported_plan, write_waypoints
from missions.console import print_result
from missions.errors import UserError
from missions.run_folder import RunFolder
from planning.allocate.thesis_experiment import Discharge, Experiment


def main(argv: list[str] | None = None) -> int:
    """The command."""
    options = _parser().parse_args(argv)
    path = Path(options.views)
    if path.is_dir():
        data = read_run(RunFolder(path.resolve()))
        found, reported = plan_run(data, options.percent_per_m, options.stop_at), reported_plan(data.mission)
        written = found.plans[data.mission.survey.cost]
    else:
        found, reported = _plan_file(path, options), None
        written = found.plans["distance"]
    if options.npz is not None:
        write_waypoints(written, options.npz)
    head, *rows = comparison_rows(found, reported)
    table = Table(*head)
    for row in rows:
        table.add_row(*row)
    print_result({cost: document(found, plan) for cost, plan in found.plans.items()}, table, options.json)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="swarmscan thesis", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("views", help="a run folder, or a .npz, .csv, .tsp or .plan file")
    rate = parser.add_mutually_exclusive_group()
    rate.add_argument("--percent-per-m", type=float, help="consumption; the mission's when left out")
    rate.add_argument("--stop-at", type=int, metavar="INDEX",
                      help="instead, the consumption at which the vehicle with most points meets the threshold at this "
                           "waypoint with the distance cost")
    parser.add_argument("--npz", type=Path,
                        help="write the waypoints with their ids of origin, by the mission's cost or by distance")
    parser.add_argument("--vehicles", type=int, default=2, help="for a file of views (default %(default)s)")
    parser.add_argument("--key", help="for a .npz file: the array of several")
    parser.add_argument("--skip", type=int, default=0, help="for a file of views: leave out so many first ones")
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    return parser


def _plan_file(path: Path, options: argparse.Namespace) -> ThesisRun:
    if not path.exists():
        raise UserError(f"{path}: no such run folder or file of views; check the path.")
    if options.percent_per_m is None and options.stop_at is None:
        raise UserError(f"{path}: a file of views knows no battery; give --percent-per-m or --stop-at.")
    places = read_places(path, options.key)
    if options.vehicles < 1 or not 0 <= options.skip < len(places.ids):
        raise UserError(f"--vehicles {options.vehicles} --skip {options.skip}: give at least 1 vehicle and leave views "
                        "to plan.")
    positions = places.positions_m[options.skip:]
    setting = Setting(positions, options.vehicles, Discharge(options.percent_per_m or 0.0))
    return ThesisRun(positions, plan_both(setting, options.stop_at), np.zeros((0, 3)))


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
