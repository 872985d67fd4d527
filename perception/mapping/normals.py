"""Normals of surface voxels: the thinnest direction of the points around, turned towards the cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from perception.depth.compiled import compiled

REACH_VOXELS = 2


def estimate(index: NDArray[np.int64], point: Array, towards_camera: Array, shape: tuple[int, ...]) -> Array:
    """(n, 3) unit normals by principal components of the points within REACH_VOXELS voxels.

    index: (n, 3) voxels; point: (n, 3) their mean points; towards_camera: (n, 3) any length; shape: of the grid.
    """
    if len(index) == 0:
        return np.zeros((0, 3))
    pad = REACH_VOXELS
    row = np.full(tuple(s + 2 * pad for s in shape), -1, dtype=np.int64)
    row[tuple((index + pad).T)] = np.arange(len(index))
    covariance, count = np.zeros((len(index), 3, 3)), np.zeros(len(index))
    _covariances(index, point, row, covariance, count)
    towards = towards_camera / np.maximum(np.linalg.norm(towards_camera, axis=1, keepdims=True), 1e-9)
    _, vectors = np.linalg.eigh(covariance)
    normal = np.where(count[:, None] >= 4, vectors[:, :, 0], towards)
    facing = np.einsum("ij,ij->i", normal, towards)
    result: Array = np.where(facing[:, None] < 0.0, -normal, normal)
    return result


@compiled
def _covariances(index: NDArray[np.int64], point: Array, row: NDArray[np.int64], covariance: Array,
                 count: Array) -> None:
    """Fills (n, 3, 3) covariances and (n,) numbers of the points around each voxel; row is padded by REACH_VOXELS."""
    for i in range(len(index)):
        x, y, z = index[i]
        total = np.zeros(3)
        for j in row[x : x + 2 * REACH_VOXELS + 1, y : y + 2 * REACH_VOXELS + 1, z : z + 2 * REACH_VOXELS + 1].flat:
            if j < 0:
                continue
            count[i] += 1.0
            for a in range(3):
                total[a] += point[j, a] - point[i, a]
                for b in range(3):
                    covariance[i, a, b] += (point[j, a] - point[i, a]) * (point[j, b] - point[i, b])
        for a in range(3):
            for b in range(3):
                covariance[i, a, b] = covariance[i, a, b] / count[i] - total[a] * total[b] / count[i] ** 2
