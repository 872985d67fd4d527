"""Measured poses made better: features, matches where pictures overlap, bundle adjustment held by the measurement.

A picture that cannot be aligned keeps its measured pose and is named; so are groups that share no points.
"""

from __future__ import annotations

import hashlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from perception.reconstruct.aligned_poses import AlignedPose, Alignment, read_alignment, write_alignment
from perception.reconstruct.bundle import Accuracy, Adjusted, adjust
from perception.reconstruct.features import Features, features
from perception.reconstruct.matching import Matches, match
from perception.reconstruct.pairs import overlapping
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.pipeline import (
    Progress,
    picture_key,
    require_enough,
    single_threaded_opencv,
)

METHOD = 2
"""Raised whenever the poses change for the same input, so that stored ones are not taken for new ones."""
PARTNERS = 20
FEW_MATCHES = 150
"""A picture with fewer is tried with all that overlap it, not with its best partners alone."""
BAND_SIGMAS = 4.5
MIN_BAND_PX = 6.0
MIN_POINTS = 30
"""A picture that sees fewer keeps its measured pose."""
MAX_SIGMAS = 5.0
"""So does one that would be moved or turned farther than this: the measurement is more likely than the matches."""
MIN_SHARED = 10
"""Pictures with as many points in common belong to one group."""


def align(pictures: list[SurveyPicture], accuracy: Accuracy, distance_m: float, folder: Path, threads: int = 3,
          progress: Progress = lambda stage, done, total: None) -> Alignment:
    """The pictures with aligned poses, in the same order; deterministic, whatever the number of threads.

    distance_m: usual distance of the surface. The result is kept in folder (see `aligned_poses`) and taken from there
    when the same pictures and poses come again. `progress` is told "features", "match" and "adjust".
    Raises UserError when there are fewer than three pictures or one cannot be read.
    """
    require_enough(pictures)
    key = _key(pictures, accuracy, distance_m)
    stored = read_alignment(folder, pictures, key)
    if stored is not None:
        return stored
    band_px = max(MIN_BAND_PX, BAND_SIGMAS * accuracy.pixels(pictures[0].camera, distance_m))
    with single_threaded_opencv(), ThreadPoolExecutor(threads) as pool:
        seen = []
        for found in pool.map(features, pictures):
            seen.append(found)
            progress("features", len(seen), len(pictures))
        matches = _matches(pictures, seen, distance_m, band_px, pool, progress)
    progress("adjust", 0, 1)
    adjusted = adjust(pictures, seen, matches, accuracy, 0.5 * band_px)
    write_alignment(folder, key, pictures, _judged(pictures, adjusted, accuracy), adjusted)
    progress("adjust", 1, 1)
    written = read_alignment(folder, pictures, key)
    assert written is not None
    return written


def _key(pictures: list[SurveyPicture], accuracy: Accuracy, distance_m: float) -> str:
    """Hash of everything that the alignment depends on."""
    about = f"{METHOD} {accuracy.position_m} {accuracy.attitude_rad} {distance_m} {picture_key(pictures)}"
    return hashlib.sha256(about.encode()).hexdigest()[:12]


def _matches(pictures: list[SurveyPicture], seen: list[Features], distance_m: float, band_px: float,
             pool: ThreadPoolExecutor, progress: Progress) -> dict[tuple[int, int], Matches]:
    """Matches by pair, of each picture with its best partners, and with more where that gives too few."""
    matches: dict[tuple[int, int], Matches] = {}
    tried: set[tuple[int, int]] = set()
    for count in (PARTNERS, len(pictures)):
        few = np.ones(len(pictures)) if count == PARTNERS else _matched(matches, len(pictures)) < FEW_MATCHES
        near = overlapping(pictures, distance_m, count)
        pairs = sorted({(min(i, j), max(i, j)) for i in np.flatnonzero(few).tolist() for j in near[i]} - tried)
        tried |= set(pairs)

        def one(pair: tuple[int, int]) -> Matches:
            i, j = pair
            return match(pictures[i], pictures[j], seen[i], seen[j], band_px)

        for done, (pair, found) in enumerate(zip(pairs, pool.map(one, pairs), strict=True), start=1):
            if len(found):
                matches[pair] = found
            progress("match", len(tried) - len(pairs) + done, len(tried))
    return matches


def _matched(matches: dict[tuple[int, int], Matches], pictures: int) -> NDArray[np.int64]:
    """(n,) matches of every picture."""
    total = np.zeros(pictures, dtype=np.int64)
    for pair, found in matches.items():
        total[list(pair)] += len(found)
    return total


def _judged(pictures: list[SurveyPicture], found: Adjusted, accuracy: Accuracy) -> list[AlignedPose]:
    """Which poses to believe, with what they were moved by."""
    points = np.bincount(found.picture_of, minlength=len(pictures))
    groups = _groups(found, len(pictures))
    poses = []
    for i, picture in enumerate(pictures):
        moved = float(np.linalg.norm(found.position_enu_m[i] - picture.position_enu_m))
        turned = float(Rotation.from_matrix(found.enu_from_camera[i] @ picture.enu_from_camera.T).magnitude())
        why = _doubt(int(points[i]), moved, turned, accuracy)
        aligned = replace(picture, enu_from_camera=found.enu_from_camera[i], position_enu_m=found.position_enu_m[i])
        poses.append(AlignedPose.of(picture if why else aligned, why or "aligned", int(groups[i]), int(points[i]),
                                    0.0 if why else moved, 0.0 if why else float(np.degrees(turned))))
    return poses


def _doubt(points: int, moved_m: float, turned_rad: float, accuracy: Accuracy) -> str:
    """Why a picture keeps its measured pose; empty when it need not."""
    if points < MIN_POINTS:
        return f"kept: sees {points} points"
    if moved_m > MAX_SIGMAS * accuracy.position_m:
        return f"kept: would move {moved_m:.2f} m"
    if turned_rad > MAX_SIGMAS * accuracy.attitude_rad:
        return f"kept: would turn {np.degrees(turned_rad):.1f} deg"
    return ""


def _groups(found: Adjusted, pictures: int) -> NDArray[np.int64]:
    """(n,) number of each picture's group, the largest first, of those that MIN_SHARED points join."""
    sees = coo_array((np.ones(len(found.point_of), np.int32), (found.picture_of, found.point_of)),
                     shape=(pictures, len(found.points_enu_m) + 1)).tocsr()
    _, label = connected_components((sees @ sees.T) >= MIN_SHARED, directed=False)
    order = np.argsort(-np.bincount(label), kind="stable")
    return np.asarray(np.argsort(order)[label])
