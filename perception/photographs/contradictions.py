"""Pairs of pictures whose features match though what the pictures say of themselves shows that they cannot.

Structures that look alike from several sides give matches that one relative pose explains well: the front of a building
and its back. A gimbal's angles are good to a few degrees, and tell them apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from missions.frames import Array

LARGEST_TURN = math.radians(25.0)
"""Between two matched pictures by their matches and by their attitudes: compasses are off near steel."""
MOST = 0.6
"""Attitudes are believed when they agree with as many of the pairs."""
Configuration = pycolmap.TwoViewGeometryConfiguration
ON_A_PLANE = (Configuration.PLANAR, Configuration.PANORAMIC, Configuration.PLANAR_OR_PANORAMIC)


def strike_out(database: Path, enu_from_camera: Sequence[Array | None]) -> int:
    """Remove verified pairs that contradict attitudes, by picture (image i + 1 is picture i, axes of the stored
    pixels); returns how many. None where attitudes are unknown or agree with too few of the pairs to be believed."""
    with pycolmap.Database.open(database) as kept:
        pair_ids, geometries = kept.read_two_view_geometries()
        pairs = [pycolmap.pair_id_to_image_pair(pair_id) for pair_id in pair_ids]
        intrinsics = {image.image_id: kept.read_camera(image.camera_id).calibration_matrix()
                    for image in kept.read_all_images()}
        turns = np.array([_turn(g, enu_from_camera[i - 1], enu_from_camera[j - 1], intrinsics[i], intrinsics[j])
                          for (i, j), g in zip(pairs, geometries, strict=True)])
        known = np.isfinite(turns)
        wrong = known & (turns > LARGEST_TURN)
        if not np.any(wrong) or np.sum(wrong) > (1.0 - MOST) * np.sum(known):
            return 0
        for k in np.flatnonzero(wrong).tolist():
            kept.delete_two_view_geometry(*pairs[k])
    return int(np.sum(wrong))


def _turn(geometry: pycolmap.TwoViewGeometry, first: Array | None, second: Array | None, k_first: Array,
          k_second: Array) -> float:
    """Angle between both relative rotations, the least where matches leave several; NaN where one is unknown."""
    if first is None or second is None or geometry.cam2_from_cam1 is None:
        return math.nan
    rotations = [geometry.cam2_from_cam1.rotation.matrix()]
    if geometry.H is not None and Configuration(geometry.config) in ON_A_PLANE:
        rotations += cv2.decomposeHomographyMat(np.linalg.inv(k_second) @ geometry.H @ k_first, np.eye(3))[1]
    told = second.T @ first
    cosine = max((float(np.trace(r @ told.T)) - 1.0) / 2.0 for r in rotations)
    return math.acos(min(1.0, max(-1.0, cosine)))
