"""`swarmscan bench reassign`: what happens in flight, reassigned from the flying plan, beside a cold search.

A fleet has flown a third of its tours over the given places (random ones without a file); then one thing happens. The
cold search gets ten times the effort and keeps the next legs, as the reassignment does. The thesis knows two of the
events.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from ground_station.allocate.places import read_places
from missions.console import print_result
from missions.frames import Array
from planning.allocate import thesis_reassign
from planning.allocate.minmax import Effort, solve
from planning.allocate.minmax_tables import Warm
from planning.allocate.problem import Problem, Sorties, Ways, appraise, violations
from planning.allocate.reassign import IN_FLIGHT, reassign
from planning.allocate.thesis_reassign import Receiver

SIDE_M = np.array([60.0, 40.0, 25.0])
PERCENT_PER_M = 0.05
COLD = Effort(iterations=10 * (IN_FLIGHT.iterations or 0), chains=IN_FLIGHT.chains)


@dataclass(frozen=True)
class Scene:
    """A fleet in flight: views that are not flown yet, where its vehicles are, their pads, plans and batteries."""

    views: Array
    here: Array
    pads: Array
    flying: Sorties
    percent: Array
    forbidden: NDArray[np.bool_]

    @property
    def problem(self) -> Problem:
        """What is left to do."""
        ways = Ways.of_positions(self.views, self.here, self.pads, service=1.0)
        energy = Ways.of_positions(self.views, self.here, self.pads, (PERCENT_PER_M,))
        return Problem(ways, energy=energy, available_percent=self.percent, forbidden=self.forbidden)

    @property
    def owner(self) -> dict[int, int]:
        """Which vehicle's plan each view is in."""
        return {view: k for k, own in enumerate(self.flying) for sortie in own for view in sortie}


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
    scene = in_flight(_places(options), options.vehicles, options.seed)
    rows = [measure(event, change(scene, np.random.default_rng(options.seed)), options.seed)
            for event, change in track(EVENTS.items(), "reassigning", console=Console(stderr=True))]
    print_result(rows, _table(rows), options.json)
    return 0


def in_flight(places: Array, vehicles: int, seed: int) -> Scene:
    """A third of every tour is flown; views are numbered anew."""
    pads = np.random.default_rng(seed).uniform(0.0, 1.0, (vehicles, 3)) * np.ptp(places, axis=0) * [1.0, 1.0, 0.0]
    pads += places.min(axis=0)
    tours = solve(Problem(Ways.of_positions(places, pads, service=1.0)), COLD, seed).tours
    left = sorted(view for tour in tours for view in tour[len(tour) // 3:])
    number = {view: n for n, view in enumerate(left)}
    here = np.array([places[tour[len(tour) // 3 - 1]] if len(tour) >= 3 else pad
                     for tour, pad in zip(tours, pads, strict=True)])
    flying = [[[number[view] for view in tour[len(tour) // 3:]]] for tour in tours]
    return Scene(places[left], here, pads, flying, np.full(vehicles, 80.0), np.zeros((vehicles, len(left)), np.bool_))


def measure(event: str, scene: Scene, seed: int) -> Row:
    """Reassign, search afresh, and let the thesis hand over."""
    problem, begin = scene.problem, time.perf_counter()
    found = reassign(problem, scene.flying, seed=seed)
    middle = time.perf_counter()
    next_legs = Warm([[own[0][:1]] for own in scene.flying], locked=[1] * problem.vehicles)
    cold = solve(problem, COLD, seed, next_legs)
    end, owner = time.perf_counter(), scene.owner
    changed = sum(owner.get(v, k) != k for k, tour in enumerate(cold.tours) for v in tour)
    best, ours = cold.makespan_s, found.allocation.makespan_s
    return Row(event, problem.views, problem.vehicles, middle - begin, ours, best, end - middle,
               100.0 * (ours / best - 1.0), sum(view in owner for view in found.receiver_of_view), changed,
               len(found.allocation.left_over), len(violations(problem, found.allocation)), _thesis(event, scene))


def _lost(scene: Scene, rng: np.random.Generator) -> Scene:
    return replace(scene, here=scene.here[:-1], pads=scene.pads[:-1], flying=scene.flying[:-1],
                   percent=scene.percent[:-1], forbidden=scene.forbidden[:-1])


def _joined(scene: Scene, rng: np.random.Generator) -> Scene:
    pad = scene.pads.mean(axis=0, keepdims=True)
    return replace(scene, here=np.vstack([scene.here, pad]), pads=np.vstack([scene.pads, pad]),
                   flying=[*scene.flying, [[]]], percent=np.append(scene.percent, 80.0),
                   forbidden=np.vstack([scene.forbidden, np.zeros((1, len(scene.views)), np.bool_)]))


def _new_views(scene: Scene, rng: np.random.Generator) -> Scene:
    new = rng.uniform(scene.views.min(axis=0), scene.views.max(axis=0), (max(1, len(scene.views) // 20), 3))
    return replace(scene, views=np.vstack([scene.views, new]),
                   forbidden=np.zeros((len(scene.here), len(scene.views) + len(new)), np.bool_))


def _blocked(scene: Scene, rng: np.random.Generator) -> Scene:
    forbidden = scene.forbidden.copy()
    forbidden[0, scene.flying[0][0][2:4]] = True
    return replace(scene, forbidden=forbidden)


def _low(scene: Scene, rng: np.random.Generator) -> Scene:
    """The battery of vehicle 1 lasts for 60 % of what it still has to fly."""
    assert scene.problem.energy is not None
    spent = appraise(scene.problem, scene.flying).energy_percent[0][0]
    return replace(scene, percent=np.concatenate([[0.6 * spent], scene.percent[1:]]))


EVENTS: dict[str, Callable[[Scene, np.random.Generator], Scene]] = {
    "nothing": lambda scene, rng: scene, "low battery": _low, "vehicle lost": _lost, "vehicle joined": _joined,
    "new views": _new_views, "blocked view": _blocked}


def _thesis(event: str, scene: Scene) -> float | None:
    """Makespan when what nobody has, or what the low battery does not reach, goes behind the others' tours."""
    if event not in ("low battery", "vehicle lost"):
        return None
    problem, tours = scene.problem, [list(own[0]) for own in scene.flying]
    kept = 0
    if event == "low battery":
        while kept < len(tours[0]) and not _over(problem, tours[0][:kept + 1]):
            kept += 1
    pending = tours[0][kept:] if event == "low battery" else sorted(set(range(problem.views)) - scene.owner.keys())
    low = event == "low battery"
    receivers = [Receiver(k, tours[k], len(tours[k]) // 2, problem.seconds.from_start[k], problem.seconds.to_home[k],
                          float(scene.percent[k]) / PERCENT_PER_M) for k in range(int(low), problem.vehicles)]
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
    return np.asarray(np.random.default_rng(options.seed).uniform(0.0, 1.0, (options.views, 3)) * SIDE_M)


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
