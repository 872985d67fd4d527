"""Measured poses made better: features, matches where pictures overlap, bundle adjustment held by the measurement.

A picture that cannot be aligned keeps its measured pose and is named; so are groups that share no points.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from missions.lens import NONE, Distortion
from perception.reconstruct.aligned_poses import AlignedPose, Alignment, read_alignment, write_alignment
from perception.reconstruct.bundle import Accuracy, Adjusted, adjust, carried_by
from perception.reconstruct.control_points import ControlPoint
from perception.reconstruct.features import Features, features
from perception.reconstruct.matching import MAX_EPIPOLAR_PX, ByPair
from perception.reconstruct.optics import Optics
from perception.reconstruct.pair_consensus import adjust_agreeing
from perception.reconstruct.pair_matching import match_pairs, pairs_of
from perception.reconstruct.pictures import SurveyPicture, picture_key, require_enough
from perception.reconstruct.resources import single_threaded_libraries
from perception.reconstruct.second_look import Look, second_look
from perception.reconstruct.settings import Progress
from perception.reconstruct.witnesses import features_of, of_the_first, witnesses

METHOD = 8
"""Raised whenever the poses change for the same input, so that stored ones are not taken for new ones."""
PARTNERS = 20
LONELY = 60
"""A picture with fewer, whomever it was tried with, gets exploration's pictures beside it."""
FEW_MATCHES = 150
"""A picture with fewer is tried with all that overlap it, not with its best partners alone."""
BAND_SIGMAS = 4.5
MIN_BAND_PX = 6.0
LARGE_SHARE = 0.1
"""Of all pictures, in a group: where none is smaller, a second look at the building gained nothing."""
UNKNOWN_LENS_PX, UNKNOWN_LENS_EPIPOLAR_PX = 60.0, 12.0
"""A lens that nobody has measured puts points as far from where a pinhole would, in a picture 1920 pixels wide: at
most, and where most of them are."""
MIN_POINTS = 10
"""A picture that sees fewer keeps its measured pose."""
MAX_SIGMAS = 5.0
"""So does one that would be moved or turned farther than this: the measurement is more likely than the matches."""
MIN_SHARED = 10
"""Pictures with as many points in common belong to one group."""


def align(pictures: list[SurveyPicture], accuracy: Accuracy, distance_m: float, folder: Path, threads: int = 3,
          progress: Progress = lambda stage, done, total: None, lens: Distortion = NONE,
          calibrate: bool = False, control: Sequence[ControlPoint] = (),
          explored: Sequence[SurveyPicture] = ()) -> Alignment:
    """The pictures with aligned poses, in the same order; deterministic, whatever the number of threads.

    distance_m: usual distance of the surface. lens: distortion of the camera. calibrate: find focal length and
    distortion as well, from those given on. control: surveyed points, pictures numbered as they are given. explored:
    pictures through the same lens that stand by where survey pictures have too few neighbours. The result is kept in
    folder (see `aligned_poses`) and taken from there when the same pictures and poses come again. `progress` is told
    "features", "match" and "adjust".
    Raises UserError when there are fewer than three pictures or one cannot be read.
    """
    require_enough(pictures)
    key = _key(pictures, accuracy, f"{distance_m} {lens} {calibrate} {list(control)} "
                                   f"{picture_key(list(explored))}")
    stored = read_alignment(folder, pictures, key)
    if stored is not None:
        return stored
    band_px = max(MIN_BAND_PX, BAND_SIGMAS * accuracy.pixels(pictures[0].camera, distance_m))
    with single_threaded_libraries(), ThreadPoolExecutor(threads) as pool:
        seen = []
        for of_picture in pool.map(features, pictures):
            seen.append(of_picture)
            progress("features", len(seen), len(pictures))
        optics = Optics(pictures[0].camera, lens)
        if calibrate:
            optics = _calibrated(pictures, seen, optics, accuracy, distance_m, band_px, pool, progress)
        matches = _matches(pictures, seen, optics, distance_m, band_px, MAX_EPIPOLAR_PX, pool, progress)
        everything = _accompanied(pictures, list(explored), seen, matches, optics, distance_m, band_px, pool, progress)
        progress("adjust", 0, 2)
        agreed = partial(adjust_agreeing, everything, seen, accuracy=accuracy, first_px=0.5 * band_px,
                         calibrate=calibrate, control=list(control))
        matches, found = agreed(matches, optics=optics)
        progress("adjust", 1, 2)
        joined = _joined(found, len(everything))
        if not joined.all():
            look = Look(found, joined, distance_m, band_px, PARTNERS)
            matches = second_look(everything, len(pictures), seen, matches, look, pool)
            _, found = agreed(matches, optics=found.optics)
    adjusted = of_the_first(found, len(pictures))
    measured = pictures if adjusted.carried is None else carried_by(adjusted.carried, pictures)
    write_alignment(folder, key, pictures, _judged(measured, adjusted, accuracy), adjusted)
    progress("adjust", 2, 2)
    written = read_alignment(folder, pictures, key)
    assert written is not None
    return written


def _calibrated(pictures: list[SurveyPicture], seen: list[Features], optics: Optics, accuracy: Accuracy,
                distance_m: float, band_px: float, pool: ThreadPoolExecutor, progress: Progress) -> Optics:
    """The lens to match with: found from matches that an unknown lens may put far from where they belong."""
    share = optics.camera.width_px / 1920.0
    matches = _matches(pictures, seen, optics, distance_m, band_px + UNKNOWN_LENS_PX * share,
                       UNKNOWN_LENS_EPIPOLAR_PX * share, pool, lambda _, done, total: progress("lens", done, total))
    first_px = 0.5 * (band_px + UNKNOWN_LENS_PX * share)
    return adjust(pictures, seen, matches, accuracy, first_px, optics, calibrate=True).optics


def _key(pictures: list[SurveyPicture], accuracy: Accuracy, wishes: str) -> str:
    """Hash of everything that the alignment depends on."""
    about = f"{METHOD} {accuracy.position_m} {accuracy.attitude_rad} {wishes} {picture_key(pictures)}"
    return hashlib.sha256(about.encode()).hexdigest()[:12]


def _matches(pictures: list[SurveyPicture], seen: list[Features], optics: Optics, distance_m: float, band_px: float,
             epipolar_px: float, pool: ThreadPoolExecutor, progress: Progress) -> ByPair:
    """Matches by pair, of each picture with its best partners, and with more where that gives too few."""
    matches: ByPair = {}
    tried: set[tuple[int, int]] = set()
    for count in (PARTNERS, len(pictures)):
        few = np.ones(len(pictures)) if count == PARTNERS else _matched(matches, len(pictures)) < FEW_MATCHES
        pairs = pairs_of(pictures, distance_m, count, np.flatnonzero(few).tolist()) - tried
        done_before = len(tried)
        tried |= pairs

        def tell(done: int, total: int, before: int = done_before) -> None:
            progress("match", before + done, before + total)

        matches |= match_pairs(pairs, pictures, seen, optics, band_px, epipolar_px, pool, tell)
    return matches


def _matched(matches: ByPair, pictures: int) -> NDArray[np.int64]:
    """(n,) matches of every picture."""
    total = np.zeros(pictures, dtype=np.int64)
    for pair, found in matches.items():
        total[list(pair)] += len(found)
    return total


def _accompanied(pictures: list[SurveyPicture], explored: list[SurveyPicture], seen: list[Features],
                 matches: ByPair, optics: Optics, distance_m: float, band_px: float,
                 pool: ThreadPoolExecutor, progress: Progress) -> list[SurveyPicture]:
    """The pictures and, after them, exploration's beside those that have few matches or none with most others. What
    these see, and their matches, are added to those given."""
    lonely = np.flatnonzero((_matched(matches, len(pictures)) < LONELY) | _apart(matches, len(pictures)))
    beside = witnesses([pictures[i] for i in lonely], explored, distance_m)
    if not beside:
        return pictures
    everything = [*pictures, *(replace(w, camera=pictures[0].camera) for w in beside)]
    seen += pool.map(lambda w: features_of(w, pictures[0].camera), beside)
    new = pairs_of(everything, distance_m, PARTNERS, [*lonely.tolist(), *range(len(pictures), len(everything))])
    matches |= match_pairs(new - matches.keys(), everything, seen, optics, band_px, MAX_EPIPOLAR_PX, pool,
                           lambda done, total: progress("match", done, total))
    return everything


def _joined(found: Adjusted, pictures: int) -> NDArray[np.bool_]:
    """(n,) which pictures are in a group that is large enough to hold its own."""
    groups = _groups(found, pictures)
    return np.asarray(np.bincount(groups)[groups] >= LARGE_SHARE * pictures)


def _apart(matches: ByPair, pictures: int) -> NDArray[np.bool_]:
    """(n,) which pictures no chain of matches joins with most others."""
    first, second = np.array(sorted(matches), dtype=np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(first), np.bool_), (first, second)), shape=(pictures, pictures))
    label = connected_components(graph, directed=False)[1]
    return np.asarray(label != np.argmax(np.bincount(label)))


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
