"""Pictures that a model puts in one place though they hardly see the same: look-alikes that were folded together.

Of the points that one picture sees and another, beside it, should see too, the other has most: half and more in models
that are right, because features are found again from nearly the same place. (Conflicting observations: Heinly, Dunn and
Frahm 2014, "Correcting for duplicate scene structure in sparse 3D reconstruction".)
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from missions.frames import Array

NEIGHBOURS = 12
SAME_PLACE = math.radians(7.0)
"""Between both pictures, as the points see them."""
SAME_WAY = math.cos(math.radians(25.0))
LEAST_EXPECTED, LEAST_SHARED = 40, 0.35
MOST_SEEN = 0.5
"""Of a picture's points that the other has in view, for both to be compared."""
SAME_DEPTH = 1.4
MOST_FOLDED = 0.25
WITHIN = 0.48


@dataclass(frozen=True)
class _View:
    image_id: int
    world_from_camera: Array
    centre: Array
    half_field: Array
    """(2,) tangents."""
    point_ids: NDArray[np.int64]
    points: Array

    def depth(self, points: Array) -> Array:
        """(n,) of points (n, 3) that are in view; NaN for others."""
        local = (points - self.centre) @ self.world_from_camera
        with np.errstate(divide="ignore", invalid="ignore"):
            inside = np.all(np.abs(local[:, :2] / local[:, 2:]) < self.half_field, axis=1) & (local[:, 2] > 0.0)
        return np.where(inside, local[:, 2], np.nan)


def leave_out_folded(model: pycolmap.Reconstruction) -> list[int]:
    """Takes photographs out of the model, and returns them, until no two of it are doubtful: always the one in most
    doubtful pairs, with the fewest points. None where that were more than MOST_FOLDED of all: then only the user can
    tell the sides apart, see `doubtful_pairs`."""
    pairs, folded = doubtful_pairs(model), list[int]()
    while pairs:
        count = Counter(i for pair in pairs for i in pair)
        worst = min(count, key=lambda i: (-count[i], model.image(i + 1).num_points3D, i))
        folded.append(worst)
        pairs = [pair for pair in pairs if worst not in pair]
    if len(folded) > MOST_FOLDED * model.num_reg_images():
        return []
    for i in folded:
        model.deregister_frame(i + 1)
    return sorted(folded)


def doubtful_pairs(model: pycolmap.Reconstruction) -> list[tuple[int, int]]:
    """Photographs (image i + 1 is photograph i) that stand and look alike in the model and share few points."""
    views = [_view(model, image_id) for image_id in sorted(model.reg_image_ids())]
    centres = np.array([v.centre for v in views])
    _, near = cKDTree(centres).query(centres, min(NEIGHBOURS + 1, len(views)))
    pairs = sorted({(min(a, int(b)), max(a, int(b))) for a, row in enumerate(near) for b in row if a != b})
    return [(views[a].image_id - 1, views[b].image_id - 1) for a, b in pairs if _doubtful(views[a], views[b])]


def _view(model: pycolmap.Reconstruction, image_id: int) -> _View:
    image = model.image(image_id)
    camera, pose = model.camera(image.camera_id), image.cam_from_world().inverse()
    ids = np.array(sorted({p.point3D_id for p in image.points2D if p.has_point3D()}), np.int64)
    points = np.array([model.point3D(i).xyz for i in ids.tolist()]).reshape(-1, 3)
    half = WITHIN * np.array([camera.width, camera.height]) / camera.mean_focal_length()
    return _View(image_id, pose.rotation.matrix(), np.asarray(pose.translation), half, ids, points)


def _doubtful(a: _View, b: _View) -> bool:
    if float(a.world_from_camera[:, 2] @ b.world_from_camera[:, 2]) < SAME_WAY:
        return False
    expected = [_in_both(one, other) for one, other in ((a, b), (b, a))]
    least = min(int(seen.sum()) for seen in expected)
    if least < LEAST_EXPECTED or any(seen.mean() < MOST_SEEN for seen in expected):
        return False
    middle = a.points[expected[0]].mean(axis=0)
    to_a, to_b = (v.centre - middle for v in (a, b))
    cosine = float(to_a @ to_b) / float(np.linalg.norm(to_a) * np.linalg.norm(to_b))
    return cosine > math.cos(SAME_PLACE) and len(np.intersect1d(a.point_ids, b.point_ids)) < LEAST_SHARED * least


def _in_both(one: _View, other: _View) -> NDArray[np.bool_]:
    """(n,) which points of one picture the other has in view from about as far."""
    ratio = one.depth(one.points) / other.depth(one.points)
    return np.asarray((ratio < SAME_DEPTH) & (ratio > 1.0 / SAME_DEPTH))
