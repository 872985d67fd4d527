"""Ties of pictures that share too few features with any single other one: the points that the others found together,
looked for where the measured pose says they are.

A corner, a lattice before the sky: each pair of pictures has fewer common features than make its relative pose certain,
and where texture repeats they are not told apart along a whole epipolar line. Points have a place. They are looked for
around it alone, those of all other pictures count together, and one pose must explain them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from numpy.typing import NDArray

from missions.frames import Array
from perception.depth.compiled import compiled
from perception.reconstruct.bundle import Adjusted
from perception.reconstruct.features import Features
from perception.reconstruct.matching import MAX_RATIO, SEED, ByPair, Matches
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture

LEAST = 12
"""Fewer points may agree on a wrong pose."""
LEAST_SHARE = 0.35
"""Of the points that were found: more agree on a wrong pose by chance when many were found."""
MAX_OFF_PX = 3.0
MAX_DISTANCE = 0.6 * 512.0
MAX_ASIDE_DEG = 50.0
MAX_TIMES_AS_FAR = 2.5
"""A point is looked for as pictures have it that see it from no more than this aside, and from no other distance."""


@dataclass(frozen=True)
class Known:
    """What pictures that belong together see: rows (picture, feature, point)."""

    picture_of: NDArray[np.int64]
    feature_of: NDArray[np.int64]
    point_of: NDArray[np.int64]
    points_enu_m: Array
    towards_enu: Array
    """(o, 3) unit, from the point to the picture."""
    distance_m: Array
    """(o,)"""
    descriptors: NDArray[np.uint8]
    """(o, 128)"""

    @classmethod
    def of(cls, found: Adjusted, together: NDArray[np.bool_], seen: list[Features]) -> Known:
        """together: (n,) which pictures count."""
        rows = together[found.picture_of]
        picture_of, feature_of, point_of = found.picture_of[rows], found.feature_of[rows], found.point_of[rows]
        away = found.position_enu_m[picture_of] - found.points_enu_m[point_of]
        distance_m = np.linalg.norm(away, axis=1)
        descriptors = np.array([seen[i].descriptors[k] for i, k in zip(picture_of, feature_of, strict=True)], np.uint8)
        return cls(picture_of, feature_of, point_of, found.points_enu_m, away / distance_m[:, None], distance_m,
                   descriptors.reshape(-1, 128))


def tied(pictures: list[SurveyPicture], seen: list[Features], matches: ByPair, found: Adjusted,
         together: NDArray[np.bool_], reach_px: float) -> ByPair:
    """The matches, and beside them those of pictures that are not together (n,) with the ones that are.

    found: what bundle adjustment made of the matches; pictures are taken to be where it puts them.
    """
    known = Known.of(found, together, seen)
    all_of_them = dict(matches)
    for i in np.flatnonzero(~together).tolist():
        picture = replace(pictures[i], enu_from_camera=found.enu_from_camera[i], position_enu_m=found.position_enu_m[i])
        for j, new in ties(picture, seen[i], known, found.optics, reach_px).items():
            pair, ordered = ((i, j), new) if i < j else ((j, i), new[:, ::-1])
            all_of_them[pair] = _joined(all_of_them.get(pair, ordered[:0]), ordered)
    return all_of_them


def ties(picture: SurveyPicture, own: Features, known: Known, optics: Optics,
         reach_px: float) -> dict[int, Matches]:
    """Matches of a picture's features with those of the pictures that know the points, by picture; none where no pose
    explains LEAST of them.

    reach_px: how far from where the picture's pose puts a point it is looked for."""
    ideal = optics.ideal(own.points_px)
    rows, at_px = _expected(picture, known, optics)
    feature, row = _looked_for(known, rows, at_px, ideal, own.descriptors, reach_px)
    if len(feature) < LEAST:
        return {}
    point = known.point_of[row]
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac = pycolmap.RANSACOptions(max_error=MAX_OFF_PX, min_num_trials=100, max_num_trials=2000,
                                            random_seed=SEED)
    fit = pycolmap.estimate_absolute_pose(ideal[feature].astype(np.float64), known.points_enu_m[point],
                                          Optics(optics.camera).colmap(with_lens=False), options)
    if fit is None or fit["num_inliers"] < max(LEAST, LEAST_SHARE * len(feature)):
        return {}
    good = fit["inlier_mask"]
    return _by_picture(known, dict(zip(point[good].tolist(), feature[good].tolist(), strict=True)))


def _expected(picture: SurveyPicture, known: Known, optics: Optics) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Rows whose points lie in the picture and look from there as they were seen, and (r, 2) where, without a lens."""
    camera = optics.camera
    away = picture.position_enu_m - known.points_enu_m[known.point_of]
    local = -away @ picture.enu_from_camera
    distance_m = np.linalg.norm(away, axis=1)
    times = distance_m / known.distance_m
    alike = np.einsum("ij,ij->i", away, known.towards_enu) > np.cos(np.radians(MAX_ASIDE_DEG)) * distance_m
    alike &= (times < MAX_TIMES_AS_FAR) & (times > 1.0 / MAX_TIMES_AS_FAR) & (local[:, 2] > 0.1)
    rows = np.flatnonzero(alike)
    local = local[rows]
    at_px = local[:, :2] / local[:, 2:] * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
    inside = np.all((at_px > 0.0) & (at_px < [camera.width_px, camera.height_px]), axis=1)
    return rows[inside], at_px[inside].astype(np.float32)


def _looked_for(known: Known, rows: NDArray[np.int64], at_px: NDArray[np.float32], ideal: NDArray[np.float32],
                descriptors: NDArray[np.uint8], reach_px: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Features of the picture, each once, and the row that each is most like; points are found once as well."""
    found, distance = _nearest(at_px, known.descriptors[rows], np.ascontiguousarray(ideal), descriptors,
                               np.float32(reach_px), np.float32(MAX_RATIO**2))
    good = np.flatnonzero((found >= 0) & (distance < MAX_DISTANCE**2))
    best_first = good[np.argsort(distance[good], kind="stable")]
    feature, row = found[best_first], rows[best_first]
    _, first = np.unique(feature, return_index=True)
    feature, row = feature[np.sort(first)], row[np.sort(first)]
    _, first = np.unique(known.point_of[row], return_index=True)
    return feature[np.sort(first)], row[np.sort(first)]


@compiled
def _nearest(at_px: NDArray[np.float32], wanted: NDArray[np.uint8], points_px: NDArray[np.float32],
             descriptors: NDArray[np.uint8], reach_px: np.float32,
             ratio_square: np.float32) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each place and descriptor, the feature within reach that is clearly most like it, or -1, and the squared
    distance of the two."""
    found, distance = np.full(len(at_px), -1, np.int64), np.zeros(len(at_px), np.int64)
    for i in range(len(at_px)):
        best, second, chosen = np.int64(1 << 30), np.int64(1 << 30), -1
        for j in range(len(points_px)):
            if (abs(points_px[j, 0] - at_px[i, 0]) > reach_px) or (abs(points_px[j, 1] - at_px[i, 1]) > reach_px):
                continue
            apart = np.int64(0)
            for k in range(wanted.shape[1]):
                step = np.int64(wanted[i, k]) - np.int64(descriptors[j, k])
                apart += step * step
            if apart < best:
                best, second, chosen = apart, best, j
            elif apart < second:
                second = apart
        if chosen >= 0 and best < ratio_square * second:
            found[i], distance[i] = chosen, best
    return found, distance


def _by_picture(known: Known, feature_of_point: dict[int, int]) -> dict[int, Matches]:
    """The picture's features with those that the points were known by."""
    pairs: dict[int, list[tuple[int, int]]] = {}
    for row in np.flatnonzero(np.isin(known.point_of, list(feature_of_point))).tolist():
        pairs.setdefault(int(known.picture_of[row]), []).append(
            (feature_of_point[int(known.point_of[row])], int(known.feature_of[row])))
    return {i: np.array(p, np.uint32) for i, p in pairs.items()}


def _joined(old: Matches, new: Matches) -> Matches:
    """Both, no feature of either picture in two matches; old ones count first."""
    both = np.concatenate([old, new])
    for column in (0, 1):
        _, first = np.unique(both[:, column], return_index=True)
        both = both[np.sort(first)]
    return np.ascontiguousarray(both)
