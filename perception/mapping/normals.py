"""Normals of surface voxels: the thinnest direction of the points around, turned towards the cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array

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
    moment = np.zeros((len(index), 3, 3))
    total, count = np.zeros((len(index), 3)), np.zeros(len(index))
    for shift in np.ndindex((2 * pad + 1,) * 3):
        neighbour = row[tuple((index + np.array(shift)).T)]
        there = neighbour >= 0
        offset = point[neighbour[there]] - point[there]
        moment[there] += offset[:, :, None] * offset[:, None, :]
        total[there] += offset
        count[there] += 1
    mean = total / count[:, None]
    covariance = moment / count[:, None, None] - mean[:, :, None] * mean[:, None, :]
    towards = towards_camera / np.maximum(np.linalg.norm(towards_camera, axis=1, keepdims=True), 1e-9)
    _, vectors = np.linalg.eigh(covariance)
    normal = np.where(count[:, None] >= 4, vectors[:, :, 0], towards)
    facing = np.einsum("ij,ij->i", normal, towards)
    result: Array = np.where(facing[:, None] < 0.0, -normal, normal)
    return result
