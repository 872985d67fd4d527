"""Which points of a cloud are the ground's and not the object's, where only the object is measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perception.evaluate.accuracy import distances_to_mesh
from perception.evaluate.reference import Reference
from perception.reconstruct.cloud import Cloud

UNEVEN_M = 0.25
"""Reconstructed ground is at most this uneven; what lies higher is the object's, or an error that counts."""


def without_ground(cloud: Cloud, reference: Reference, ground_up_m: float) -> Cloud:
    """Without the points that lie lower than UNEVEN_M over level ground, and nearer to it than to the object.

    A cut at a height alone would call ground noise above it an error as large as the way to the object.
    """
    height = cloud.points_enu_m[:, 2] - np.float32(ground_up_m)
    low = np.flatnonzero(height < UNEVEN_M)
    away, _ = distances_to_mesh(cloud.points_enu_m[low], reference.vertices_enu_m, reference.triangles)
    kept: NDArray[np.bool_] = np.ones(len(cloud), dtype=np.bool_)
    kept[low] = height[low] >= np.abs(away)
    return cloud.select(kept)
