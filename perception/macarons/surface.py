"""The surface found so far, thinned to an even spacing, and where it lies around each cell of the object's box."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array

CELLS = 100
CELL_CAPACITY = 1000


@dataclass(frozen=True)
class Cells:
    """Near-cubic cells, about CELLS of them, that divide a box."""

    lower_enu_m: Array
    size_m: Array
    """(3,) of a cell."""
    shape: tuple[int, int, int]

    @classmethod
    def of_box(cls, lower_enu_m: Array, upper_enu_m: Array) -> Cells:
        """The box's cells."""
        extent = upper_enu_m - lower_enu_m
        edge = float(np.prod(extent) / CELLS) ** (1.0 / 3.0)
        nx, ny, nz = (max(1, round(float(e) / edge)) for e in extent)
        return cls(lower_enu_m, extent / np.array([nx, ny, nz]), (nx, ny, nz))

    @property
    def count(self) -> int:
        """How many there are."""
        return math.prod(self.shape)

    @property
    def diagonal_m(self) -> float:
        """Of a cell."""
        return float(np.linalg.norm(self.size_m))

    @property
    def spacing_m(self) -> float:
        """The spacing at which CELL_CAPACITY points cover the largest diagonal plane of a cell."""
        a, b, c = self.size_m
        area = max(a * math.hypot(b, c), b * math.hypot(a, c), c * math.hypot(a, b))
        return 2.0 * math.sqrt(float(area) / (CELL_CAPACITY * math.pi))

    def numbers(self, points_enu_m: Array) -> NDArray[np.int64]:
        """(n,) the cell that each point (n, 3) lies in, -1 outside the box."""
        index = np.floor((points_enu_m - self.lower_enu_m) / self.size_m).astype(np.int64)
        inside = ((index >= 0) & (index < np.array(self.shape))).all(axis=1)
        flat = np.ravel_multi_index(tuple(np.clip(index, 0, np.array(self.shape) - 1).T), self.shape)
        return np.where(inside, flat, -1)

    def centres(self) -> Array:
        """(count, 3) middles."""
        index = np.stack(np.unravel_index(np.arange(self.count), self.shape), axis=1)
        result: Array = self.lower_enu_m + (index + 0.5) * self.size_m
        return result

    def around(self, cell: int) -> NDArray[np.int64]:
        """Numbers of the cell and its neighbours, up to 27."""
        at = np.array(np.unravel_index(cell, self.shape))
        axes = [np.arange(max(0, i - 1), min(n, i + 2)) for i, n in zip(at, self.shape, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return np.asarray(np.ravel_multi_index(tuple(grid.T), self.shape), dtype=np.int64)


class Surface:
    """Points on a grid of the cells' spacing: the first that falls into a voxel of that size stays.

    MACARONS keeps a point that is farther than the spacing from all others of its cell, and drops random ones of a cell
    that overflows; this is the same density without an order of search, and without loss.
    """

    def __init__(self, cells: Cells) -> None:
        self.cells = cells
        self._voxels = np.zeros(0, dtype=np.int64)
        self.points = np.zeros((0, 3))
        self.cell = np.zeros(0, dtype=np.int64)

    def add(self, points_enu_m: Array) -> tuple[Array, NDArray[np.int64]]:
        """Take points (n, 3) in; returns those that were new, and the cells that they fell into."""
        cell = self.cells.numbers(points_enu_m)
        points, cell = points_enu_m[cell >= 0], cell[cell >= 0]
        voxel = self._voxel(points)
        _, first = np.unique(voxel, return_index=True)
        first = np.sort(first[~np.isin(voxel[first], self._voxels)])
        self._voxels = np.concatenate([self._voxels, voxel[first]])
        self.points = np.concatenate([self.points, points[first]])
        self.cell = np.concatenate([self.cell, cell[first]])
        return points[first], np.unique(cell[first])

    def _voxel(self, points: Array) -> NDArray[np.int64]:
        index = np.floor((points - self.cells.lower_enu_m) / self.cells.spacing_m).astype(np.int64)
        return np.asarray(index[:, 0] + (index[:, 1] << 20) + (index[:, 2] << 40), dtype=np.int64)

    def near(self, cell: int) -> Array:
        """(n, 3) the points of a cell and its neighbours."""
        return self.points[np.isin(self.cell, self.cells.around(cell))]
