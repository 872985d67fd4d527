"""Clearance from a prior model (knowledge = "mesh"): exact by FCL near it, a distance lattice where that decides."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import fcl
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid
from planning.paths import kernels, mesh_kernels
from planning.paths.fields import NO_SPHERES, VoxelField, paired, sphere_rows

EXACT_BAND_M = 4.0
"""The lattice's distances are exact up to here, and below the truth by less than a voxel's diagonal beyond."""
PROBE_M = 1e-3
FINER = 2
"""How many times closer the points of a finer lattice lie."""
INSIDE = -1.0
"""Lattice value of places inside the model."""


def voxelised(vertices_enu_m: Array, faces: NDArray[np.int64], lower_enu_m: Array, upper_enu_m: Array,
              voxel_m: float) -> VoxelGrid:
    """A mesh as a map of the box lower..upper: voxels that its surface touches, and those that it shuts off from the
    top of the box (its inside, and what lies under the ground), are occupied, all others are free."""
    triangles = np.asarray(vertices_enu_m, dtype=np.float64)[faces]
    grid = VoxelGrid.unknown(lower_enu_m, upper_enu_m, voxel_m)
    above = np.maximum(upper_enu_m, [-np.inf, -np.inf, float(triangles[..., 2].max()) + 2.0 * voxel_m])
    taller = VoxelGrid.unknown(lower_enu_m, above, voxel_m)
    parts, _ = ndimage.label(~_touched(triangles, taller))
    open_parts = np.unique(parts[:, :, -1])
    free = np.isin(parts, open_parts[open_parts > 0])[:, :, :grid.state.shape[2]]
    grid.state[:] = np.where(free, FREE, OCCUPIED)
    return grid


@dataclass(frozen=True)
class MeshField:
    """A triangle mesh in a box, and spheres. Inside the mesh and outside the box counts as solid.

    Which side of the surface a point is on is known from voxels: within one voxel's diagonal of the surface a point may
    count as inside that is not.
    """

    distance: NDArray[np.float32]
    """(nx + 2, ny + 2, nz + 2) metres from lattice points to the surface, never more than true; INSIDE there; 0 in
    voxels that the surface touches and outside the box."""
    origin: Array
    """(3,) the first lattice point, ENU metres."""
    voxel_m: float
    spheres: Array
    """(m, 4) centre and radius."""
    triangles: Array
    """(m, 3, 3) of the whole mesh."""
    surface: Any
    """FCL's bounding volume hierarchy of the triangles."""

    @classmethod
    def from_mesh(cls, vertices_enu_m: Array, faces: NDArray[np.int64], grid: VoxelGrid) -> MeshField:
        """vertices (n, 3), triangles (m, 3), and the same mesh `voxelised`."""
        triangles = np.ascontiguousarray(np.asarray(vertices_enu_m, dtype=np.float64)[faces])
        voxels = VoxelField.from_grid(grid)
        inner = (slice(1, -1),) * 3
        first = grid.origin_enu_m + 0.5 * grid.voxel_m
        near = np.full(grid.state.shape, EXACT_BAND_M, dtype=np.float32)
        mesh_kernels.lower_by_triangles(near, triangles, first, grid.voxel_m, EXACT_BAND_M)
        near = np.minimum(np.maximum(near, voxels.distance[inner]), _to_border(grid.state.shape, grid.voxel_m))
        touched = _touched(triangles, grid)
        near[grid.state != FREE] = INSIDE
        near[touched] = 0.0
        distance = np.zeros(voxels.distance.shape, dtype=np.float32)
        distance[inner] = near
        return cls(distance, voxels.origin, grid.voxel_m, NO_SPHERES, triangles, _hierarchy(vertices_enu_m, faces))

    def finer(self, lower_enu_m: Array, upper_enu_m: Array, exact_m: float) -> MeshField:
        """As ObstacleField says."""
        voxel, (low, high) = self.voxel_m / FINER, self._box
        lower, upper = np.maximum(lower_enu_m, low), np.minimum(upper_enu_m, high)
        shape = tuple(int(n) for n in np.maximum(1, np.floor((upper - lower) / voxel + 1e-9)))
        first = lower + 0.5 * voxel
        near = np.full(shape, exact_m, dtype=np.float32)
        mesh_kernels.lower_by_triangles(near, self.triangles, first, voxel, exact_m)
        mesh_kernels.mark_inside(near, first, voxel, self.distance, self.origin, self.voxel_m, INSIDE)
        distance = np.pad(np.minimum(near, _to_border(shape, voxel)), 1)
        return replace(self, distance=distance, origin=first - voxel, voxel_m=voxel)

    def with_spheres(self, centers_enu_m: Array, radius_m: Array | float) -> MeshField:
        """As ObstacleField says."""
        return replace(self, spheres=np.concatenate([self.spheres, sphere_rows(centers_enu_m, radius_m)]))

    def clearance_m(self, points_enu_m: Array) -> Array:
        """As ObstacleField says; exact within EXACT_BAND_M of the surface."""
        points = np.ascontiguousarray(points_enu_m, dtype=np.float64).reshape(-1, 3)
        least = kernels.clearances(points, self.distance, self.origin, self.voxel_m, NO_SPHERES)
        for m in np.flatnonzero(least < EXACT_BAND_M - self.voxel_m):
            least[m] = max(least[m], self._exact(points[m]))
        if len(self.spheres):
            gap = np.linalg.norm(points[:, None] - self.spheres[None, :, :3], axis=2) - self.spheres[:, 3]
            least = np.clip(gap.min(axis=1), 0.0, least)
        return np.asarray(least)

    def segments_clear(self, a_enu_m: Array, b_enu_m: Array, clearance_m: float) -> NDArray[np.bool_]:
        """As ObstacleField says; where the lattice does not decide, FCL sweeps a sphere along the segment."""
        a, b = paired(a_enu_m, b_enu_m)
        clear = kernels.segments_clear(a, b, clearance_m, self.distance, self.origin, self.voxel_m, self.spheres)
        open_ends = self._in_the_box(a, clearance_m) & self._in_the_box(b, clearance_m)
        open_ends &= kernels.clear_of_spheres(a, b, clearance_m, self.spheres)
        open_ends &= ~clear
        open_ends[open_ends] = ~kernels.surely_blocked(a[open_ends], b[open_ends], clearance_m, self.distance,
                                                       self.origin, self.voxel_m)
        for m in np.flatnonzero(open_ends):
            clear[m] = not self._touches(a[m], b[m], clearance_m) and self._outside(a[m], clearance_m)
        return np.asarray(clear)

    def _exact(self, point: Array) -> float:
        """Metres to the surface or the box; 0 inside."""
        if not self._in_the_box(point[None], 0.0)[0]:
            return 0.0
        probe = fcl.CollisionObject(fcl.Sphere(PROBE_M), fcl.Transform(point))
        gap = max(0.0, float(fcl.distance(probe, self.surface, fcl.DistanceRequest(), fcl.DistanceResult())) + PROBE_M)
        lower, upper = self._box
        return min(gap, float(np.minimum(point - lower, upper - point).min())) if self._outside(point, gap) else 0.0

    def _touches(self, a: Array, b: Array, radius_m: float) -> bool:
        length = float(np.linalg.norm(b - a))
        capsule = fcl.CollisionObject(fcl.Capsule(radius_m, length), fcl.Transform(_along(b - a), 0.5 * (a + b)))
        return bool(fcl.collide(capsule, self.surface, fcl.CollisionRequest(), fcl.CollisionResult()))

    def _outside(self, point: Array, gap_m: float) -> bool:
        """Whether a point that is known to be gap_m away from the surface is outside: lattice points within that gap
        are on the same side."""
        first = np.floor((point - self.origin) / self.voxel_m).astype(int)
        corners = np.clip(first + CORNERS, 0, np.array(self.distance.shape) - 1)
        away = np.linalg.norm(self.origin + corners * self.voxel_m - point, axis=1)
        value = self.distance[tuple(corners.T)]
        return bool(np.any((away <= gap_m) & (value > 0.0)))

    def _in_the_box(self, points: Array, margin_m: float) -> NDArray[np.bool_]:
        lower, upper = self._box
        return np.asarray(np.all((points >= lower + margin_m) & (points <= upper - margin_m), axis=1))

    @property
    def _box(self) -> tuple[Array, Array]:
        half = 0.5 * self.voxel_m
        return self.origin + half, self.origin + self.voxel_m * (np.array(self.distance.shape) - 1) - half


CORNERS = np.array([(i, j, k) for i in range(2) for j in range(2) for k in range(2)])


def _touched(triangles: Array, grid: VoxelGrid) -> NDArray[np.bool_]:
    touched = np.zeros(grid.state.shape, dtype=np.bool_)
    mesh_kernels.touched_voxels(np.ascontiguousarray(triangles, dtype=np.float64), grid.origin_enu_m, grid.voxel_m,
                                touched)
    return touched


def _to_border(shape: tuple[int, ...], voxel_m: float) -> NDArray[np.float32]:
    """Metres from voxel centres to the nearest face of the grid's box."""
    steps = [np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5 for n in shape]
    nearest = np.minimum(np.minimum(steps[0][:, None, None], steps[1][None, :, None]), steps[2][None, None, :])
    return np.asarray(nearest * voxel_m, dtype=np.float32)


def _hierarchy(vertices_enu_m: Array, faces: NDArray[np.int64]) -> Any:
    model = fcl.BVHModel()
    model.beginModel(len(vertices_enu_m), len(faces))
    model.addSubModel(np.ascontiguousarray(vertices_enu_m, dtype=np.float64), np.ascontiguousarray(faces))
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform())


def _along(direction: Array) -> Array:
    """(3, 3) rotation that turns z into a direction."""
    length = math.sqrt(float(direction @ direction))
    if length == 0.0:
        return np.eye(3)
    z = direction / length
    side = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(side, z)
    x /= math.sqrt(float(x @ x))
    return np.stack([x, np.cross(z, x), z], axis=1)
