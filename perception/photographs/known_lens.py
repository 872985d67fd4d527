"""Pairs of pictures judged once more, when a first model tells the lens.

Before that a pair may bend what explains its matches: a fundamental matrix, four pixels of tolerance for the lens. So
do windows that match one storey aside. With the lens known, right matches fit one relative pose to a pixel, and
look-alikes hardly.
"""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from perception.reconstruct.matching import MIN_MATCHES, SEED, Matches
from perception.reconstruct.optics import Optics

NEAR_ERRORS = 6.0
"""Matches as near to their epipolar lines are right, in mean errors of the model's points."""
STRONG = 100
"""Matches of a pair that is right, whatever the lens."""
MOST_CONFIRMED, MOST_KEPT = 0.8, 0.5
"""The lens is believed when as many of the strong pairs keep as many of their matches."""

Model = pycolmap.Reconstruction
Points = NDArray[np.float32]
Pair = tuple[int, int]


@dataclass(frozen=True)
class KnownLens:
    """Cameras that a model tells, by id, and how near to its epipolar line a match of theirs has to be."""

    cameras: dict[int, pycolmap.Camera]
    near_px: float

    @classmethod
    def of(cls, model: Model, least: int) -> KnownLens | None:
        """Of the cameras that took at least so many pictures of the model; None where there is none."""
        count = Counter(model.image(i).camera_id for i in model.reg_image_ids())
        cameras = {k: model.camera(k) for k, pictures in sorted(count.items()) if pictures >= least}
        return cls(cameras, NEAR_ERRORS * float(model.compute_mean_reprojection_error())) if cameras else None


def judge_again(database: Path, lens: KnownLens, threads: int) -> bool:
    """Whether the strong pairs bear the lens out; if so the pairs between its cameras are verified anew, and the
    cameras written, in the database."""
    with pycolmap.Database.open(database) as kept:
        pairs, found = _judged(kept, lens, threads)
        counted = dict(zip(*kept.read_two_view_geometry_num_inliers(), strict=True))
        before = [counted.get(pycolmap.image_pair_to_pair_id(*pair), 0) for pair in pairs]
        after = [len(g.inlier_matches) if g else 0 for g in found]
        borne_out = [a >= MOST_KEPT * b for a, b in zip(after, before, strict=True) if b >= STRONG]
        if not borne_out or sum(borne_out) < MOST_CONFIRMED * len(borne_out):
            return False
        for pair, geometry in zip(pairs, found, strict=True):
            if kept.exists_two_view_geometry(*pair):
                kept.delete_two_view_geometry(*pair)
            if geometry is not None:
                kept.write_two_view_geometry(*pair, geometry)
        for camera in lens.cameras.values():
            camera.has_prior_focal_length = True
            kept.update_camera(camera)
    return True


def _judged(kept: pycolmap.Database, lens: KnownLens, threads: int
            ) -> tuple[list[Pair], list[pycolmap.TwoViewGeometry | None]]:
    """All matched pairs between the cameras, and what holds between their pictures."""
    camera_of = {image.image_id: image.camera_id for image in kept.read_all_images()
                 if image.camera_id in lens.cameras}
    ideal = {i: Optics.of(lens.cameras[k]).ideal(np.asarray(kept.read_keypoints(i))[:, :2])
             for i, k in camera_of.items()}
    pinholes = {k: pycolmap.Camera(camera_id=k, model="PINHOLE", width=c.width, height=c.height, params=c.params[:4])
                for k, c in lens.cameras.items()}
    pair_ids, matches = kept.read_all_matches()
    matches_of = dict(zip(map(pycolmap.pair_id_to_image_pair, pair_ids), matches, strict=True))
    pairs = sorted(pair for pair in matches_of if pair[0] in ideal and pair[1] in ideal)

    def judged(pair: Pair) -> pycolmap.TwoViewGeometry | None:
        a, b = pair
        return _verified(ideal[a], ideal[b], pinholes[camera_of[a]], pinholes[camera_of[b]],
                         np.asarray(matches_of[pair]), lens.near_px)

    with ThreadPoolExecutor(threads) as pool:
        return pairs, list(pool.map(judged, pairs))


def _verified(a: Points, b: Points, of_a: pycolmap.Camera, of_b: pycolmap.Camera, matches: Matches,
              near_px: float) -> pycolmap.TwoViewGeometry | None:
    """The relative pose that most matches fit, with those alone; None where there are too few of them."""
    ransac = pycolmap.RANSACOptions(max_error=near_px, min_num_trials=100, max_num_trials=3000, random_seed=SEED)
    first, second = a[matches[:, 0]].astype(np.float64), b[matches[:, 1]].astype(np.float64)
    fit: Any = pycolmap.estimate_essential_matrix(first, second, of_a, of_b, ransac)
    near = matches[fit["inlier_mask"]] if fit else matches[:0]
    if len(near) < MIN_MATCHES:
        return None
    options = pycolmap.TwoViewGeometryOptions(min_num_inliers=MIN_MATCHES, compute_relative_pose=True,
                                              detect_watermark=False, ransac=ransac)
    geometry = pycolmap.estimate_calibrated_two_view_geometry(of_a, a.astype(np.float64), of_b, b.astype(np.float64),
                                                              near, options)
    return geometry if len(geometry.inlier_matches) >= MIN_MATCHES else None
