"""A short training walk along a textured wall, drawn exactly: what MACARONS' networks are trained on in the tests."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from missions.camera import Pose
from missions.training_walks import SUFFIX, TrainingWalk
from perception.macarons.field import Field
from perception.macarons.tracks import Track
from tests.depth_scene import CAMERA, wall_picture

MOVES, FRAMES = 4, 4
LOW, HIGH = np.array([-14.0, -1.0, 0.0]), np.array([14.0, 3.0, 12.0])
VOXEL_M = 1.0
PX = (112, 64)


def shots(seed: int) -> list[Pose]:
    """One start, then moves of four along the wall at y = 0, seen from its south."""
    rng = np.random.default_rng(seed)
    keys = [np.array([-12.0 + 4.0 * k, -9.0 + rng.uniform(-1.0, 1.0), 4.0 + rng.uniform(-1.0, 1.0)])
            for k in range(MOVES + 1)]
    yaws = math.pi / 2.0 + rng.uniform(-0.3, 0.3, MOVES + 1)
    out = [_pose(keys[0], yaws[0])]
    for k in range(MOVES):
        for f in np.arange(1, FRAMES + 1) / FRAMES:
            out.append(_pose(keys[k] + f * (keys[k + 1] - keys[k]), yaws[k] + f * (yaws[k + 1] - yaws[k])))
    return out


def _pose(at: np.ndarray, yaw: float) -> Pose:
    x, y, z = (float(v) for v in at)
    return Pose((x, y, z), float(yaw), 0.0)


def wall_walk(folder: Path, seed: int = 0) -> Path:
    """The walk's file. The wall is solid to 12 m above the ground; above it and below the ground is nothing."""
    poses = shots(seed)
    drawn = [wall_picture(pose, 0.0, 12.0) for pose in poses]
    camera = CAMERA.scaled(PX[0] // 2, PX[1] // 2)
    rgb = np.stack([cv2.resize(picture, PX, interpolation=cv2.INTER_AREA) for picture, _ in drawn])
    depth = np.stack([cv2.resize(d.astype(np.float32), (PX[0] // 2, PX[1] // 2), interpolation=cv2.INTER_NEAREST)
                      for _, d in drawn])
    solid = np.zeros((28, 4, 12), dtype=np.bool_)
    solid[:, 1:] = True
    rows = np.array([[*p.position_enu_m, p.yaw_enu_rad, p.elevation_rad] for p in poses])
    keys = np.array([1, *(1 + (n + 1) // FRAMES for n in range(MOVES * FRAMES))])
    walk = TrainingWalk("wall", camera, LOW, HIGH, -1.0, LOW, VOXEL_M, solid, rows, keys, depth.astype(np.float16), rgb)
    path = folder / f"wall_{seed}{SUFFIX}"
    walk.save(path)
    return path


def full_field(track: Track, frames: int) -> Field:
    """The map that the first frames of a walk make, of true depth."""
    field = track.field(1500, 5)
    for frame in range(frames):
        field.add(track.true_look(frame), 0.5)
    return field
