"""A simulated VLP-16 LiDAR along poses that were flown, for `swarmscan bench lidar` (thesis sections 3.5 and 5.1).

Sixteen beams from -15 to +15 degrees, 0.2 degrees of azimuth apart, 100 m, Gaussian range noise of 3 cm (Velodyne
VLP-16 data sheet: 1800 firings per turn at 10 Hz, accuracy +-3 cm). No multiple echoes, no dropouts, no motion within
a turn.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

from missions.camera import Pose
from missions.errors import UserError
from missions.frames import Array
from missions.mission_file import load_mission
from missions.process import run_process
from missions.run_folder import RunFolder
from sim_bridge.scenes.load import load_scene
from sim_bridge.truth import BEFORE_FLIGHT_NS, Truth

BEAMS, FIRINGS = 16, 1800
HALF_FOV_DEG, REACH_M, NOISE_M = 15.0, 100.0, 0.03


def beam_directions() -> Array:
    """(28800, 3) unit vectors in the sensor's axes: x ahead, z the axis of rotation."""
    elevation, azimuth = np.meshgrid(np.radians(np.linspace(-HALF_FOV_DEG, HALF_FOV_DEG, BEAMS)),
                                     2.0 * math.pi * np.arange(FIRINGS) / FIRINGS, indexing="ij")
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)


def enu_from_sensor(pose: Pose, tilted: bool) -> Array:
    """(3, 3) of a sensor that is fixed to the camera and tilts with it, or that stands upright."""
    level = Pose(pose.position_enu_m, pose.yaw_enu_rad, pose.elevation_rad if tilted else 0.0)
    right, down, ahead = level.enu_from_camera.T
    return np.stack([ahead, -right, -down], axis=1)


def scan(truth: Truth, pose: Pose, tilted: bool, rng: np.random.Generator) -> Array:
    """(n, 3) points of one turn, ENU metres."""
    directions = beam_directions() @ enu_from_sensor(pose, tilted).T
    origin = np.array(pose.position_enu_m)
    ranges = truth.cast(np.broadcast_to(origin, directions.shape), directions, REACH_M, BEFORE_FLIGHT_NS)
    hit = np.isfinite(ranges)
    noisy = ranges[hit] + NOISE_M * rng.normal(size=int(hit.sum()))
    points: Array = origin + noisy[:, None] * directions[hit]
    return points


def write_scans(run: RunFolder, poses: list[Pose], tilted: bool, out: Path) -> None:
    """Points of all scans and, for each point, the row of the pose it was seen from, as npz."""
    mission = load_mission(run.mission)
    truth = Truth(*load_scene(mission.scene, mission.site).mesh())
    rng = np.random.default_rng([mission.seed, 0x11DA])
    scans = [scan(truth, pose, tilted, rng).astype(np.float32) for pose in poses]
    np.savez(out, points=np.concatenate([np.zeros((0, 3), np.float32), *scans]),
             row=np.repeat(np.arange(len(scans), dtype=np.int32), [len(s) for s in scans]))


def main(argv: list[str] | None = None) -> int:
    """`python -m sim_bridge.lidar RUN POSES OUT`: POSES is an npz with position_enu_m (n, 3), yaw_enu_rad and
    elevation_rad (n,)."""
    parser = argparse.ArgumentParser(prog="python -m sim_bridge.lidar", description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("poses", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--mount", choices=("camera", "level"), default="camera")
    options = parser.parse_args(argv)
    return run_process(lambda: _scan(options))


def _scan(options: argparse.Namespace) -> int:
    if not options.run.is_dir():
        raise UserError(f"{options.run}: no such run folder; give the folder that 'swarmscan fly' made.")
    with np.load(options.poses) as stored:
        places, angles = stored["position_enu_m"], zip(stored["yaw_enu_rad"], stored["elevation_rad"], strict=True)
        poses = [Pose((float(p[0]), float(p[1]), float(p[2])), float(yaw), float(elevation))
                 for p, (yaw, elevation) in zip(places, angles, strict=True)]
    write_scans(RunFolder(options.run), poses, options.mount == "camera", options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
