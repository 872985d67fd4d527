"""What candidate views would show of a map that is partly imagined, and what is left of it once other views are taken.

Every voxel stops a ray with a probability (its occupancy: known, or imagined where nothing was seen) and is worth
something when it does (its novelty: 0 once a view that counts has shown it). The expected novelty of a view is what
its rays stop at on the way through, nearer voxels hiding farther ones: volumetric rendering of novelty with occupancy
as opacity, the idea of MAGICIAN (Li et al., CVPR 2026), done by ray casting through voxels instead of by Gaussians.

Rays are cast once per position and shared by all of its orientations. What they meet is kept, in cells of a few voxels,
so that a search can ask what a view adds after others without casting again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from missions.sensors import fibonacci_directions
from planning.nbv.lattice import in_view
from planning.nbv.sight_kernels import cast_stops, count_stops, shown, view_sums

RAYS = 2048
CELL_VOXELS = 2
"""Edge of a cell of `Sights`, in voxels: what is shown of a cell, all views share."""


@dataclass(frozen=True)
class ImaginedMap:
    """Occupancy and novelty of every voxel of a grid; outside of it there is nothing."""

    origin_enu_m: Array
    voxel_m: float
    occupancy: NDArray[np.float32]
    """(i, j, k) probability that the voxel stops a ray, 0 where it is known to be free."""
    novelty: NDArray[np.float32]
    """(i, j, k) worth of a square metre of it, 0 to 1; 0 wherever nothing is gained."""


@dataclass(frozen=True)
class Orientations:
    """The directions that rays are cast in and those of them that each orientation of the camera sees."""

    directions_enu: Array
    """(r, 3)"""
    first: NDArray[np.int64]
    """(o + 1,) orientation k sees rays[first[k]:first[k + 1]]."""
    rays: NDArray[np.int64]

    @classmethod
    def of(cls, yaw_enu_rad: Array, elevation_rad: Array, camera: Camera, rays: int = RAYS) -> Orientations:
        """For orientations (o,) of a camera."""
        directions = fibonacci_directions(rays)
        mask = in_view(directions, yaw_enu_rad, elevation_rad, camera)
        first = np.concatenate([[0], np.cumsum(mask.sum(axis=0))])
        return cls(directions, first, np.nonzero(mask.T)[1])

    def __len__(self) -> int:
        return len(self.first) - 1


@dataclass(frozen=True)
class Sights:
    """What every ray from every position may stop at. Cells are numbered in C order over the grid in CELL_VOXELS."""

    orientations: Orientations
    first: NDArray[np.int64]
    """(p * r + 1,) ray j of position i meets entries [first[i * r + j], first[i * r + j + 1])."""
    cell: NDArray[np.int32]
    area_m2: NDArray[np.float32]
    """Expected new surface of that cell on that ray."""
    arrives: NDArray[np.float32]
    """Probability that the ray gets as far as the cell."""
    cells: int

    @property
    def nothing_shown(self) -> NDArray[np.float32]:
        """(cells,) what is left to see of each cell before any view: all."""
        return np.ones(self.cells, dtype=np.float32)

    @cached_property
    def gains_m2(self) -> Array:
        """(p, o) expected new surface of every view, each taken alone."""
        return self.gains_after(self.nothing_shown)

    def gains_after(self, left: NDArray[np.float32]) -> Array:
        """(p, o) expected new surface of every view once only these shares (cells,) are left to see."""
        o = self.orientations
        positions = (len(self.first) - 1) // len(o.directions_enu)
        gains: Array = view_sums(self.first, self.cell, self.area_m2, left, o.first, o.rays, positions,
                                 len(o.directions_enu))
        return gains

    def left_after(self, position: int, orientation: int, left: NDArray[np.float32]) -> NDArray[np.float32]:
        """(cells,) what is left to see after a view."""
        o = self.orientations
        result: NDArray[np.float32] = shown(self.first, self.cell, self.arrives, left, o.first, o.rays,
                                            len(o.directions_enu), position, orientation)
        return result


def sights(imagined: ImaginedMap, positions_enu_m: Array, orientations: Orientations, range_m: float) -> Sights:
    """Cast rays from positions (p, 3). Cost: p * r rays, each as long as it passes free or uncertain voxels."""
    voxel = imagined.voxel_m
    starts = (positions_enu_m - imagined.origin_enu_m) / voxel
    novel = [np.flatnonzero(imagined.novelty.any(axis=other)) for other in ((1, 2), (0, 2), (0, 1))]
    lower, upper = (np.array([float(n[end] + rim) if len(n) else 0.0 for n in novel]) for end, rim in ((0, 0), (-1, 1)))
    rays = (imagined.occupancy, imagined.novelty, lower, upper, starts, orientations.directions_enu, range_m / voxel,
            CELL_VOXELS)
    first = np.concatenate([[0], np.cumsum(count_stops(*rays).ravel())])
    scale = 4.0 * math.pi / len(orientations.directions_enu) * voxel**2
    cell, area, arrives = cast_stops(*rays, first, scale)
    coarse = [math.ceil(n / CELL_VOXELS) for n in imagined.occupancy.shape]
    return Sights(orientations, first, cell, area, arrives, math.prod(coarse))
