"""Trajectories that were flown, for replay: pictures, predicted depth, and carving's last word on the proxies."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from missions.camera import Camera, Pose
from missions.frames import Array
from perception.macarons.field import Look
from perception.macarons.shots import Shot

DEPTHS_EVERY = 4
"""Every so manieth depth map is kept."""


@dataclass(frozen=True)
class Trajectory:
    """One exploration. Proxies are drawn anew from the seed; solid (m,) is what carving made of them in the end."""

    shots: list[Shot]
    looks: list[Look]
    lower_enu_m: Array
    upper_enu_m: Array
    range_m: float
    seed: int
    solid: NDArray[np.bool_]

    def save(self, path: Path) -> None:
        """Write as safetensors."""
        shot, look = self.shots[0], self.looks[0]
        save_file({
            "rgb": np.stack([s.rgb for s in self.shots]), "sky": np.stack([s.sky for s in self.shots]),
            "shot_poses": _poses(s.pose for s in self.shots), "shot_camera": _camera(shot.camera),
            "depth": np.stack([k.depth_m for k in self.looks]), "valid": np.stack([k.valid for k in self.looks]),
            "look_poses": _poses(k.pose for k in self.looks), "look_camera": _camera(look.camera),
            "box": np.stack([self.lower_enu_m, self.upper_enu_m]), "range_m": np.array([self.range_m]),
            "seed": np.array([self.seed]), "solid": self.solid}, path)

    @classmethod
    def load(cls, path: Path) -> Trajectory:
        """Read what `save` wrote."""
        d = load_file(path)
        camera, seen = _as_camera(d["shot_camera"]), _as_camera(d["look_camera"])
        shots = [Shot(rgb, sky, camera, _as_pose(p)) for rgb, sky, p in zip(d["rgb"], d["sky"], d["shot_poses"],
                                                                           strict=True)]
        looks = [Look(z, v, seen, _as_pose(p)) for z, v, p in zip(d["depth"], d["valid"], d["look_poses"], strict=True)]
        return cls(shots, looks, d["box"][0], d["box"][1], float(d["range_m"][0]), int(d["seed"][0]), d["solid"])


class Memory:
    """The latest trajectories, at most so many."""

    def __init__(self, most: int) -> None:
        self._most = most
        self.trajectories: list[Trajectory] = []

    def add(self, trajectory: Trajectory) -> None:
        """Keep a trajectory; the oldest goes when there are too many."""
        self.trajectories = [*self.trajectories, trajectory][-self._most:]

    def save(self, folder: Path) -> None:
        """Write all of them."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for number, trajectory in enumerate(self.trajectories):
            trajectory.save(folder / f"{number:03d}.safetensors")

    def load(self, folder: Path) -> None:
        """Read what `save` wrote."""
        self.trajectories = [Trajectory.load(path) for path in sorted(folder.glob("*.safetensors"))]


def _poses(poses: object) -> Array:
    return np.array([(*p.position_enu_m, p.yaw_enu_rad, p.elevation_rad) for p in poses])  # type: ignore[attr-defined]


def _as_pose(row: Array) -> Pose:
    x, y, z, yaw, elevation = (float(v) for v in row)
    return Pose((x, y, z), yaw, elevation)


def _camera(c: Camera) -> Array:
    return np.array([c.width_px, c.height_px, c.fx_px, c.fy_px, c.cx_px, c.cy_px])


def _as_camera(row: Array) -> Camera:
    width, height, *lens = (float(v) for v in row)
    return Camera(int(width), int(height), *lens)
