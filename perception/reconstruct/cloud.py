"""The reconstructed cloud: one point per voxel of a uniform grid, and its file."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from missions.errors import UserError
from missions.frames import Array

ISLAND_POINTS = 30
HALF_THE_NEIGHBOURS = [step for step in itertools.product((-1, 0, 1), repeat=3) if step > (0, 0, 0)]
"""Of a cell's 26; the others are those of its neighbours."""


@dataclass(frozen=True)
class Cloud:
    """Points (n, 3) float32 ENU metres, colours (n, 3) uint8 RGB, unit normals (n, 3) float32, and confidence (n,)
    uint8, the number of agreeing depth maps."""

    points_enu_m: NDArray[np.float32]
    colours: NDArray[np.uint8]
    normals: NDArray[np.float32]
    confidence: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points_enu_m)

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Cloud:
        """The points picked by a mask or by indices."""
        return Cloud(self.points_enu_m[which], self.colours[which], self.normals[which], self.confidence[which])

    @classmethod
    def concatenate(cls, clouds: list[Cloud]) -> Cloud:
        """All clouds in one, in order."""
        if not clouds:
            return cls(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), np.zeros((0, 3), np.float32),
                       np.zeros(0, np.uint8))
        return cls(np.concatenate([c.points_enu_m for c in clouds]), np.concatenate([c.colours for c in clouds]),
                   np.concatenate([c.normals for c in clouds]), np.concatenate([c.confidence for c in clouds]))


def voxels(points_enu_m: NDArray[np.float32], spacing_m: float) -> NDArray[np.int64]:
    """Indices of the grid's voxels in which points lie, of the same shape."""
    return np.asarray(np.floor(points_enu_m / np.float32(spacing_m)).astype(np.int64))


def cell_numbers(points_enu_m: NDArray[np.float32], cell_m: float) -> tuple[NDArray[np.int64], int, int]:
    """(n,) numbers of the cells that points (n, 3) lie in, and by how much a neighbour's number along the first and the
    second axis is larger; along the third it is the next one."""
    index = np.floor(points_enu_m / cell_m).astype(np.int64)
    index -= index.min(axis=0) - 1
    # a rim of one, so that a neighbour's number never is that of a cell at the other end of a row
    _, rows, layers = (int(n) for n in index.max(axis=0) + 2)
    return (index[:, 0] * rows + index[:, 1]) * layers + index[:, 2], rows * layers, layers


def on_grid(cloud: Cloud, spacing_m: float) -> Cloud:
    """One point per occupied voxel, at its members' mean weighted by confidence; the largest confidence counts."""
    if not len(cloud):
        return cloud
    index = voxels(cloud.points_enu_m, spacing_m)
    index -= index.min(axis=0)
    shape = index.max(axis=0) + 1
    key = (index[:, 0] * shape[1] + index[:, 1]) * shape[2] + index[:, 2]
    order = np.argsort(key, kind="stable")
    start = np.flatnonzero(np.diff(key[order], prepend=-1))
    del index, key
    weight = cloud.confidence[order].astype(np.float64)
    total = np.add.reduceat(weight, start)[:, None]

    def mean(values: NDArray[np.float32] | NDArray[np.uint8]) -> Array:
        return np.column_stack([np.add.reduceat(values[order, k] * weight, start) for k in range(3)]) / total

    normals = mean(cloud.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return Cloud(mean(cloud.points_enu_m).astype(np.float32), np.rint(mean(cloud.colours)).astype(np.uint8),
                 normals.astype(np.float32), np.maximum.reduceat(cloud.confidence[order], start))


def without_islands(cloud: Cloud, cell_m: float, least_points: int = ISLAND_POINTS) -> Cloud:
    """Drop groups of fewer than `least_points` points that touch nothing else at a resolution of cell_m."""
    if not len(cloud):
        return cloud
    numbers, across, along = cell_numbers(cloud.points_enu_m, cell_m)
    cells, cell_of = np.unique(numbers, return_inverse=True)
    steps = [dx * across + dy * along + dz for dx, dy, dz in HALF_THE_NEIGHBOURS]
    ends = [np.searchsorted(cells, cells + step) for step in steps]
    touching = [np.flatnonzero(np.take(cells, end, mode="clip") == cells + step)
                for end, step in zip(ends, steps, strict=True)]
    first, second = np.concatenate(touching), np.concatenate([e[t] for e, t in zip(ends, touching, strict=True)])
    graph = coo_array((np.ones(len(first), np.bool_), (first, second)), shape=(len(cells), len(cells)))
    group = connected_components(graph, directed=False)[1][cell_of]
    return cloud.select(np.bincount(group)[group] >= least_points)


def write_cloud(cloud: Cloud, path: Path) -> None:
    """Binary PLY: x y z, nx ny nz, red green blue, confidence (uint8)."""
    data = o3d.t.geometry.PointCloud()
    data.point["positions"] = o3d.core.Tensor.from_numpy(np.ascontiguousarray(cloud.points_enu_m))
    data.point["normals"] = o3d.core.Tensor.from_numpy(np.ascontiguousarray(cloud.normals))
    data.point["colors"] = o3d.core.Tensor.from_numpy(np.ascontiguousarray(cloud.colours))
    data.point["confidence"] = o3d.core.Tensor.from_numpy(np.ascontiguousarray(cloud.confidence[:, None]))
    if not o3d.t.io.write_point_cloud(path, data):
        raise UserError(f"{path}: cannot be written; free some disk space or choose another run folder.")


def read_cloud(path: Path) -> Cloud:
    """The cloud that write_cloud wrote. Raises UserError when it is missing or lacks a property."""
    data = o3d.t.io.read_point_cloud(path) if path.is_file() else o3d.t.geometry.PointCloud()
    missing = [name for name in ("positions", "normals", "colors", "confidence") if name not in data.point]
    if missing:
        raise UserError(f"{path}: no cloud with {', '.join(missing)}; run 'swarmscan reconstruct' on the run folder.")
    arrays = {name: data.point[name].numpy() for name in ("positions", "normals", "colors", "confidence")}
    return Cloud(arrays["positions"].astype(np.float32), arrays["colors"].astype(np.uint8),
                 arrays["normals"].astype(np.float32), arrays["confidence"][:, 0].astype(np.uint8))
