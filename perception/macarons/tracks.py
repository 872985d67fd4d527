"""Training walks as MACARONS' trajectories: moves of a few pictures each, and the truth where it may be used."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from missions.errors import UserError
from missions.frames import Array
from missions.training_walks import TrainingWalk
from perception.macarons.field import Field, Look
from perception.macarons.shots import DepthBatch, Shot, depth_batch, make_shot


@dataclass(frozen=True)
class Track:
    """A walk with pictures at the depth network's size. Lengths are such that pictures count up to range_m."""

    walk: TrainingWalk
    shots: list[Shot]
    moves: list[list[int]]
    """Numbers of the frames of each move, the key view last; every vehicle's start is a move of one."""
    range_m: float

    @classmethod
    def read(cls, path: Path, size_px: tuple[int, int], range_m: float) -> Track:
        """A walk's file. Raises UserError where it has no pictures."""
        walk = TrainingWalk.load(path)
        if walk.rgb is None:
            raise UserError(f"{path} has no pictures; write it anew with `swarmscan scenes walks --pictures`.")
        h, w = walk.rgb.shape[1:3]
        camera = walk.camera.scaled(w, h)
        shots = [make_shot(rgb, camera, walk.pose(n), size_px) for n, rgb in enumerate(walk.rgb)]
        ends = np.flatnonzero(np.diff(np.concatenate([[0], walk.key_poses])))
        first, moves = 0, []
        for end in ends:
            moves.append(list(range(first, int(end) + 1)))
            first = int(end) + 1
        return cls(walk, shots, moves, range_m)

    def field(self, proxies: int, seed: int) -> Field:
        """An empty field over the object's box above the ground."""
        low = self.walk.object_min_enu_m.copy()
        low[2] = max(low[2], self.walk.ground_up_m + self.walk.voxel_m)
        return Field(low, self.walk.object_max_enu_m, self.range_m, proxies, seed)

    def true_look(self, frame: int) -> Look:
        """The true depth map of a frame."""
        depth = self.walk.depth_m[frame].astype(np.float32)
        return Look(depth, np.ones(depth.shape, dtype=np.bool_), self.walk.camera, self.walk.pose(frame))

    def solid(self, points_enu_m: Array) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3) truly are in solid voxels."""
        index = np.floor((points_enu_m - self.walk.origin_enu_m) / self.walk.voxel_m).astype(np.int64)
        index = np.clip(index, 0, np.array(self.walk.solid.shape) - 1)
        return np.asarray(self.walk.solid[tuple(index.T)])

    @cached_property
    def shown(self) -> list[NDArray[np.int64]]:
        """Per frame the voxels of the object's box, above the ground, that its true depth hits within range."""
        low, high = self.field(1, 0).lower_enu_m, self.walk.object_max_enu_m
        out = []
        for frame in range(len(self.shots)):
            points = self.true_look(frame).points(self.range_m)
            points = points[((points >= low) & (points <= high)).all(axis=1)]
            index = np.floor((points - low) / self.walk.voxel_m).astype(np.int64)
            out.append(np.unique(index[:, 0] + (index[:, 1] << 16) + (index[:, 2] << 32)))
        return out

    def depth_example(self, rng: np.random.Generator) -> tuple[Shot, list[Shot], NDArray[np.float32]]:
        """A random frame, the two of its move before it (the two after it where there are none, as in flight), and its
        true depth (h, w) in ranges."""
        long = [move for move in self.moves if len(move) >= 3]
        move = long[int(rng.integers(len(long)))]
        k = int(rng.integers(len(move)))
        others = (k - 1, k - 2) if k >= 2 else (k + 1, k + 2) if k + 2 < len(move) else (1 - k, 2)
        depth = self.walk.depth_m[move[k]].astype(np.float32) / self.range_m
        return self.shots[move[k]], [self.shots[move[n]] for n in others], depth


def depth_examples(tracks: list[Track], count: int, rng: np.random.Generator) -> tuple[DepthBatch, Tensor]:
    """Random frames of random tracks of one range, and their true depth (b, 1, h, w) in ranges."""
    chosen = [tracks[int(k)].depth_example(rng) for k in rng.integers(len(tracks), size=count)]
    batch = depth_batch([target for target, _, _ in chosen], [sources for _, sources, _ in chosen], tracks[0].range_m)
    return batch, torch.from_numpy(np.stack([depth for _, _, depth in chosen]))[:, None]
