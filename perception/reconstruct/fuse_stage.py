"""The second pass: the points that enough depth maps confirm, picture by picture, then slab by slab of space."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from perception.reconstruct.cloud import Cloud, on_grid, voxels
from perception.reconstruct.depth_stage import largest_px, save_array
from perception.reconstruct.fusion import PosedDepth, Support, normals_camera, points_camera, support
from perception.reconstruct.nearness import Nearness
from perception.reconstruct.onlookers import Onlookers
from perception.reconstruct.pictures import SurveyPicture, read_colour
from perception.reconstruct.resources import GIB, LIBRARIES_GIB, LastUsed, room
from perception.reconstruct.settings import Progress, Region, Settings

METHOD = 4
"""Raised whenever the points change for the same depth maps."""
WORK_BYTES_PER_PX = 200
"""Of a thread that checks a picture; 70 to 120 were measured."""
MERGE_BYTES_PER_POINT = 300
"""What thinning to the grid takes, in memory for each point given to it."""
RECORD = np.dtype([("point", np.float32, 3), ("colour", np.uint8, 3), ("normal", np.float32, 3),
                   ("confidence", np.uint8)])


def fused(pictures: list[SurveyPicture], depth_paths: list[Path], region: Region, settings: Settings,
          progress: Progress) -> Cloud:
    """All confirmed points in the region, thinned to the grid picture by picture, then in all."""
    paths = _parts(pictures, depth_paths, region, settings, progress)
    most = int((settings.memory_gib - LIBRARIES_GIB) * GIB / MERGE_BYTES_PER_POINT)
    nearness = Nearness(region, settings.distance_m)
    for path, picture in zip(paths, pictures, strict=True):
        nearness.add(np.load(path)["point"], picture.position_enu_m)
    parts = [Part.of(path, settings.spacing_m, partial(nearness.near_enough, camera_enu_m=picture.position_enu_m))
             for path, picture in zip(paths, pictures, strict=True)]
    return merged(parts, settings.spacing_m, most, progress)


def _parts(pictures: list[SurveyPicture], depth_paths: list[Path], region: Region, settings: Settings,
           progress: Progress) -> list[Path]:
    """A file of RECORDs per picture, by layers across the first axis; made where missing."""
    key = _key(depth_paths, region, settings)
    paths = [path.with_name(f"{key}-{i:04d}.npy") for i, path in enumerate(depth_paths)]
    missing = [i for i, path in enumerate(paths) if not path.is_file()]
    if not missing:
        return paths
    camera = pictures[0].camera_at(settings.depth_width_px)
    pixels = largest_px(pictures, settings)
    there = room(settings.memory_gib, settings.threads, WORK_BYTES_PER_PX * pixels,
                 4 * pixels * (settings.check_against + 1))
    depths = LastUsed(lambda i: np.load(depth_paths[i]), lambda depth: depth.nbytes, there.kept_bytes)

    def posed(i: int) -> PosedDepth:
        return PosedDepth(depths[i], pictures[i].enu_from_camera, pictures[i].position_enu_m)

    onlookers = Onlookers((posed(i) for i in range(len(pictures))), camera)

    def make(i: int) -> None:
        others = onlookers.of(i, settings.check_against)
        found = support(posed(i), (posed(j) for j in others), camera)
        thin = on_grid(_points(pictures[i], found, region, settings), settings.spacing_m)
        save_array(paths[i], records_of(in_layers(thin, settings.spacing_m)))

    with ThreadPoolExecutor(there.threads) as pool:
        for done, _ in enumerate(pool.map(make, missing), start=len(pictures) - len(missing) + 1):
            progress("fuse", done, len(pictures))
    return paths


def _key(depth_paths: list[Path], region: Region, settings: Settings) -> str:
    """Hash of everything that a picture's points depend on."""
    digest = hashlib.sha256(f"{METHOD} {[path.name for path in depth_paths]} {settings.min_confidence} "
                            f"{settings.spacing_m} {settings.check_against}".encode())
    digest.update(np.concatenate([region.lower_enu_m, region.upper_enu_m]).astype(np.float64).tobytes())
    return f"points-{digest.hexdigest()[:12]}"


def _points(picture: SurveyPicture, found: Support, region: Region, settings: Settings) -> Cloud:
    """World points of the pixels that enough depth maps confirm and hardly any looks through."""
    camera = picture.camera_at(settings.depth_width_px)
    local = points_camera(found.depth, camera)
    keep = (found.agreeing >= settings.min_confidence) & (2 * found.through <= found.agreeing)
    normals = normals_camera(local, found.depth)[keep]
    rotation = picture.enu_from_camera.astype(np.float32)
    points = local[keep] @ rotation.T + picture.position_enu_m.astype(np.float32)
    colours = read_colour(picture, settings.depth_width_px)[keep]
    return Cloud(points, colours, normals @ rotation.T, found.agreeing[keep]).select(region.contains(points))


@dataclass(frozen=True)
class Part:
    """A picture's points on disk, in order of the grid's layers across the first axis."""

    path: Path
    first_layer: int
    starts: NDArray[np.int64]
    """Of each layer from the first one on, and the end of the last one."""
    keep: Callable[[NDArray[np.float32]], NDArray[np.bool_]] | None = None
    """Which points are taken; None: all."""

    @classmethod
    def of(cls, path: Path, spacing_m: float,
           keep: Callable[[NDArray[np.float32]], NDArray[np.bool_]] | None = None) -> Part:
        """Reads the file once; only where layers begin is kept."""
        layers = voxels(np.load(path)["point"][:, 0], spacing_m)
        if not len(layers):
            return cls(path, 0, np.zeros(1, np.int64), keep)
        first, last = int(layers[0]), int(layers[-1])
        return cls(path, first, np.searchsorted(layers, np.arange(first, last + 2)), keep)

    def cut(self, low: int, high: int) -> Cloud:
        """What lies in the layers from low to before high."""
        first, last = (int(self.starts[np.clip(i - self.first_layer, 0, len(self.starts) - 1)]) for i in (low, high))
        records = np.load(self.path, mmap_mode="r")[first:last]
        cloud = Cloud(*(np.array(records[name]) for name in ("point", "colour", "normal", "confidence")))
        return cloud if self.keep is None else cloud.select(self.keep(cloud.points_enu_m))


def merged(parts: list[Part], spacing_m: float, most: int,
           progress: Progress = lambda stage, done, total: None) -> Cloud:
    """One point per voxel of all parts, in slabs across the first axis of at most so many points (or of one layer).

    The slabs' clouds in order are the cloud that thinning everything at once gives, bit by bit.
    """
    bounds = slab_bounds(parts, most)
    slabs = []
    for done, (low, high) in enumerate(pairwise(bounds), start=1):
        slabs.append(on_grid(Cloud.concatenate([part.cut(low, high) for part in parts]), spacing_m))
        progress("merge", done, len(bounds) - 1)
    return Cloud.concatenate(slabs)


def slab_bounds(parts: list[Part], most: int) -> list[int]:
    """Ascending bounds of slabs of whole layers, each with at most so many points, or of one layer alone."""
    seen = [part for part in parts if len(part.starts) > 1]
    if not seen:
        return []
    first = min(part.first_layer for part in seen)
    count = np.zeros(max(part.first_layer + len(part.starts) - 1 for part in seen) - first, np.int64)
    for part in seen:
        begin = part.first_layer - first
        count[begin:begin + len(part.starts) - 1] += np.diff(part.starts)
    before = np.concatenate([[0], np.cumsum(count)])
    bounds = [0]
    while bounds[-1] < len(count):
        full = int(np.searchsorted(before, before[bounds[-1]] + most, side="right")) - 1
        bounds.append(max(bounds[-1] + 1, full))
    return [first + b for b in bounds]


def in_layers(cloud: Cloud, spacing_m: float) -> Cloud:
    """Ordered by layers; rounding may have put a mean across the border of its voxel."""
    return cloud.select(np.argsort(voxels(cloud.points_enu_m[:, 0], spacing_m), kind="stable"))


def records_of(cloud: Cloud) -> NDArray[np.void]:
    """(n,) RECORDs."""
    records = np.empty(len(cloud), RECORD)
    records["point"], records["colour"] = cloud.points_enu_m, cloud.colours
    records["normal"], records["confidence"] = cloud.normals, cloud.confidence
    return records
