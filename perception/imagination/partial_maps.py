"""What a map looks like on the way: training walks seen through imperfect depth, kept at several stages.

Depth errors are drawn anew for each walk: smooth and per pixel errors in proportion to depth, blobs and silhouettes
without depth, sky that is noticed or not.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from missions.frames import Array
from missions.grid import VoxelGrid
from missions.training_walks import SUFFIX, TrainingWalk
from perception.depth.depth_map import DepthMap
from perception.imagination.window import Box
from perception.mapping.voxel_map import MapSettings, VoxelMap

STAGES = (2, 5, 10, 20, 40, 64)
"""Key poses taken."""
RANGE_M = 25.0
REACH_M = 6.0
"""How far the maps reach beyond the object's box."""
MAPS = ".maps.npz"
JUMP = 0.08
"""Relative step of depth between neighbouring pixels that counts as a silhouette."""


@dataclass(frozen=True)
class Sensor:
    """How bad the depth of one walk is."""

    smooth_error: float
    """Standard deviation over depth of errors that extend over many pixels."""
    pixel_error: float
    missing: float
    """Share of pixels without depth."""
    sky_noticed: float
    """Share of pictures whose sky is told for sky."""
    sigma_per_depth2: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Sensor:
        """A sensor like ours on a good day or on a bad one."""
        return cls(rng.uniform(0.005, 0.03), rng.uniform(0.002, 0.015), rng.uniform(0.03, 0.35), rng.uniform(0.3, 1.0),
                   rng.uniform(0.001, 0.003))

    def seen(self, walk: TrainingWalk, frame: int, rng: np.random.Generator) -> DepthMap:
        """The depth map that it makes of a frame."""
        true = walk.depth_m[frame].astype(np.float32)
        sky = np.isinf(true)
        depth = np.where(sky, 0.0, true)
        errors = self.smooth_error * _smooth(rng, depth.shape) + self.pixel_error * rng.standard_normal(depth.shape)
        valid = ~sky & (_smooth(rng, depth.shape) > _quantile(self.missing)) & ~(_edges(depth) & (rng.random() < 0.8))
        nothing = sky & (rng.random() < self.sky_noticed)
        return DepthMap(walk.camera, walk.pose(frame), (depth * (1.0 + errors)).astype(np.float32), valid,
                        np.ones(depth.shape, np.float32), nothing, self.sigma_per_depth2)


@dataclass(frozen=True)
class PartialMaps:
    """Maps of one walk, and what is truly there."""

    scene: str
    grids: list[VoxelGrid]
    key_poses: list[int]
    solid: NDArray[np.bool_]
    box: Box


def partial_maps(walk: TrainingWalk, rng: np.random.Generator, stages: tuple[int, ...] = STAGES) -> PartialMaps:
    """Integrate the key frames of a walk and every other between; the map around the object each time that a number of
    key poses is reached."""
    first, last = _around_object(walk)
    lower, upper = (walk.origin_enu_m + at * walk.voxel_m for at in (first, last - 0.5))
    voxels = VoxelMap(lower, upper, walk.voxel_m, MapSettings(sensing_range_m=RANGE_M, min_hit_pixels=1))
    sensor, grids, reached = Sensor.drawn(rng), [], []
    ends = {int(np.flatnonzero(walk.key_poses == stage)[0]): stage for stage in stages if stage in walk.key_poses}
    for frame in range(len(walk.poses)):
        if frame in ends or frame % 2 == len(walk.poses) % 2:
            voxels.integrate(sensor.seen(walk, frame, rng))
        if frame in ends:
            grids.append(voxels.grid())
            reached.append(ends[frame])
    solid = walk.solid[tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))]
    box = Box(walk.object_min_enu_m, walk.object_max_enu_m, walk.ground_up_m)
    return PartialMaps(walk.scene, grids, reached, solid, box)


def _around_object(walk: TrainingWalk) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First voxel and last + 1 of the object's box with REACH_M around."""
    ends = (walk.object_min_enu_m - REACH_M, walk.object_max_enu_m + REACH_M)
    first, last = (np.floor((end - walk.origin_enu_m) / walk.voxel_m).astype(np.int64) for end in ends)
    return np.maximum(first, 0), np.minimum(last + 1, walk.solid.shape)


def load_maps(path: Path, seed: int = 1) -> PartialMaps:
    """The maps of a walk in a file, which are made once and kept beside it. Raises UserError."""
    kept = path.with_name(path.name.removesuffix(SUFFIX) + MAPS)
    if not kept.exists():
        rng = np.random.default_rng([seed, zlib.crc32(path.name.encode())])
        _save(kept, partial_maps(TrainingWalk.load(path), rng))
    return _load(kept)


def _save(path: Path, maps: PartialMaps) -> None:
    first = maps.grids[0]
    np.savez_compressed(path, scene=np.array(maps.scene), states=np.stack([g.state for g in maps.grids]),
                        key_poses=np.array(maps.key_poses), origin_enu_m=first.origin_enu_m,
                        voxel_m=np.array(first.voxel_m), solid=maps.solid,
                        box=np.stack([maps.box.lower_enu_m, maps.box.upper_enu_m]),
                        ground_up_m=np.array(maps.box.ground_up_m))


def _load(path: Path) -> PartialMaps:
    with np.load(path, allow_pickle=False) as d:
        origin_enu_m, voxel_m = d["origin_enu_m"], float(d["voxel_m"])
        grids = [VoxelGrid(origin_enu_m, voxel_m, state) for state in d["states"]]
        box = Box(d["box"][0], d["box"][1], float(d["ground_up_m"]))
        return PartialMaps(str(d["scene"]), grids, [int(n) for n in d["key_poses"]], d["solid"], box)


def _smooth(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """(h, w) smooth noise, about standard normal in each pixel."""
    coarse = rng.standard_normal((shape[0] // 8 + 2, shape[1] // 8 + 2))
    fine = ndimage.zoom(coarse, 8, order=1)[: shape[0], : shape[1]]
    result: Array = fine / 0.7
    return result


def _quantile(share: float) -> float:
    """Below this lies about this share of the standard normal distribution (Tukey's lambda, good to 0.02)."""
    return float((share**0.1349 - (1.0 - share) ** 0.1349) / 0.1975)


def _edges(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    far = ndimage.maximum_filter(depth, 3)
    result: NDArray[np.bool_] = far - ndimage.minimum_filter(depth, 3) > JUMP * np.maximum(far, 1e-3)
    return result
