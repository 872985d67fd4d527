"""Where the obstacles are: fields that know the clearance at any point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid
from planning.paths import kernels

REACH_M = 8.0
"""Clearances beyond this are reported as this much; no decision depends on more."""
NO_SPHERES = np.zeros((0, 4))


class ObstacleField(Protocol):
    """Anything that knows how far the nearest obstacle is."""

    @property
    def distance(self) -> NDArray[np.float32]:
        """(nx + 2, ny + 2, nz + 2) metres from the points of a lattice to the nearest obstacle but for the spheres,
        never more than true; the first and last layers lie outside of what is known."""

    @property
    def origin(self) -> Array:
        """(3,) the lattice's first point, ENU metres."""

    @property
    def voxel_m(self) -> float:
        """The lattice's step."""

    @property
    def spheres(self) -> Array:
        """(m, 4) centres and radii of spheres that are obstacles too."""

    def with_spheres(self, centers_enu_m: Array, radius_m: Array | float) -> Self:
        """The same field with spheres (m, 3) of one radius or (m,) radii added: sensor hits, teammates."""

    def finer(self, ends_enu_m: Array, around_m: float, clearance_m: float) -> Self | None:
        """The same obstacles in the box around two ends (2, 3) with a finer lattice, which may show a way between them
        that keeps clearance_m; None where nothing finer is known or there certainly is no such way there."""

    def clearance_m(self, points_enu_m: Array) -> Array:
        """(n,) metres from points (n, 3) to the nearest obstacle; never more than true."""

    def segments_clear(self, a_enu_m: Array, b_enu_m: Array, clearance_m: float) -> NDArray[np.bool_]:
        """(n,) whether the clearance along each segment from a (n, 3) to b (n, 3) stays at least clearance_m."""

    def lattice_verdicts(self, a_enu_m: Array, b_enu_m: Array,
                         clearance_m: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """As segments_clear, from the lattice alone: (n,) whether each segment is clear, and (n,) whether only a closer
        look can tell."""


@dataclass(frozen=True)
class VoxelField:
    """A voxel map and spheres. Solid cubes are taken whole; what is not known to be free counts as solid."""

    distance: NDArray[np.float32]
    """(nx + 2, ny + 2, nz + 2) metres from voxel centres to the nearest solid cube, one solid layer around."""
    origin: Array
    """(3,) centre of the first of these voxels, ENU metres."""
    voxel_m: float
    spheres: Array
    """(m, 4) centre and radius."""

    @classmethod
    def from_grid(cls, grid: VoxelGrid, *, unknown_is_solid: bool = True) -> VoxelField:
        """The field of a map. Outside the grid is unknown and solid in any case."""
        solid = np.ones(np.array(grid.state.shape) + 2, dtype=np.bool_)
        solid[1:-1, 1:-1, 1:-1] = grid.state != FREE if unknown_is_solid else grid.state == OCCUPIED
        reach = max(1, math.ceil(REACH_M / grid.voxel_m))
        distance = kernels.distance_to_solid(solid, reach) * np.float32(grid.voxel_m)
        return cls(distance, np.asarray(grid.origin_enu_m - 0.5 * grid.voxel_m), grid.voxel_m, NO_SPHERES)

    def with_spheres(self, centers_enu_m: Array, radius_m: Array | float) -> VoxelField:
        """As ObstacleField says."""
        return replace(self, spheres=np.concatenate([self.spheres, sphere_rows(centers_enu_m, radius_m)]))

    def finer(self, ends_enu_m: Array, around_m: float, clearance_m: float) -> None:
        """As ObstacleField says: nothing finer than the voxels is known."""

    def clearance_m(self, points_enu_m: Array) -> Array:
        """As ObstacleField says."""
        points = np.ascontiguousarray(points_enu_m, dtype=np.float64).reshape(-1, 3)
        return np.asarray(kernels.clearances(points, *self._arrays))

    def segments_clear(self, a_enu_m: Array, b_enu_m: Array, clearance_m: float) -> NDArray[np.bool_]:
        """As ObstacleField says."""
        a, b = paired(a_enu_m, b_enu_m)
        return np.asarray(kernels.segments_clear(a, b, clearance_m, *self._arrays))

    def lattice_verdicts(self, a_enu_m: Array, b_enu_m: Array,
                         clearance_m: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """As ObstacleField says: the lattice decides all."""
        clear = self.segments_clear(a_enu_m, b_enu_m, clearance_m)
        return clear, np.zeros_like(clear)

    @property
    def _arrays(self) -> tuple[Any, ...]:
        return self.distance, self.origin, self.voxel_m, self.spheres


def paired(a: Array, b: Array) -> tuple[Array, Array]:
    """Ends of segments as two arrays (n, 3); a single point belongs to all of the other's."""
    a = np.ascontiguousarray(a, dtype=np.float64).reshape(-1, 3)
    b = np.ascontiguousarray(b, dtype=np.float64).reshape(-1, 3)
    return np.ascontiguousarray(np.broadcast_to(a, (max(len(a), len(b)), 3))), \
        np.ascontiguousarray(np.broadcast_to(b, (max(len(a), len(b)), 3)))


def sphere_rows(centers_enu_m: Array, radius_m: Array | float) -> Array:
    """(m, 4) centre and radius of spheres (m, 3) of one radius or (m,) radii."""
    centers = np.asarray(centers_enu_m, dtype=np.float64).reshape(-1, 3)
    radii = np.broadcast_to(np.asarray(radius_m, dtype=np.float64), (len(centers),))
    return np.ascontiguousarray(np.column_stack([centers, radii]))
