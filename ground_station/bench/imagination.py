"""`swarmscan bench imagination`: imagined occupancy of partial maps against what is truly there, on walks that
`swarmscan scenes walks` has written, beside what it becomes by learning from the maps of each walk as they come, and
beside fixed chances, which volumetric gains are reckoned with (Delmerico et al., Autonomous Robots 2018).

Judged are the unknown voxels of the object's box; "rim" are those of them within 1.5 m of known ones, which rays meet
first.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy import ndimage

from missions.console import print_result
from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from missions.scene_names import parse_family
from missions.training_walks import walk_files
from perception.imagination.adapt import AdaptiveImagination
from perception.imagination.imagine import Imagination
from perception.imagination.partial_maps import PartialMaps, load_maps
from perception.imagination.samples import rim
from perception.imagination.scores import Scores

PREDICTORS = ("imagination", "learning in flight", "fixed chances")
REGIONS = ("box", "rim")
INSIDE_PER_M, OUTSIDE_PER_M, BESIDE_SURFACE = 0.12, 0.03, 0.5
"""Fixed chances: per metre that unknown space in the object's box, or outside of it, stops a ray, and that a voxel of
the box beside known surface does."""
EDGE_M = 1e-9

Key = tuple[str, str, str]


@dataclass(frozen=True)
class Row:
    """Scores of one predictor over one group of maps."""

    group: str
    region: str
    predictor: str
    voxels: int
    solid_share: float
    brier: float
    log_loss: float
    calibration_error: float
    reliability: list[tuple[float, float, int]]
    """(mean prediction, true share, voxels) by tenths."""


@dataclass(frozen=True)
class Result:
    """All rows, and how long imagining took."""

    rows: list[Row]
    seconds_per_map: float
    largest_seconds: float
    largest_shape: tuple[int, ...]


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    parser = argparse.ArgumentParser(prog="swarmscan bench imagination", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder with walks")
    parser.add_argument("--weights", type=Path, help="default: those that ship")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    options = parser.parse_args(argv)
    result = judge(options.folder, Imagination.load(options.weights), options.json)
    print_result(result, _table(result), options.json)
    return 0


def judge(folder: Path, imagination: Imagination, quiet: bool = False) -> Result:
    """Scores by family of scenes, by key poses taken and over all, of every predictor."""
    scores: dict[Key, Scores] = {}
    times: list[tuple[int, float, tuple[int, ...]]] = []
    for path in track(walk_files(folder), "imagining", console=Console(stderr=True), disable=quiet):
        maps = load_maps(path)
        family, box, learning = parse_family(maps.scene), maps.box, AdaptiveImagination(imagination)
        for grid, key_poses in zip(maps.grids, maps.key_poses, strict=True):
            start = time.perf_counter()
            imagined = imagination.occupancy(grid, box.lower_enu_m, box.upper_enu_m, box.ground_up_m)
            times.append((grid.state.size, time.perf_counter() - start, grid.state.shape))
            groups = ("all", f"after {key_poses}", family.family if family else maps.scene)
            learnt = learning.occupancy(grid, box.lower_enu_m, box.upper_enu_m, box.ground_up_m)
            for predictor, chance in zip(PREDICTORS, (imagined, learnt, fixed_chances(grid, maps)), strict=True):
                for region, where in zip(REGIONS, _judged(grid, maps), strict=True):
                    for group in groups:
                        kept = scores.setdefault((group, region, predictor), Scores())
                        kept.add(chance[where], maps.solid[where])
    rows = [_row(key, scores[key]) for key in sorted(scores, key=lambda k: _order(k[0]))]
    _, seconds, shape = max(times)
    return Result(rows, sum(t for _, t, _ in times) / len(times), seconds, shape)


def fixed_chances(grid: VoxelGrid, maps: PartialMaps) -> NDArray[np.float32]:
    """(i, j, k) how likely each voxel stops a ray, by where it lies alone."""
    inside, outside = (1.0 - math.exp(-per_m * grid.voxel_m) for per_m in (INSIDE_PER_M, OUTSIDE_PER_M))
    chance = np.full(grid.state.shape, outside, dtype=np.float32)
    first = np.maximum(grid.index(maps.box.lower_enu_m - grid.voxel_m * np.array([1.0, 1.0, 0.0])), 0)
    last = grid.index(maps.box.upper_enu_m + grid.voxel_m - EDGE_M) + 1
    box = tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
    beside = ndimage.binary_dilation(grid.state[box] == OCCUPIED, np.ones((3, 3, 3), dtype=np.bool_))
    chance[box] = np.where(beside, BESIDE_SURFACE, inside)
    chance[grid.state == FREE], chance[grid.state == OCCUPIED] = 0.0, 1.0
    return chance


def _judged(grid: VoxelGrid, maps: PartialMaps) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Masks of the unknown voxels in the object's box above the ground, and of the rim among them."""
    lower, upper = maps.box.lower_enu_m.copy(), maps.box.upper_enu_m
    lower[2] = max(lower[2], maps.box.ground_up_m)
    first, last = np.maximum(grid.index(lower), 0), grid.index(upper) + 1
    box = np.zeros(grid.state.shape, dtype=np.bool_)
    box[tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))] = True
    box &= grid.state == UNKNOWN
    return box, box & rim(grid)


def _order(group: str) -> tuple[int, int, str]:
    stage = group.removeprefix("after ")
    return (2, 0, "") if group == "all" else (1, int(stage), "") if stage.isdigit() else (0, 0, group)


def _row(key: Key, s: Scores) -> Row:
    return Row(*key, int(s.total), s.base_rate, s.brier, s.log_loss, s.calibration_error, s.reliability)


def _table(result: Result) -> Table:
    largest = " x ".join(map(str, result.largest_shape))
    table = Table(title=f"Imagined occupancy: {result.seconds_per_map:.3f} s a map, {result.largest_seconds:.3f} s for "
                        f"{largest}")
    for heading in ("maps", "region", "predictor"):
        table.add_column(heading)
    for heading in ("voxels", "solid", "Brier", "log loss", "calibration error"):
        table.add_column(heading, justify="right")
    for row in result.rows:
        numbers = (row.solid_share, row.brier, row.log_loss, row.calibration_error)
        table.add_row(row.group, row.region, row.predictor, str(row.voxels), *(f"{n:.3f}" for n in numbers))
    return table
