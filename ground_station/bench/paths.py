"""`swarmscan bench paths`: planners side by side, in narrow passages made up at random and around given structures.

Each query starts at a clearance of 1.0 m from everything and its straight line is blocked. Times are processor time
of the thread, field and end checks included, building the field excluded. Lengths are told as multiples of the
shortest way that any of the planners found.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from ground_station.bench.path_worlds import CLEARANCE_M, PASSAGES, Query, in_structure, made_up
from ground_station.bench.sampling import MAX_ITERATIONS, sampled_path
from missions.console import print_result
from missions.errors import UserError
from missions.frames import Array
from planning.paths import MeshField, NoPath, ObstacleField, VoxelField, plan_path
from planning.paths.replan import straightened
from planning.paths.thesis import way_round

OURS, THESIS = "lattice", "thesis"
OMPL = ("RRTConnect", "RRTstar", "InformedRRTstar", "BITstar", "AORRTC", "BFMT", "KPIECE1", "BKPIECE1")
"""PRM and PRMstar are left out: bounded by iterations they did not come back."""
SEED = 1

Knowledge = Literal["mesh", "map"]
Planner = Callable[[Query, ObstacleField], Array]


@dataclass(frozen=True)
class Answer:
    """What one planner made of one query; length_m is inf without a path."""

    world: str
    knowledge: Knowledge
    planner: str
    query: int
    length_m: float
    corners: int
    kept: bool
    """Whether the path keeps the clearance all along."""
    cpu_ms: float


@dataclass(frozen=True)
class Row:
    """One planner in one world."""

    world: str
    knowledge: Knowledge
    planner: str
    queries: int
    found: float
    kept: float
    length: float | None
    """Mean over the queries it answered with the clearance kept, over the shortest of all planners' ways."""
    corners: float | None
    median_ms: float
    p95_ms: float
    worst_ms: float


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    options = _parse(argv)
    planners = {name: planner_of(name, options.iterations) for name in options.planners}
    passages = [] if options.files_only else [made_up(options.queries, options.seed)]
    structures = [in_structure(path, options.queries, options.seed) for path in options.files]
    total = options.queries * (len(PASSAGES) * len(passages) + len(structures))
    for query in made_up(1, options.seed):  # compiled code is loaded when it is first called
        ask(planner_of(OURS, 1), OURS, query, "mesh", 0)
    answers: list[Answer] = []
    shown = track(chain(*passages, *structures), "paths", total, console=Console(stderr=True), disable=options.json)
    for number, query in enumerate(shown):
        for knowledge in options.knowledge:
            answers += [ask(planner, name, query, knowledge, number) for name, planner in planners.items()
                        if knowledge == "mesh" or name != THESIS]
    rows = summed(answers)
    print_result(rows, _table(rows), options.json)
    return 0


def planner_of(name: str, iterations: int) -> Planner:
    """The planner of this name: ours, the thesis's, or one of OMPL's with our shortcuts. Raises UserError."""
    if name == OURS:
        return lambda q, field: plan_path(field, q.ends_enu_m[0], q.ends_enu_m[1], CLEARANCE_M, q.lower_enu_m,
                                          q.upper_enu_m)
    if name == THESIS:
        return lambda q, _: way_round(q.triangles, q.ends_enu_m[0], q.ends_enu_m[1], q.lower_enu_m, q.upper_enu_m, SEED,
                                      CLEARANCE_M)
    if name not in OMPL:
        raise UserError(f"--planners {name}: unknown; choose of {', '.join((OURS, THESIS, *OMPL))}.")

    def sampled(query: Query, field: ObstacleField) -> Array:
        path = sampled_path(field, query.ends_enu_m, CLEARANCE_M, (query.lower_enu_m, query.upper_enu_m), SEED, name,
                            iterations)
        return straightened(field, path, CLEARANCE_M)

    return sampled


def ask(planner: Planner, name: str, query: Query, knowledge: Knowledge, number: int) -> Answer:
    """One planner's answer to one query."""
    field: MeshField | VoxelField = query.mesh if knowledge == "mesh" else query.map
    begin = time.thread_time()
    try:
        path = planner(query, field)
    except NoPath:
        path = np.zeros((0, 3))
    cpu_ms = 1e3 * (time.thread_time() - begin)
    if not len(path):
        return Answer(query.world, knowledge, name, number, np.inf, 0, False, cpu_ms)
    kept = bool(field.segments_clear(path[:-1], path[1:], CLEARANCE_M - 1e-3).all())
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    return Answer(query.world, knowledge, name, number, length, len(path) - 2, kept, cpu_ms)


def summed(answers: list[Answer]) -> list[Row]:
    """A row for every world, knowledge and planner, in the order of the answers."""
    shortest: dict[tuple[str, int], float] = {}
    groups: dict[tuple[str, Knowledge, str], list[Answer]] = {}
    for a in answers:
        groups.setdefault((a.world, a.knowledge, a.planner), []).append(a)
        if a.kept:
            key = (a.knowledge, a.query)
            shortest[key] = min(shortest.get(key, np.inf), a.length_m)
    return [_row(*key, group, shortest) for key, group in groups.items()]


def _row(world: str, knowledge: Knowledge, planner: str, group: list[Answer],
         shortest: dict[tuple[str, int], float]) -> Row:
    ms = np.array([a.cpu_ms for a in group])
    kept = [a for a in group if a.kept]
    ratios = [a.length_m / shortest[knowledge, a.query] for a in kept]
    found = float(np.mean([np.isfinite(a.length_m) for a in group]))
    return Row(world, knowledge, planner, len(group), round(found, 3),
               round(len(kept) / len(group), 3), round(float(np.mean(ratios)), 4) if kept else None,
               round(float(np.mean([a.corners for a in kept])), 2) if kept else None,
               round(float(np.median(ms)), 2), round(float(np.percentile(ms, 95)), 2), round(float(ms.max()), 2))


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="swarmscan bench paths", description=__doc__)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE",
                        help="structures: GLB, OBJ, PLY or STL files in ENU metres")
    parser.add_argument("--planners", nargs="+", default=[OURS, THESIS, *OMPL], metavar="NAME", help="default: all")
    parser.add_argument("--knowledge", nargs="+", choices=["mesh", "map"], default=["mesh", "map"],
                        help="what the planners know: the triangles, their voxels, or one after the other (default)")
    parser.add_argument("--queries", type=int, default=20, help="per world (default %(default)s)")
    parser.add_argument("--iterations", type=int, default=MAX_ITERATIONS,
                        help="of OMPL's planners (default %(default)s)")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--files-only", action="store_true", help="leave out the passages that are made up")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    options = parser.parse_args(argv)
    if options.queries < 1 or options.iterations < 1:
        raise UserError("--queries and --iterations must be at least 1; give a larger number.")
    return options


def _table(rows: Sequence[Row]) -> Table:
    table = Table(title=f"Paths at {CLEARANCE_M:g} m clearance; milliseconds of processor time")
    for heading in ("world", "knows", "planner", "found", "kept", "length", "corners", "median", "p95", "worst"):
        table.add_column(heading, justify="left" if heading in ("world", "knows", "planner") else "right")
    for r in rows:
        length = "–" if r.length is None else f"{r.length:.3f}"
        corners = "–" if r.corners is None else f"{r.corners:.1f}"
        table.add_row(r.world, r.knowledge, r.planner, f"{r.found:.0%}", f"{r.kept:.0%}", length, corners,
                      f"{r.median_ms:.1f}", f"{r.p95_ms:.1f}", f"{r.worst_ms:.1f}")
    return table
