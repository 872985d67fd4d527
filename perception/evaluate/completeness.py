"""Cloud to cloud (C2C): how much of the true surface was reconstructed (thesis section 4.7.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from missions.frames import Array

THRESHOLDS_M = (0.05, 0.10, 0.20, 0.25, 0.50)


def distances_to_cloud(samples_enu_m: Array, cloud_enu_m: NDArray[np.float32], workers: int = 3) -> Array:
    """(n,) metres from each true sample to its nearest reconstructed point; infinite when the cloud is empty."""
    if not len(cloud_enu_m):
        return np.full(len(samples_enu_m), np.inf)
    tree = cKDTree(cloud_enu_m, balanced_tree=False, compact_nodes=False)
    return np.asarray(tree.query(samples_enu_m, workers=workers)[0])


def completeness(distances_m: Array, thresholds_m: tuple[float, ...] = THRESHOLDS_M) -> dict[str, float | None]:
    """Share (0-1) of true samples with a reconstructed point within each threshold, by threshold ("0.25").

    Samples are uniform over the exposed surface, so the share is one of area. None without samples.
    """
    if not len(distances_m):
        return {f"{t:.2f}": None for t in thresholds_m}
    return {f"{t:.2f}": float(np.mean(distances_m <= t)) for t in thresholds_m}
