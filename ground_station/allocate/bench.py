"""`swarmscan bench allocate`: makespans of the methods side by side, on given files or on random places.

Tours on .tsp files are closed and begin at node 1; on other files they are closed loops without a depot. With --growth
random places in a cube are shared out instead, and the table shows how time grows with their number.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.console import Console, Group
from rich.progress import track
from rich.table import Table

from ground_station.allocate.methods import Answer, Task, answer, task_of
from ground_station.allocate.places import Places, keys_of, read_places
from missions.console import print_result
from missions.errors import UserError
from planning.allocate.minmax import Effort

GROWTH = ((100, 4), (200, 4), (400, 4), (800, 8), (1600, 16), (4000, 32))
"""Places and vehicles."""
SIDE_M = 100.0


@dataclass(frozen=True)
class Row:
    """One method on one task."""

    name: str
    places: int
    vehicles: int
    method: str
    time_limit_s: float | None
    makespan: float
    seconds: float
    gap_percent: float | None
    """Above the best known makespan, where one is given."""


def main(argv: list[str] | None = None) -> int:
    """Run the benchmark."""
    options = _parser().parse_args(argv)
    if not options.files and not options.growth:
        raise UserError("bench allocate: nothing to measure; name files or give --growth.")
    best = _best_known(options.best_known)
    runs = [(name, task, method, limit) for name, task in _tasks(options)
            for limit in options.time_limit or [None] for method in options.methods]
    rows = [_row(name, task, limit, answer(task, method, _effort(limit), options.seed), best)
            for name, task, method, limit in track(runs, "allocating", console=Console(stderr=True))]
    tables = [_table(rows), _summary(rows)] if len(rows) <= options.most_rows else [_summary(rows)]
    print_result(rows, Group(*tables), options.json)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="swarmscan bench allocate", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, help=".tsp, .npz (all arrays, or --key), .csv, .plan")
    parser.add_argument("--vehicles", nargs="+", type=int, default=[2, 4, 8], metavar="M")
    parser.add_argument("--methods", nargs="+", choices=["swarmscan", "thesis", "pyvrp"],
                        default=["thesis", "swarmscan"])
    parser.add_argument("--time-limit", nargs="+", type=float, metavar="S", help="else the default, fixed effort")
    parser.add_argument("--best-known", nargs="+", default=[], metavar="NAME:M=MAKESPAN",
                        help="such as eil51:2=222.73; a .tsp file that has some is measured with those M alone")
    parser.add_argument("--growth", action="store_true", help="random places: 100 to 4000, with 4 to 32 vehicles")
    parser.add_argument("--key", help="one array of an .npz file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--most-rows", type=int, default=100, help="with more, the summary alone (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="all rows as one JSON document")
    return parser


def _tasks(options: argparse.Namespace) -> Iterator[tuple[str, Task]]:
    known = _best_known(options.best_known)
    for path in options.files:
        keys = [options.key] if options.key or path.suffix != ".npz" else keys_of(path)
        for key in keys:
            places, name = read_places(path, key), key or path.stem
            for m in [m for n, m in known if n == name] or options.vehicles:
                yield name, task_of(places, m, places.ids[0] if path.suffix == ".tsp" else None)
    for count, m in GROWTH if options.growth else ():
        rng = np.random.default_rng(options.seed)
        places = Places(list(range(count + 1)), rng.uniform(0.0, SIDE_M, (count + 1, 3)))
        yield f"random {count}", task_of(places, m, depot=0)


def _effort(limit: float | None) -> Effort:
    return Effort() if limit is None else Effort(time_limit_s=limit)


def _row(name: str, task: Task, limit: float | None, found: Answer, best: dict[tuple[str, int], float]) -> Row:
    known = best.get((name, task.vehicles))
    gap = None if known is None else 100.0 * (found.makespan / known - 1.0)
    return Row(name, len(task.ids), task.vehicles, found.method, limit, found.makespan, found.seconds, gap)


def _best_known(given: list[str]) -> dict[tuple[str, int], float]:
    try:
        return {(text.rpartition(":")[0], int(text.rpartition(":")[2].partition("=")[0])):
                float(text.partition("=")[2]) for text in given}
    except ValueError as e:
        raise UserError(f"--best-known: {e}; write NAME:M=MAKESPAN, such as eil51:2=222.73.") from e


def _table(rows: list[Row]) -> Table:
    table = Table(*Row.__dataclass_fields__)
    for row in rows:
        table.add_row(*(_shown(value) for value in asdict(row).values()))
    return table


def _summary(rows: list[Row]) -> Table:
    """Per method, time limit and number of vehicles: mean gap, and makespans against the first method's."""
    first = {(r.name, r.vehicles): r.makespan for r in reversed(rows) if r.method == rows[0].method}
    table = Table("method", "time_limit_s", "vehicles", "tasks", "mean gap %", "worst gap %",
                  f"mean makespan, {rows[0].method} = 100 %", "worst", "mean seconds", "longest")

    def group(row: Row) -> tuple[str, float, int]:
        return row.method, row.time_limit_s or 0.0, row.vehicles
    ordered = sorted(rows, key=group)
    sets = [list(some) for _, some in groupby(ordered, group)]
    sets += [list(some) for _, some in groupby(ordered, lambda row: group(row)[:2])]
    for some in sets:
        shares = [100.0 * row.makespan / first[row.name, row.vehicles] for row in some]
        gaps = [row.gap_percent for row in some if row.gap_percent is not None]
        several = len({row.vehicles for row in some}) > 1
        table.add_row(some[0].method, _shown(some[0].time_limit_s), "all" if several else str(some[0].vehicles),
                      str(len(some)), *_mean_and_most(gaps), *_mean_and_most(shares),
                      *_mean_and_most([row.seconds for row in some]))
    return table


def _mean_and_most(values: Iterable[float]) -> tuple[str, str]:
    found = list(values)
    return (f"{np.mean(found):.3f}", f"{max(found):.3f}") if found else ("", "")


def _shown(value: object) -> str:
    return "" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)
