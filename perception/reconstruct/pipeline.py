"""From posed pictures to a cloud, in two passes: a depth map per picture, then what the depth maps agree on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from missions.errors import UserError
from missions.frames import Array
from perception.depth.sky import sky_mask
from perception.reconstruct.cloud import Cloud, on_grid, without_islands
from perception.reconstruct.depth_map import depth_map
from perception.reconstruct.fusion import PosedDepth, Support, normals_camera, points_camera, support
from perception.reconstruct.pairs import overlapping, stereo_partners
from perception.reconstruct.pictures import SurveyPicture, grey, read_colour
from perception.reconstruct.stereo import Eye

METHOD = 2
"""Raised whenever depth maps change for the same input, so that stored ones are not taken for new ones."""

SKY_GROWTH_PX = 7
"""The sky mask keeps away from edges, but just there matching spreads the structure into the sky: grow it back."""

Progress = Callable[[str, int, int], None]


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """How to reconstruct. Lengths in metres."""

    depth_width_px: int = 960
    pairs_per_picture: int = 4
    min_confidence: int = 3
    spacing_m: float = 0.03
    distance_m: float = 7.0
    """Usual distance of the surface."""
    near_m: float = 2.0
    far_m: float = 60.0
    check_against: int = 14
    """Depth maps that each depth map is checked against."""
    threads: int = 3


@dataclass(frozen=True)
class Region:
    """The part of space to keep: points between two corners (ENU, metres)."""

    lower_enu_m: Array
    upper_enu_m: Array

    def contains(self, points_enu_m: NDArray[np.float32]) -> NDArray[np.bool_]:
        """(n,) mask of points (n, 3)."""
        return np.asarray(np.all((points_enu_m >= self.lower_enu_m) & (points_enu_m <= self.upper_enu_m), axis=1))


def reconstruct(pictures: list[SurveyPicture], region: Region, settings: Settings, depth_folder: Path,
                progress: Progress = lambda stage, done, total: None) -> Cloud:
    """Dense cloud of what lies in the region, one point per voxel of settings.spacing_m.

    Depth maps are kept as .npy files in depth_folder and taken from there when the same pictures and settings come
    again. `progress` is told the stage ("depth", "fuse"), how many pictures are done, and of how many.
    Raises UserError when there are fewer than three pictures or one cannot be read.
    """
    require_enough(pictures)
    with single_threaded_opencv():
        paths = _depth_maps(pictures, settings, depth_folder, progress)
        cloud = _fuse(pictures, paths, region, settings, progress)
    return without_islands(on_grid(cloud, settings.spacing_m))


def require_enough(pictures: list[SurveyPicture]) -> None:
    """Raises UserError when there are fewer than three."""
    if len(pictures) < 3:
        raise UserError(f"views.csv: {len(pictures)} survey pictures, and a reconstruction needs at least 3; "
                        "raise survey.max_views or look in flight.json why views were not flown.")


@contextmanager
def single_threaded_opencv() -> Iterator[None]:
    """The pool already keeps the cores busy; OpenCV's own threads would only get in each other's way."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def depth_key(pictures: list[SurveyPicture], settings: Settings) -> str:
    """Hash of everything that depth maps depend on."""
    digest = hashlib.sha256(f"{METHOD} {settings.depth_width_px} {settings.pairs_per_picture} {settings.distance_m} "
                            f"{settings.near_m} {settings.far_m}".encode())
    digest.update(picture_key(pictures).encode())
    return digest.hexdigest()[:12]


def picture_key(pictures: list[SurveyPicture]) -> str:
    """Hash of pictures, intrinsics and poses."""
    digest = hashlib.sha256()
    for p in pictures:
        digest.update(f"{p.view_id} {p.path.stat().st_size if p.path.is_file() else 0}".encode())
        digest.update(msgspec.json.encode(p.camera))
        digest.update(np.ascontiguousarray(p.enu_from_camera).tobytes() + np.asarray(p.position_enu_m).tobytes())
    return digest.hexdigest()


def _depth_maps(pictures: list[SurveyPicture], settings: Settings, folder: Path, progress: Progress) -> list[Path]:
    """One .npy file per picture, made in parallel where missing."""
    folder.mkdir(parents=True, exist_ok=True)
    key = depth_key(pictures, settings)
    paths = [folder / f"{key}-{i:04d}.npy" for i in range(len(pictures))]
    partners = stereo_partners(pictures, settings.distance_m, settings.pairs_per_picture)
    with ThreadPoolExecutor(settings.threads) as pool:
        missing = [i for i, path in enumerate(paths) if not path.is_file()]
        eyes = list(pool.map(lambda p: _eye(p, settings), pictures)) if missing else []

        def make(i: int) -> None:
            depth = depth_map(eyes[i], [eyes[j] for j in partners[i]], settings.near_m, settings.far_m)
            _save(paths[i], depth)

        for done, _ in enumerate(pool.map(make, missing), start=len(pictures) - len(missing) + 1):
            progress("depth", done, len(pictures))
    return paths


def _eye(picture: SurveyPicture, settings: Settings) -> Eye:
    colour = read_colour(picture, settings.depth_width_px)
    camera = picture.camera_at(settings.depth_width_px)
    sky = cv2.dilate(sky_mask(colour, camera, picture.pose).astype(np.uint8), np.ones((SKY_GROWTH_PX, SKY_GROWTH_PX)))
    return Eye(grey(colour), sky.astype(bool), camera, picture.enu_from_camera, picture.position_enu_m)


def _save(path: Path, depth: NDArray[np.float32]) -> None:
    """Written beside and renamed, so that an interrupted run leaves no half file."""
    unfinished = path.with_suffix(".part")
    with unfinished.open("wb") as f:
        np.save(f, depth)
    unfinished.replace(path)


def _fuse(pictures: list[SurveyPicture], paths: list[Path], region: Region, settings: Settings,
          progress: Progress) -> Cloud:
    """The confirmed points of all pictures, thinned to the grid picture by picture to bound memory."""
    depths = [PosedDepth(np.load(path, mmap_mode="r"), p.enu_from_camera, p.position_enu_m)
              for path, p in zip(paths, pictures, strict=True)]
    others = overlapping(pictures, settings.distance_m, settings.check_against)

    def confirmed(i: int) -> Cloud:
        found = support(depths[i], [depths[j] for j in others[i]], pictures[i].camera_at(settings.depth_width_px))
        return on_grid(_points(pictures[i], found, region, settings), settings.spacing_m)

    parts = []
    with ThreadPoolExecutor(settings.threads) as pool:
        for done, part in enumerate(pool.map(confirmed, range(len(pictures))), start=1):
            parts.append(part)
            progress("fuse", done, len(pictures))
    return Cloud.concatenate(parts)


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
