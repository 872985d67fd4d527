"""Views into as many spatial clusters as there are vehicles (thesis section 4.4.1, Eqs. 4.2 and 4.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.optimize import linear_sum_assignment

from missions.frames import Array


def ward_linkage(positions_enu_m: Array) -> Array:
    """(n - 1, 4) the merges of positions (n, 3), n > 1, in scipy's form: what a dendrogram shows.

    Agglomerative clustering with Ward's linkage (Murtagh & Legendre 2014) on Euclidean distance: each merge is the one
    that adds least to the sum of squared distances from the clusters' centroids (Eq. 4.2).
    """
    merges: Array = linkage(positions_enu_m, method="ward", metric="euclidean")
    return merges


def ward_clusters(positions_enu_m: Array, clusters: int) -> list[NDArray[np.int64]]:
    """At most `clusters` disjoint index arrays that together hold every position (n, 3) once (Eq. 4.3), each rising.

    Ward's merges, cut by `maxclust`. Fewer clusters come back when there are fewer distinct positions.
    """
    positions = np.asarray(positions_enu_m, dtype=np.float64).reshape(-1, 3)
    if len(positions) < 2 or clusters < 2:
        return [np.arange(len(positions))] if len(positions) else []
    labels = fcluster(ward_linkage(positions), t=clusters, criterion="maxclust")
    return [np.flatnonzero(labels == label) for label in np.unique(labels)]


def clusters_to_vehicles(clusters: list[NDArray[np.int64]], from_start: Array) -> list[NDArray[np.int64]]:
    """One cluster, or an empty one, per vehicle, so that the sum of the mean costs from start to view is least.

    from_start: (m, n) cost from each vehicle's start to each view; there are at most m clusters.
    """
    given = [np.zeros(0, dtype=np.int64) for _ in from_start]
    if not clusters:
        return given
    mean = np.array([[row[c].mean() for c in clusters] for row in from_start])
    for vehicle, cluster in zip(*linear_sum_assignment(mean), strict=True):
        given[vehicle] = clusters[cluster]
    return given
