"""`swarmscan allocate VIEWS --vehicles N`: who visits which view in which order, without flying.

With --depot ID every vehicle begins at that place; with --closed it also ends there, otherwise at its last view.
Without --depot nobody has a start: every vehicle's tour is a closed loop through its own views. Costs are straight
lengths, and the makespan is the longest tour; with --speed it is the time, in seconds, at which the last vehicle is
done.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from ground_station.allocate.methods import Answer, Task, answer, task_of
from ground_station.allocate.places import read_places
from missions.console import print_result
from missions.errors import UserError
from planning.allocate.cost import LegCost
from planning.allocate.minmax import Effort

METHODS = ("swarmscan", "thesis")
IDS_SHOWN = 12


def main(argv: list[str] | None = None) -> int:
    """The command."""
    options = _parser().parse_args(argv)
    task = _task(options)
    effort = Effort() if options.time_limit is None else Effort(time_limit_s=options.time_limit)
    found = answer(task, options.method, effort, options.seed)
    print_result(asdict(found) | {"unit": _unit(task)}, _table(task, found), options.json)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="swarmscan allocate", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("views", type=Path, help=".npz, .csv, TSPLIB .tsp or QGroundControl .plan")
    parser.add_argument("--vehicles", type=int, required=True, metavar="N")
    parser.add_argument("--method", choices=METHODS, default="swarmscan",
                        help="swarmscan: the last vehicle is done as early as possible; thesis: Ward clusters and "
                             "networkx tours (default %(default)s)")
    parser.add_argument("--cost", choices=["distance", "distance_elevation"], default="distance",
                        help="3-D length, or alpha * horizontal + beta * vertical length")
    parser.add_argument("--alpha", type=float, default=LegCost.alpha, help="default %(default)s")
    parser.add_argument("--beta", type=float, default=LegCost.beta, help="default %(default)s")
    parser.add_argument("--key", help="array of an .npz file with several")
    parser.add_argument("--depot", type=int, metavar="ID", help="place where all vehicles begin: 1 for TSPLIB files")
    parser.add_argument("--closed", action="store_true", help="tours end at the depot")
    parser.add_argument("--rounded", action="store_true", help="whole lengths, as TSPLIB prescribes; else exact ones")
    parser.add_argument("--speed", type=float, nargs="+", default=[], metavar="M_S",
                        help="one for all, or one for each")
    parser.add_argument("--service", type=float, default=0.0, metavar="S", help="seconds at every view, with --speed")
    parser.add_argument("--time-limit", type=float, metavar="S",
                        help="search so long; without it a fixed effort, which gives the same tours every time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="one JSON document: makespan, tours, lengths, seconds, ...")
    return parser


def _task(options: argparse.Namespace) -> Task:
    if options.vehicles < 1:
        raise UserError(f"--vehicles {options.vehicles}: give 1 or more.")
    if options.closed and options.depot is None:
        raise UserError("--closed: tours end at the depot; name it with --depot.")
    if len(options.speed) not in (0, 1, options.vehicles) or min(options.speed, default=1.0) <= 0.0:
        raise UserError("--speed: give one positive speed, or one for each vehicle.")
    if options.time_limit is not None and not options.time_limit > 0.0:
        raise UserError(f"--time-limit {options.time_limit}: give a positive number of seconds.")
    if options.service < 0.0 or (options.service and not options.speed):
        raise UserError("--service: give seconds of at least 0, together with --speed.")
    places = read_places(options.views, options.key)
    return task_of(places, options.vehicles, options.depot, closed=options.closed or options.depot is None,
                   cost=LegCost(options.cost, options.alpha, options.beta), rounded=options.rounded,
                   speed_m_s=tuple(options.speed), service_s=options.service)


def _unit(task: Task) -> str:
    return "s" if task.speed_m_s else "m"


def _table(task: Task, found: Answer) -> Table:
    title = f"{found.method}: makespan {found.makespan:.2f} {_unit(task)}, computed in {found.seconds:.2f} s"
    table = Table(title=title)
    for name in ("vehicle", "views", "length", "tour"):
        table.add_column(name, justify="left" if name == "tour" else "right")
    for vehicle, (tour, length) in enumerate(zip(found.tours, found.lengths, strict=True), start=1):
        shown = " ".join(map(str, tour[:IDS_SHOWN])) + (" ..." if len(tour) > IDS_SHOWN else "")
        table.add_row(str(vehicle), str(len(tour)), f"{length:.2f}", shown)
    return table
