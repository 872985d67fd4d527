"""Clearance from a prior model (knowledge = "mesh"): exact by FCL near it, a distance lattice where that decides."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import fcl
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid
from planning.paths import kernels, mesh_kernels, search_kernels
from planning.paths.fields import NO_SPHERES, VoxelField, paired, sphere_rows

EXACT_BAND_M = 4.0
"""The lattice's distances are exact up to here, and below the truth by less than a voxel's diagonal beyond."""
EXACT_SPARE_M = 0.2
"""A finer lattice is exact up to this much more than the clearance asked for."""
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

    def finer(self, ends_enu_m: Array, around_m: float, clearance_m: float) -> MeshField | None:
        """As ObstacleField says; exact up to a little beyond the clearance."""
        voxel, exact, (low, high) = self.voxel_m / FINER, clearance_m + EXACT_SPARE_M, self._box
        lower = np.maximum(ends_enu_m.min(axis=0) - around_m, low)
        upper = np.minimum(ends_enu_m.max(axis=0) + around_m, high)
        if self._walled_off(ends_enu_m, (lower, upper), clearance_m):
            return None
        shape = tuple(int(n) for n in np.maximum(1, np.floor((upper - lower) / voxel + 1e-9)))
        first = lower + 0.5 * voxel
        near = np.full(shape, exact, dtype=np.float32)
        mesh_kernels.cap(near, first, voxel, self.distance, self.origin, self.voxel_m)
        mesh_kernels.lower_by_triangles(near, self.triangles, first, voxel, exact)
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
        near = np.flatnonzero((least < EXACT_BAND_M - self.voxel_m) & self._in_the_box(points, 0.0))
        least[near] = np.maximum(least[near], self._exact(points[near]))
        if len(self.spheres):
            gap = np.linalg.norm(points[:, None] - self.spheres[None, :, :3], axis=2) - self.spheres[:, 3]
            least = np.clip(gap.min(axis=1), 0.0, least)
        return np.asarray(least)

    def segments_clear(self, a_enu_m: Array, b_enu_m: Array, clearance_m: float) -> NDArray[np.bool_]:
        """As ObstacleField says; where the lattice does not decide, FCL sweeps a sphere along the segment."""
        a, b = paired(a_enu_m, b_enu_m)
        clear, undecided = self.lattice_verdicts(a, b, clearance_m)
        clear[undecided] = self._swept_clear(a[undecided], b[undecided], clearance_m)
        return clear

    def lattice_verdicts(self, a_enu_m: Array, b_enu_m: Array,
                         clearance_m: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """As ObstacleField says."""
        a, b = paired(a_enu_m, b_enu_m)
        clear = kernels.segments_clear(a, b, clearance_m, self.distance, self.origin, self.voxel_m, self.spheres)
        undecided = ~clear & self._in_the_box(a, clearance_m) & self._in_the_box(b, clearance_m)
        undecided[undecided] = kernels.clear_of_spheres(a[undecided], b[undecided], clearance_m, self.spheres)
        undecided[undecided] = ~kernels.surely_blocked(a[undecided], b[undecided], clearance_m, self.distance,
                                                       self.origin, self.voxel_m)
        return clear, undecided

    def _exact(self, points: Array) -> Array:
        """(n,) metres from points in the box to the surface or the box; 0 inside."""
        gap = np.empty(len(points))
        for m, point in enumerate(points):
            probe = fcl.CollisionObject(fcl.Sphere(PROBE_M), fcl.Transform(point))
            gap[m] = fcl.distance(probe, self.surface, fcl.DistanceRequest(), fcl.DistanceResult()) + PROBE_M
        gap = np.maximum(gap, 0.0)
        lower, upper = self._box
        border = np.minimum(points - lower, upper - points).min(axis=1)
        return np.where(self._outside(points, gap), np.minimum(gap, border), 0.0)

    def _swept_clear(self, a: Array, b: Array, clearance_m: float) -> NDArray[np.bool_]:
        """(n,) whether a sphere swept from a to b (n, 3) touches nothing, outside of what is solid."""
        clear, lengths = np.empty(len(a), dtype=np.bool_), np.linalg.norm(b - a, axis=1)
        for m, (turn, middle) in enumerate(zip(mesh_kernels.turned_to(b - a), 0.5 * (a + b), strict=True)):
            capsule = fcl.CollisionObject(fcl.Capsule(clearance_m, lengths[m]), fcl.Transform(turn, middle))
            clear[m] = not fcl.collide(capsule, self.surface, fcl.CollisionRequest(), fcl.CollisionResult())
        return clear & self._outside(a, np.full(len(a), clearance_m))

    def _outside(self, points: Array, gap_m: Array) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3) that are known to be gap_m (n,) away from the surface are outside: lattice points
        within that gap are on the same side."""
        return np.asarray(mesh_kernels.outside(points, gap_m, self.distance, self.origin, self.voxel_m))

    def _walled_off(self, ends_enu_m: Array, box_enu_m: tuple[Array, Array], clearance_m: float) -> bool:
        """Whether certainly no way between two ends (2, 3) in a box keeps a clearance: the centres of the voxels that
        it leads through would keep it but for half a voxel's diagonal."""
        half_diagonal = kernels.HALF_DIAGONAL * self.voxel_m
        least = clearance_m - half_diagonal - PROBE_M
        if not half_diagonal < least < EXACT_BAND_M:
            return False
        nodes = np.round((np.concatenate([box_enu_m, ends_enu_m]) - self.origin) / self.voxel_m).astype(np.int64)
        first, last = nodes[0], nodes[1] + 1
        room = self.distance[tuple(slice(a, b) for a, b in zip(first, last, strict=True))].copy()
        start, goal = np.ravel_multi_index(tuple((nodes[2:] - first).T), room.shape)[:, None]
        return not search_kernels.connected(room, least, start, goal)

    def _in_the_box(self, points: Array, margin_m: float) -> NDArray[np.bool_]:
        lower, upper = self._box
        return np.asarray(np.all((points >= lower + margin_m) & (points <= upper - margin_m), axis=1))

    @property
    def _box(self) -> tuple[Array, Array]:
        half = 0.5 * self.voxel_m
        return self.origin + half, self.origin + self.voxel_m * (np.array(self.distance.shape) - 1) - half


def _touched(triangles: Array, grid: VoxelGrid) -> NDArray[np.bool_]:
    touched = np.zeros(grid.state.shape, dtype=np.bool_)
    mesh_kernels.touched_voxels(np.ascontiguousarray(triangles, dtype=np.float64), grid.origin_enu_m, grid.voxel_m,
                                touched)
    return touched


def _to_border(shape: tuple[int, ...], voxel_m: float) -> NDArray[np.float32]:
    """Metres from voxel centres to the nearest face of the grid's box."""
    steps = [(np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5).astype(np.float32) for n in shape]
    nearest = np.minimum(np.minimum(steps[0][:, None, None], steps[1][None, :, None]), steps[2][None, None, :])
    return np.asarray(nearest * np.float32(voxel_m))


def _hierarchy(vertices_enu_m: Array, faces: NDArray[np.int64]) -> Any:
    model = fcl.BVHModel()
    model.beginModel(len(vertices_enu_m), len(faces))
    model.addSubModel(np.ascontiguousarray(vertices_enu_m, dtype=np.float64), np.ascontiguousarray(faces))
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform())
