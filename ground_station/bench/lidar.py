"""`swarmscan bench lidar RUN`: what the exploration's pictures show of the surface, and what a LiDAR would have shown
from the same places (thesis sections 3.5 and 5.1, Figs. 5.2 to 5.4).

Both clouds are compared to the exposed surface, C2C within 0.2 m. The pictures' cloud is that of exploration: depth by
plane sweep, as the mission's map used it. `python -m sim_bridge.lidar` simulates a VLP-16.
"""

from __future__ import annotations

import argparse
import itertools
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial import cKDTree

from ground_station.bench.lidar_page import write_page
from ground_station.report.measure import read_truth
from ground_station.report.run_data import RunData, ViewRow, read_run
from missions.camera import Pose
from missions.console import print_result
from missions.errors import UserError
from missions.frames import Array, yaw_elevation_from_forward
from missions.run_folder import RunFolder
from perception.depth.depth_map import DepthMap
from perception.depth.pictures import PictureDepths

WITHIN_M = 0.2
SAMPLES = 20_000
BESIDE_M = 1.0
"""What lies farther from the surface than this is not looked at."""
THESIS = {"pictures": 0.811, "lidar": 0.8677}
"""Of the thesis's statue, its section 5.1."""

Points = NDArray[np.float32]


@dataclass(frozen=True)
class Row:
    """One sensor over a whole exploration. Shares are 0-1, lengths metres."""

    run: str
    sensor: str
    poses: int
    points: int
    coverage: float
    """Share of the exposed surface with a point within 0.2 m."""
    auc: float
    """Mean of the coverage after each pose."""
    thesis: float | None


@dataclass(frozen=True)
class Sensed:
    """What a sensor saw, pose by pose."""

    name: str
    clouds: list[Points]
    distance_m: Array
    """(n,) from each sample of the true surface to the nearest point; inf beyond a metre."""
    curve: Array
    """(poses,) coverage after each."""

    def row(self, run: Path) -> Row:
        """The numbers."""
        kind = self.name.split()[0]
        return Row(run.name, self.name, len(self.clouds), sum(map(len, self.clouds)), float(self.curve[-1]),
                   float(self.curve.mean()), THESIS.get(kind))


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    options = _parse(argv)
    run = RunFolder(options.run)
    if not run.root.is_dir():
        raise UserError(f"{run.root}: no such run folder; give the folder that 'swarmscan fly' made.")
    data = read_run(run)
    rows = sorted((v for v in data.views if v.phase == "explore"), key=lambda v: (v.t_capture_s, v.view_id))
    if not rows or not run.truth_samples.is_file():
        raise UserError(f"{run.root}: no exploration pictures with a truth beside them; fly with explore.enabled.")
    samples = read_truth(run).samples_enu_m
    samples = samples[np.random.default_rng(0).permutation(len(samples))[:SAMPLES]]
    clouds = {"pictures": list(_picture_clouds(data, rows, options.json))}
    for mount in ("camera", "level"):
        clouds[f"lidar, {'tilting with the camera' if mount == 'camera' else 'upright'}"] = _scans(run, rows, mount)
    found = [sensed(name, parts, samples) for name, parts in clouds.items()]
    if options.page:
        write_page(options.page, data, samples, found)
    results = [s.row(run.root) for s in found]
    print_result(results, _table(results), options.json)
    return 0


def sensed(name: str, clouds: list[Points], samples_enu_m: Array) -> Sensed:
    """Coverage of the samples (n, 3) as one cloud after the other is added."""
    distance = np.full(len(samples_enu_m), np.inf)
    curve = np.zeros(len(clouds))
    lower, upper = samples_enu_m.min(axis=0) - BESIDE_M, samples_enu_m.max(axis=0) + BESIDE_M
    for k, cloud in enumerate(clouds):
        around = cloud[((cloud >= lower) & (cloud <= upper)).all(axis=1)]
        if len(around):
            near, _ = cKDTree(around).query(samples_enu_m, distance_upper_bound=BESIDE_M)
            distance = np.minimum(distance, near)
        curve[k] = np.mean(distance <= WITHIN_M)
    return Sensed(name, clouds, distance, curve)


def points_of(depth: DepthMap, range_m: float) -> Points:
    """(n, 3) ENU metres of the trusted pixels within a range."""
    rays = depth.camera.rays_camera()
    near = depth.valid & (depth.depth_m * np.linalg.norm(rays, axis=-1) <= range_m)
    local = rays[near] * depth.depth_m[near][:, None]
    points: Points = (local @ depth.pose.enu_from_camera.T + np.array(depth.pose.position_enu_m)).astype(np.float32)
    return points


def _picture_clouds(data: RunData, rows: list[ViewRow], quiet: bool) -> Iterator[Points]:
    """In the order of flight, with the depth that is known at its end."""
    camera, online = data.mission.camera.explore_camera(), PictureDepths()
    every = data.mission.explore.frames_per_leg
    for k, row in enumerate(track(rows, "depth", console=Console(stderr=True), disable=quiet), start=1):
        picture = cv2.imread(str(data.run.root / row.path), cv2.IMREAD_COLOR)
        if picture is None:
            raise UserError(f"{data.run.root / row.path}: not a readable picture; remove its row from views.csv.")
        online.add(np.asarray(picture[..., ::-1], np.uint8), camera, _pose(row))
        if k % every == 0:
            online.update()
    online.update()
    for k in range(len(rows)):
        depth = online.depth(k)
        yield np.zeros((0, 3), np.float32) if depth is None else points_of(depth, data.mission.explore.sensing_range_m)


def _scans(run: RunFolder, rows: list[ViewRow], mount: str) -> list[Points]:
    with tempfile.TemporaryDirectory() as scratch:
        poses, out = Path(scratch) / "poses.npz", Path(scratch) / "scans.npz"
        all_ = [_pose(row) for row in rows]
        np.savez(poses, position_enu_m=[p.position_enu_m for p in all_], yaw_enu_rad=[p.yaw_enu_rad for p in all_],
                 elevation_rad=[p.elevation_rad for p in all_])
        command = [sys.executable, "-m", "sim_bridge.lidar", str(run.root), str(poses), str(out), "--mount", mount]
        if subprocess.run(command).returncode:
            raise UserError("the scans could not be simulated; the message above says why.")
        with np.load(out) as stored:
            points, row = stored["points"], stored["row"]
    first = np.searchsorted(row, np.arange(len(rows) + 1))
    return [points[a:b] for a, b in itertools.pairwise(first)]


def _pose(row: ViewRow) -> Pose:
    return Pose((row.east_m, row.north_m, row.up_m), *yaw_elevation_from_forward(row.enu_from_camera[:, 2]))


def _table(rows: Sequence[Row]) -> Table:
    table = Table(title=f"Surface within {WITHIN_M:g} m of a point, from the same places")
    for heading in ("sensor", "poses", "points", "coverage", "AUC", "thesis"):
        table.add_column(heading, justify="left" if heading == "sensor" else "right")
    for r in rows:
        table.add_row(r.sensor, str(r.poses), f"{r.points:,}", f"{r.coverage:.3f}", f"{r.auc:.3f}",
                      "" if r.thesis is None else f"{r.thesis:.3f}")
    return table


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="swarmscan bench lidar", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="the run folder of a mission with exploration, 'swarmscan fly' made it")
    parser.add_argument("--page", type=Path, help="write path, clouds, curves and distances to this HTML page")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    return parser.parse_args(argv)
