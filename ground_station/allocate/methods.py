"""The methods that `swarmscan allocate` and its benchmark know, on one task."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from ground_station.allocate.places import Places
from missions.errors import UserError
from missions.frames import Array
from planning.allocate.cost import LegCost
from planning.allocate.minmax import Effort, solve
from planning.allocate.problem import Problem, Ways, appraise
from planning.allocate.thesis import allocate
from planning.allocate.tours import closed_tour
from planning.allocate.ward import ward_clusters


@dataclass(frozen=True)
class Task:
    """Who has to visit what. Places without a depot; every vehicle from the depot, and back when tours are closed.
    Without a depot every tour is a closed loop."""

    ids: list[int]
    positions_m: Array
    vehicles: int
    depot_m: Array | None = None
    closed: bool = True
    cost: LegCost = field(default_factory=LegCost)
    rounded: bool = False
    """Legs are rounded to whole numbers, as TSPLIB prescribes."""
    speed_m_s: tuple[float, ...] = ()
    """One for all, or one for each; none: costs stand in metres."""
    service_s: float = 0.0


@dataclass(frozen=True)
class Answer:
    """Tours of ids; their lengths by the task's cost; the longest, or with speeds the latest; computing time."""

    method: str
    tours: list[list[int]]
    left_over: list[int]
    lengths: list[float]
    makespan: float
    seconds: float


def task_of(places: Places, vehicles: int, depot: int | None = None, **options: object) -> Task:
    """A task on places; depot: the id of the place where all begin. Raises UserError when there is none."""
    if depot is None:
        return Task(places.ids, places.positions_m, vehicles, **options)  # type: ignore[arg-type]
    if depot not in places.ids:
        raise UserError(f"--depot {depot}: no place has this id; give one of {places.ids[0]} to {places.ids[-1]}.")
    at = places.ids.index(depot)
    ids = places.ids[:at] + places.ids[at + 1:]
    return Task(ids, np.delete(places.positions_m, at, axis=0), vehicles, places.positions_m[at],
                **options)  # type: ignore[arg-type]


def answer(task: Task, method: str, effort: Effort, seed: int = 0) -> Answer:
    """What a method makes of a task. Compiling what is not compiled yet does not count."""
    legs = _problem(task, ())
    problem = _problem(task, task.speed_m_s)
    solve(_problem(Task([1], np.zeros((1, 3)), 1, None if task.depot_m is None else np.zeros(3)), ()), Effort(1, 1))
    began = time.perf_counter()
    tours = {"swarmscan": lambda: solve(problem, effort, seed).tours, "thesis": lambda: _thesis(task, legs),
             "pyvrp": lambda: _pyvrp(legs, effort, seed)}[method]()
    seconds = time.perf_counter() - began
    sorties = [[tour] for tour in tours]
    found = appraise(problem, sorties)
    return Answer(method, [[task.ids[i] for i in tour] for tour in tours], [task.ids[i] for i in found.left_over],
                  [float(x) for x in appraise(legs, sorties).finish_s], found.makespan_s, seconds)


def _problem(task: Task, speeds: tuple[float, ...]) -> Problem:
    speed = np.array(speeds or (1.0,))
    kind = np.arange(task.vehicles) if len(speed) > 1 else np.zeros(task.vehicles, dtype=np.int64)

    def legs(a: Array, b: Array) -> Array:
        length = task.cost.between(a, b)
        return np.floor(length + 0.5) if task.rounded else length
    n, m = len(task.ids), task.vehicles
    between = legs(task.positions_m, task.positions_m) / speed[:, None, None]
    service = np.full(n, task.service_s if speeds else 0.0)
    if task.depot_m is None:
        nothing = np.zeros((m, n))
        return Problem(Ways(between, nothing, nothing, service), kind, free=True)
    out = legs(task.depot_m[None], task.positions_m) / speed[kind, None]
    return Problem(Ways(between, out, out if task.closed else np.zeros((m, n)), service), kind)


def _thesis(task: Task, legs: Problem) -> list[list[int]]:
    """Ward clusters, and networkx tours in them; the thesis knows neither speeds nor times at views."""
    between = legs.seconds.between[0]
    if task.depot_m is not None:
        starts = np.repeat(task.depot_m[None], task.vehicles, axis=0)
        return allocate(task.positions_m, starts, task.cost, between, legs.seconds.from_start)
    clusters = ward_clusters(task.positions_m, task.vehicles)
    tours = [[int(share[i]) for i in closed_tour(between[np.ix_(share, share)])] for share in clusters]
    return tours + [[] for _ in range(task.vehicles - len(tours))]


def _pyvrp(legs: Problem, effort: Effort, seed: int) -> list[list[int]]:
    try:
        from ground_station.allocate.pyvrp_rival import bisect
    except ImportError as e:
        raise UserError("--methods pyvrp: PyVRP is not installed; pip install 'swarmscan[bench]' brings it.") from e
    if legs.free:
        raise UserError("--methods pyvrp: PyVRP needs a depot; leave it out for files without one.")
    return bisect(legs, effort.time_limit_s or 10.0, seed)
