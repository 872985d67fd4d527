"""`swarmscan bench replan`: what a replan costs on board, cutting the map out and building its clearances included.

Starts and goals lie around the given structures, 4 to 20 m apart, and the straight way between them is blocked. Times
are processor time of the thread.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from missions.console import print_result
from missions.errors import UserError
from missions.frames import Array
from missions.mission import FleetSpec
from missions.prior_file import load_prior
from planning.paths import MeshField, NoPath, VoxelField, voxelised
from vehicle.avoidance import Avoidance
from vehicle.sensor_memory import SensorMemory
from vehicle.teammates import Teammates

VOXEL_M = 0.5
AROUND_M, FENCE_M = 6.0, 21.0
"""How far from the structure replans begin and end, and how far the geofence reaches."""
REACH_M = (4.0, 20.0)
SEED = 1


@dataclass(frozen=True)
class Row:
    """Replans around one structure, by what the vehicle knows of it."""

    structure: str
    knowledge: str
    replans: int
    found: float
    length: float | None
    """Mean over the straight distance."""
    median_ms: float
    p95_ms: float
    worst_ms: float


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    parser = argparse.ArgumentParser(prog="swarmscan bench replan", description=__doc__)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="structures: GLB, OBJ, PLY or STL, metres")
    parser.add_argument("--replans", type=int, default=100, help="per structure (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    options = parser.parse_args(argv)
    if options.replans < 1:
        raise UserError("--replans must be at least 1; give a larger number.")
    rows = [row for path in options.files for row in measured(path, options.replans)]
    print_result(rows, _table(rows), options.json)
    return 0


def measured(path: Path, replans: int) -> list[Row]:
    """A row for a vehicle that knows the voxels of a structure and one that knows its mesh."""
    mesh = load_prior(path)
    lower, upper = _structure(mesh.triangles_center)
    fence = np.append(lower[:2] - FENCE_M, max(lower[2], mesh.bounds[0][2])), upper + FENCE_M
    grid = voxelised(mesh.vertices, mesh.faces, *fence, VOXEL_M)
    exact, voxels = MeshField.from_mesh(mesh.vertices, mesh.faces, grid), VoxelField.from_grid(grid)
    fleet, rows = FleetSpec(), []
    questions = _questions(voxels, fleet.clearance_m, lower, upper, replans)
    for knowledge, prior in (("map", None), ("mesh", exact)):
        memory = SensorMemory(*fence, VOXEL_M, fleet.range_sensor_m, [], prior)
        memory.put_map(grid)
        avoidance = Avoidance(memory, Teammates(1), fleet, fence)
        _replan(avoidance, questions[0])
        rows.append(_row(path.stem, knowledge, [_replan(avoidance, ends) for ends in questions]))
    return rows


def _structure(middles: Array) -> tuple[Array, Array]:
    """The box of nearly all triangles: without the ground around."""
    return np.quantile(middles, 0.02, axis=0), np.quantile(middles, 0.98, axis=0)


def _questions(field: VoxelField, clearance_m: float, lower: Array, upper: Array, count: int) -> list[Array]:
    rng = np.random.default_rng(SEED)
    out: list[Array] = []
    while len(out) < count:
        start, step = rng.uniform(lower - AROUND_M, upper + AROUND_M), rng.normal(size=3)
        ends = np.stack([start, start + step / np.linalg.norm(step) * rng.uniform(*REACH_M)])
        free = bool(np.all(field.clearance_m(ends) >= clearance_m))
        if free and not field.segments_clear(ends[0], ends[1], clearance_m)[0]:
            out.append(ends)
    return out


def _replan(avoidance: Avoidance, ends: Array) -> tuple[float, float]:
    """Milliseconds, and the length over the straight distance; inf where there was no way."""
    begin = time.thread_time()
    try:
        way = avoidance.way(ends[0], ends[1], 0, around_resting=True)
    except NoPath:
        way = np.full((2, 3), np.inf)
    ms = 1e3 * (time.thread_time() - begin)
    if not np.isfinite(way).all():
        return ms, np.inf
    return ms, float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum() / np.linalg.norm(ends[1] - ends[0]))


def _row(structure: str, knowledge: str, answers: list[tuple[float, float]]) -> Row:
    ms, length = np.array(answers).T
    found = np.isfinite(length)
    return Row(structure, knowledge, len(ms), round(float(found.mean()), 3),
               round(float(length[found].mean()), 3) if found.any() else None, round(float(np.median(ms)), 2),
               round(float(np.percentile(ms, 95)), 2), round(float(ms.max()), 2))


def _table(rows: Sequence[Row]) -> Table:
    table = Table(title="Replans on board; milliseconds of processor time")
    for heading in ("structure", "knows", "replans", "found", "length", "median", "p95", "worst"):
        table.add_column(heading, justify="left" if heading in ("structure", "knows") else "right")
    for r in rows:
        length = "–" if r.length is None else f"{r.length:.3f}"
        table.add_row(r.structure, r.knowledge, str(r.replans), f"{r.found:.0%}", length, f"{r.median_ms:.1f}",
                      f"{r.p95_ms:.1f}", f"{r.worst_ms:.1f}")
    return table
