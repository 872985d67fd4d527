"""The first pass: a depth map per picture, in a file each."""

from __future__ import annotations

import hashlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.depth.sky import sky_mask
from perception.reconstruct.depth_map import depth_map
from perception.reconstruct.pairs import stereo_partners
from perception.reconstruct.pictures import SurveyPicture, grey, picture_key, read_colour
from perception.reconstruct.resources import LastUsed, room
from perception.reconstruct.settings import Progress, Settings
from perception.reconstruct.stereo import Eye

METHOD = 3
"""Raised whenever depth maps change for the same input, so that stored ones are not taken for new ones."""

SKY_GROWTH_PX = 7
"""The sky mask keeps away from edges, but just there matching spreads the structure into the sky: grow it back."""

WORK_BYTES_PER_PX = 400
"""Of a thread that matches a picture. Usual pairs take 50 to 120; a very oblique one is rectified to six times the
pixels."""


def depth_maps(pictures: list[SurveyPicture], settings: Settings, folder: Path, progress: Progress) -> list[Path]:
    """One .npy file per picture, made in parallel where missing; pictures are read as they are needed."""
    folder.mkdir(parents=True, exist_ok=True)
    key = depth_key(pictures, settings)
    paths = [folder / f"{key}-{i:04d}.npy" for i in range(len(pictures))]
    missing = [i for i, path in enumerate(paths) if not path.is_file()]
    if not missing:
        return paths
    partners = stereo_partners(pictures, settings.distance_m, settings.pairs_per_picture)
    pixels = largest_px(pictures, settings)
    there = room(settings.memory_gib, settings.threads, WORK_BYTES_PER_PX * pixels,
                 2 * pixels * (settings.pairs_per_picture + 1))
    eyes = LastUsed(lambda i: _eye(pictures[i], settings), lambda eye: eye.grey.nbytes + eye.sky.nbytes,
                    there.kept_bytes)

    def make(i: int) -> None:
        depth = depth_map(eyes[i], [eyes[j] for j in partners[i]], settings.near_m, settings.far_m)
        save_array(paths[i], depth)

    with ThreadPoolExecutor(there.threads) as pool:
        for done, _ in enumerate(pool.map(make, missing), start=len(pictures) - len(missing) + 1):
            progress("depth", done, len(pictures))
    return paths


def depth_key(pictures: list[SurveyPicture], settings: Settings) -> str:
    """Hash of everything that depth maps depend on."""
    digest = hashlib.sha256(f"{METHOD} {settings.depth_width_px} {settings.pairs_per_picture} {settings.distance_m} "
                            f"{settings.near_m} {settings.far_m}".encode())
    digest.update(picture_key(pictures).encode())
    return digest.hexdigest()[:12]


def largest_px(pictures: list[SurveyPicture], settings: Settings) -> int:
    """Pixels of the largest depth map."""
    cameras = [p.camera_at(settings.depth_width_px) for p in pictures]
    return max(c.width_px * c.height_px for c in cameras)


def save_array(path: Path, values: NDArray[np.generic]) -> None:
    """Written beside and renamed, so that an interrupted run leaves no half file."""
    unfinished = path.with_suffix(".part")
    with unfinished.open("wb") as f:
        np.save(f, values)
    unfinished.replace(path)


def _eye(picture: SurveyPicture, settings: Settings) -> Eye:
    colour = read_colour(picture, settings.depth_width_px)
    camera = picture.camera_at(settings.depth_width_px)
    sky = cv2.dilate(sky_mask(colour, camera, picture.pose).astype(np.uint8), np.ones((SKY_GROWTH_PX, SKY_GROWTH_PX)))
    return Eye(grey(colour), sky.astype(bool), camera, picture.enu_from_camera, picture.position_enu_m)
