"""`swarmscan bench trajectories`: what passing corners and views at speed gains, and what the times of legs are worth.

Runs are folders that `swarmscan fly` made: one vehicle flies all survey pictures of each, on the map that the survey
was planned on, in passing and stopping at every view. With --growth random views around a box show how the time to
reckon all legs grows with their number.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from ground_station.legs import CORNER_PASS_M
from ground_station.report.run_data import RunData, read_run
from ground_station.survey_method import shooting_of
from missions.camera import Pose, View
from missions.console import print_result
from missions.errors import UserError
from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid
from missions.run_folder import RunFolder
from planning.allocate.flight_cost import Passing, leg_seconds
from planning.allocate.minmax import Effort, solve
from planning.allocate.problem import Problem, Ways
from planning.paths import VoxelField
from planning.paths.roadmap import Roadmap, build_roadmap
from planning.trajectories import Flight, Limits, State, Via, fly_route, fly_run, run_length

GROWTH = (50, 100, 200, 400, 800)
BOX_M, ROOM_M = (16.0, 10.0, 12.0), (40.0, 34.0, 24.0)
EFFORT = Effort(iterations=20_000)
RUN_VIAS, REPEATS = 20, 30


@dataclass(frozen=True)
class Tour:
    """One tour over all views."""

    name: str
    views: int
    roadmap_s: float
    """Wall time of the ways between all views."""
    legs_s: float
    """Wall time of what flying them takes."""
    predicted_s: float
    passing_s: float
    stopping_s: float
    """The same tour stopping at every view, with the mission's settling."""
    stopping_unsettled_s: float
    error: float
    """Of predicted_s."""
    run_ms: float
    """Wall time of planning RUN_VIAS views of it as one run, the best of some."""


@dataclass(frozen=True)
class Task:
    """Views on a map."""

    name: str
    grid: VoxelGrid
    poses: list[Pose]
    passing: Passing
    limits: Limits
    clearance_m: float
    settle_s: float


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    parser = argparse.ArgumentParser(prog="swarmscan bench trajectories", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="run folders")
    parser.add_argument("--growth", action="store_true", help=f"random views around a box: {GROWTH[0]} to {GROWTH[-1]}")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    options = parser.parse_args(argv)
    if not options.runs and not options.growth:
        raise UserError("bench trajectories: nothing to measure; name run folders or give --growth.")
    tasks: list[Path | int] = [*options.runs, *(GROWTH if options.growth else ())]
    rows = [measured(task_of_run(read_run(RunFolder(task))) if isinstance(task, Path)
                     else task_around_a_box(task, options.seed), options.seed)
            for task in track(tasks, "flying", console=Console(stderr=True))]
    print_result(rows, _table(rows), options.json)
    return 0


def task_of_run(data: RunData) -> Task:
    """The survey pictures of a run on its map. Raises UserError where either is missing."""
    rows = [v for v in data.views if v.phase == "survey"]
    if not rows or not data.run.map.is_file():
        raise UserError(f"{data.run.root}: no survey pictures in views.csv, or map.npz is missing; fly a survey first.")
    grid, poses = data.grid(), [v.pose for v in rows]
    fleet = data.mission.fleet
    free = VoxelField.from_grid(grid).clearance_m(np.array([p.position_enu_m for p in poses])) >= fleet.clearance_m
    poses = [p for p, clear in zip(poses, free, strict=True) if clear]
    shooting = shooting_of(data.mission, [View(n, p) for n, p in enumerate(poses)], grid)
    speed = [shooting.speed_m_s[n] for n in range(len(poses))]
    passing = _passing(poses, speed, data.mission.survey.pass_m)
    return Task(data.run.root.name, grid, poses, passing, Limits.of_fleet(fleet), fleet.clearance_m,
                data.mission.survey.settle_s)


def task_around_a_box(count: int, seed: int) -> Task:
    """Random views 4 to 7 m from a box, looking at its middle."""
    grid = VoxelGrid.unknown(np.zeros(3), np.array(ROOM_M), 0.5)
    grid.state[:] = FREE
    lower = np.array([(ROOM_M[0] - BOX_M[0]) / 2.0, (ROOM_M[1] - BOX_M[1]) / 2.0, 0.0])
    first, last = (lower / 0.5).astype(int), ((lower + BOX_M) / 0.5).astype(int)
    grid.state[first[0]:last[0], first[1]:last[1], first[2]:last[2]] = OCCUPIED
    p = np.random.default_rng(seed).uniform([3.0, 3.0, 3.0], np.array(ROOM_M) - 3.0, (40 * count, 3))
    away = np.linalg.norm(np.maximum(np.maximum(lower - p, p - lower - BOX_M), 0.0), axis=1)
    p = p[(away > 4.0) & (away < 7.0)][:count]
    look = lower + np.array(BOX_M) / 2.0 - p
    yaw, elevation = np.arctan2(look[:, 1], look[:, 0]), np.arctan2(look[:, 2], np.hypot(look[:, 0], look[:, 1]))
    poses = [Pose((x, y, z), a, e) for x, y, z, a, e in np.column_stack([p, yaw, elevation]).tolist()]
    limits = Limits(3.0, 2.0, 6.0, np.pi / 3.0)
    return Task(f"box {count}", grid, poses, _passing(poses, [2.0] * count, 0.25), limits, 1.0, 0.5)


def measured(task: Task, seed: int) -> Tour:
    """One tour, planned, predicted and flown."""
    field = VoxelField.from_grid(task.grid)
    began = time.perf_counter()
    roadmap = build_roadmap(field, np.array([p.position_enu_m for p in task.poses]), task.clearance_m)
    mapped = time.perf_counter()
    seconds = leg_seconds(roadmap, task.passing, task.limits, CORNER_PASS_M)
    reckoned = time.perf_counter()
    order = [0, *_tour(seconds, seed)]
    passing = replace(task.passing, speed_m_s=np.where(np.isin(np.arange(len(seconds)), [order[0], order[-1]]), 0.0,
                                                       task.passing.speed_m_s))
    seconds = leg_seconds(roadmap, passing, task.limits, CORNER_PASS_M)
    predicted = float(sum(seconds[a, b] for a, b in pairwise(order)))

    def clear(polyline: Array) -> bool:
        return bool(field.segments_clear(polyline[:-1], polyline[1:], task.clearance_m).all())

    def flown(stop: bool, settle_s: float) -> Flight:
        vias = _vias(roadmap, passing, order, stop, settle_s)
        return fly_route(*_start(task, order), vias, task.limits, clear)

    quick = flown(False, 0.0).duration_s
    return Tour(task.name, len(order), mapped - began, reckoned - mapped, predicted, quick,
                flown(True, task.settle_s).duration_s, flown(True, 0.0).duration_s, predicted / quick - 1.0,
                _run_ms(task, roadmap, passing, order, clear))


def _tour(seconds: Array, seed: int) -> list[int]:
    """An order of the views after the first, those that cannot be reached left out."""
    n = len(seconds) - 1
    ways = Ways(seconds[None, 1:, 1:], seconds[None, 0, 1:], np.zeros((1, n)), np.zeros(n))
    return [view + 1 for view in solve(Problem(ways), EFFORT, seed).tours[0]]


def _start(task: Task, order: list[int]) -> tuple[State, float, float]:
    pose = task.poses[order[0]]
    return State.at_rest(np.array(pose.position_enu_m)), pose.yaw_enu_rad, pose.elevation_rad


def _vias(roadmap: Roadmap, passing: Passing, order: list[int], stop: bool, settle_s: float) -> list[Via]:
    out: list[Via] = []
    for a, b in pairwise(order):
        look = float(passing.yaw_rad[b]), float(passing.elevation_rad[b])
        corners = roadmap.corners_enu_m[a, b]
        out += [Via(c, *look, stop=False, pass_m=CORNER_PASS_M) for c in corners[np.isfinite(corners[:, 0])]]
        rest = stop or b == order[-1]
        out.append(Via(roadmap.places_enu_m[b], *look, stop=rest, settle_s=settle_s, pass_m=float(passing.pass_m[b]),
                       speed_m_s=float(passing.speed_m_s[b])))
    return out


def _run_ms(task: Task, roadmap: Roadmap, passing: Passing, order: list[int], clear: Callable[[Array], bool]) -> float:
    vias = _vias(roadmap, passing, order, False, 0.0)[:RUN_VIAS]
    vias = vias[:run_length(vias)]
    best = np.inf
    for _ in range(REPEATS):
        began = time.perf_counter()
        fly_run(*_start(task, order), vias, task.limits, clear)
        best = min(best, time.perf_counter() - began)
    return 1e3 * float(best)


def _passing(poses: list[Pose], speed_m_s: Sequence[float], pass_m: float) -> Passing:
    return Passing(np.array([p.yaw_enu_rad for p in poses]), np.array([p.elevation_rad for p in poses]),
                   np.array(speed_m_s), np.full(len(poses), pass_m))


def _table(rows: Sequence[Tour]) -> Table:
    table = Table("views of", title="One tour over all views, passing them and stopping at them",
                  caption=f"run: planning the first {RUN_VIAS} waypoints; error: of the predicted time")
    for heading in ("views", "ways s", "legs s", "passing s", "predicted s", "error", "stopping s", "ratio",
                    "unsettled", "run ms"):
        table.add_column(heading, justify="right")
    for r in rows:
        values: list[Any] = [r.views, f"{r.roadmap_s:.2f}", f"{r.legs_s:.2f}", f"{r.passing_s:.1f}",
                             f"{r.predicted_s:.1f}", f"{r.error:+.1%}", f"{r.stopping_s:.1f}",
                             f"{r.stopping_s / r.passing_s:.2f}", f"{r.stopping_unsettled_s / r.passing_s:.2f}",
                             f"{r.run_ms:.1f}"]
        table.add_row(r.name, *(str(v) for v in values))
    return table
