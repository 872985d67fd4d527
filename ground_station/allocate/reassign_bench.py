"""`swarmscan bench reassign`: what happens in flight, reassigned from the flying plan, beside a cold search.

A fleet has flown a third of its tours over the given places (random ones without a file); then one thing happens. The
cold search gets ten times the effort and keeps the next legs, as the reassignment does. The thesis knows two of the
events.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

from ground_station.allocate.fleet_in_flight import EVENTS, PERCENT_PER_M, FleetInFlight, in_flight, random_places
from ground_station.allocate.places import read_places
from missions.console import print_result
from missions.frames import Array
from planning.allocate import thesis_reassign
from planning.allocate.minmax import Effort, solve
from planning.allocate.minmax_tables import Warm
from planning.allocate.problem import Problem, Sorties, appraise, violations
from planning.allocate.reassign import IN_FLIGHT, reassign
from planning.allocate.thesis_reassign import Receiver

COLD = Effort(iterations=10 * (IN_FLIGHT.iterations or 0), chains=IN_FLIGHT.chains)


@dataclass(frozen=True)
class Row:
    """One event. Changes are views that were with another vehicle before, those of a vehicle that is gone left out."""

    event: str
    views: int
    vehicles: int
    seconds: float
    makespan: float
    cold_makespan: float
    cold_seconds: float
    gap_percent: float
    changes: int
    cold_changes: int
    left_over: int
    violations: int
    thesis_makespan: float | None


def main(argv: list[str] | None = None) -> int:
    """Run the benchmark."""
    options = _parser().parse_args(argv)
    fleet = in_flight(_places(options), options.vehicles, COLD, options.seed)
    rows = [measure(event, change(fleet, options.seed), options.seed)
            for event, change in track(EVENTS.items(), "reassigning", console=Console(stderr=True))]
    print_result(rows, _table(rows), options.json)
    return 0


def measure(event: str, fleet: FleetInFlight, seed: int) -> Row:
    """Reassign, search afresh, and let the thesis hand over."""
    problem, begin = fleet.problem, time.perf_counter()
    found = reassign(problem, fleet.flying, seed=seed)
    middle = time.perf_counter()
    next_legs = Warm([[own[0][:1]] for own in fleet.flying], locked=[1] * problem.vehicles)
    cold = solve(problem, COLD, seed, next_legs)
    end, owner = time.perf_counter(), fleet.owner
    changed = sum(owner.get(v, k) != k for k, tour in enumerate(cold.tours) for v in tour)
    best, ours = cold.makespan_s, found.allocation.makespan_s
    return Row(event, problem.views, problem.vehicles, middle - begin, ours, best, end - middle,
               100.0 * (ours / best - 1.0), sum(view in owner for view in found.receiver_of_view), changed,
               len(found.allocation.left_over), len(violations(problem, found.allocation)), _thesis(event, fleet))


def _thesis(event: str, fleet: FleetInFlight) -> float | None:
    """Makespan when what nobody has, or what the low battery does not reach, goes behind the others' tours."""
    if event not in ("low battery", "vehicle lost"):
        return None
    problem, tours = fleet.problem, [list(own[0]) for own in fleet.flying]
    kept = 0
    if event == "low battery":
        while kept < len(tours[0]) and not _over(problem, tours[0][:kept + 1]):
            kept += 1
    pending = tours[0][kept:] if event == "low battery" else sorted(set(range(problem.views)) - fleet.owner.keys())
    low = event == "low battery"
    receivers = [Receiver(k, tours[k], len(tours[k]) // 2, problem.seconds.from_start[k], problem.seconds.to_home[k],
                          float(fleet.percent[k]) / PERCENT_PER_M) for k in range(int(low), problem.vehicles)]
    given = thesis_reassign.reassign(pending, receivers, problem.seconds.between[0])
    plan = [[given.tours.get(k, tours[k][:kept])] for k in range(problem.vehicles)]
    return appraise(problem, plan).makespan_s


def _over(problem: Problem, tour: list[int]) -> bool:
    assert problem.available_percent is not None
    alone: Sorties = [[tour], *([[]] * (problem.vehicles - 1))]
    used = appraise(problem, alone).energy_percent[0][0]
    return bool(used > problem.available_percent[0])


def _places(options: argparse.Namespace) -> Array:
    if options.file is not None:
        return read_places(options.file, options.key).positions_m
    return random_places(options.views, options.seed)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="swarmscan bench reassign", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", nargs="?", type=Path, help="as swarmscan allocate reads; random places without")
    parser.add_argument("--key", help="one array of an .npz file")
    parser.add_argument("--views", type=int, default=400, help="random places (default %(default)s)")
    parser.add_argument("--vehicles", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="all rows as one JSON document")
    return parser


def _table(rows: list[Row]) -> Table:
    table = Table(title=f"{rows[0].views} views left, a third flown")
    for name in ("event", "vehicles", "s", "makespan", "cold", "cold s", "gap", "changed", "cold changed", "left over",
                 "violations", "thesis"):
        table.add_column(name, justify="left" if name == "event" else "right")
    for r in rows:
        table.add_row(r.event, str(r.vehicles), f"{r.seconds:.2f}", f"{r.makespan:.1f}", f"{r.cold_makespan:.1f}",
                      f"{r.cold_seconds:.1f}", f"{r.gap_percent:+.2f}%", str(r.changes), str(r.cold_changes),
                      str(r.left_over), str(r.violations),
                      "–" if r.thesis_makespan is None else f"{r.thesis_makespan:.1f}")
    return table
