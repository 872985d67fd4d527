"""The map: what all pictures together say about every voxel, as integer sums so that their order does not matter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from missions.camera import Camera
from missions.frames import Array
from missions.grid import FREE, OCCUPIED, UNKNOWN, SurfaceVoxels, VoxelGrid
from perception.depth.depth_map import DepthMap
from perception.mapping import carving, normals
from perception.mapping.adrift import adrift

QUANTUM = 1024
"""Sub-voxel positions and directions are summed as integers of 1 / QUANTUM."""


@dataclass(frozen=True)
class MapSettings:
    """When a voxel counts as free or occupied."""

    sensing_range_m: float = 25.0
    """Depth beyond this makes no surface and carves no further."""
    sky_range_m: float = 20.0
    """Rays into open sky, or past all that could be near, carve this far."""
    margin_voxels: float = 1.0
    """Carving stops this far before the surface, plus margin_sigmas of depth noise."""
    margin_sigmas: float = 2.0
    min_confidence: float = 0.1
    """Least confidence of a pixel that makes surface."""
    min_hit_pixels: int = 2
    """Pixels of one picture that a voxel needs to count as hit by it; fewer only count against free."""
    min_swept: float = 0.4
    """Share of a voxel's cross-section that one picture must sweep to count as seeing it free."""
    free_swept: float = 1.2
    """Cross-sections, summed over pictures with at most one each, that must be swept to call a voxel free: never one
    picture alone, for a single picture may look past a cable that it failed to match."""
    occupied_pictures: int = 2
    """Hit pictures that an occupied voxel needs ..."""
    occupied_share: float = 0.2
    """... and the share, of all pictures that measured it, of those with a point in it."""
    erase_share: float = 0.08
    """A voxel once hit becomes free only when the share of hits is below this."""
    speck_voxels: int = 8
    """Unknown voxels that hang together in at most this number, with known-free space all around, are taken for free:
    what is solid hangs on something, and a stray depth is the likelier cause."""


@dataclass(frozen=True)
class Evidence:
    """What one depth map says of the voxels, by flat number."""

    hit: NDArray[np.int64]
    """(n,) with points in them."""
    offset: NDArray[np.int64]
    """(n, 3) sum of where in the voxel the points are, in 1 / QUANTUM."""
    view: NDArray[np.int64]
    """(n, 3) likewise of the directions that they were seen from."""
    pixels: NDArray[np.int32]
    """(n,) points."""
    free: NDArray[np.int64]
    """(m,) seen to be free."""
    area: NDArray[np.int32]
    """(m,) how much of their cross-section was swept, in 1 / AREA_UNIT."""
    span: tuple[NDArray[np.int64], NDArray[np.int64]] | None
    """First and last + 1 index of the part of the grid that it concerns."""


class VoxelMap:
    """Free, occupied and unknown space inside a box, from depth maps with poses."""

    def __init__(self, lower_enu_m: Array, upper_enu_m: Array, voxel_m: float,
                 settings: MapSettings | None = None) -> None:
        self._blank = VoxelGrid.unknown(np.asarray(lower_enu_m, float), np.asarray(upper_enu_m, float), voxel_m)
        self.settings = settings or MapSettings()
        shape = self._blank.state.shape
        size = int(np.prod(shape))
        self.free_pictures = np.zeros(shape, np.int32)
        self.hit_pictures = np.zeros(shape, np.int32)
        self.touched_pictures = np.zeros(shape, np.int32)
        """Pictures with at least one measured point in the voxel; too few for a surface, but enough to doubt free."""
        self.hit_pixels = np.zeros(shape, np.int32)
        self._declared_free = np.zeros(shape, np.bool_)
        self._offset_sum = np.zeros((size, 3), np.int64)
        self._view_sum = np.zeros((size, 3), np.int64)
        self._free_area = np.zeros(shape, np.int32)
        self._reached = np.array(shape), np.zeros(3, np.int64)
        """First and last + 1 index of the part of the grid that any evidence concerns."""
        self._latest: VoxelGrid | None = None

    def integrate(self, depth: DepthMap, sign: int = 1) -> None:
        """Adds a depth map's evidence; sign = -1 takes exactly the same evidence out again."""
        self.add(self.evidence(depth), sign)

    def evidence(self, depth: DepthMap) -> Evidence:
        """What a depth map says. Changes nothing, so that several threads may ask at a time."""
        direction, forward = _rays(depth)
        start = np.array(depth.pose.position_enu_m)
        hit, offset, view, pixels = self._hits(depth, start, direction, forward)
        reach = self._free_until(depth, forward)
        use = reach > 0
        ray_area = forward[use] ** 3 / (depth.camera.fx_px * depth.camera.fy_px)
        origin, voxel = self._blank.origin_enu_m, self._blank.voxel_m
        swept, touched = np.zeros(self._blank.state.shape, np.int32), np.empty(self._blank.state.size, np.int64)
        count = carving.trace((start - origin) / voxel, direction[use], reach[use] / voxel, ray_area, swept, touched)
        touched = touched[:count]
        swept.reshape(-1)[hit] = 0  # what is hit was not seen to be free
        area = np.minimum(swept.reshape(-1)[touched], carving.AREA_UNIT)
        free = area >= self.settings.min_swept * carving.AREA_UNIT
        span = self._span(np.concatenate([touched, hit]))
        return Evidence(hit, offset, view, pixels, touched[free], area[free], span)

    def add(self, evidence: Evidence, sign: int) -> None:
        """Adds it, or takes it out (-1)."""
        e = evidence
        for total, values in ((self._offset_sum, e.offset), (self._view_sum, e.view)):
            total[e.hit] += sign * values
        self.hit_pixels.reshape(-1)[e.hit] += sign * e.pixels
        self.hit_pictures.reshape(-1)[e.hit[e.pixels >= self.settings.min_hit_pixels]] += sign
        self.touched_pictures.reshape(-1)[e.hit] += sign
        self.free_pictures.reshape(-1)[e.free] += sign
        self._free_area.reshape(-1)[e.free] += sign * e.area
        if e.span is not None:
            self._reach(*e.span)

    def _span(self, flat: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
        """First and last + 1 index of voxels; None of none."""
        if not len(flat):
            return None
        index = np.stack(np.unravel_index(flat, self._blank.state.shape))
        return index.min(axis=1), index.max(axis=1) + 1

    def mark_free(self, lower_enu_m: Array, upper_enu_m: Array) -> None:
        """Declares every voxel that touches the box free: a take-off column, a place flown through."""
        low = np.maximum(self._blank.index(np.asarray(lower_enu_m, float)), 0)
        high = np.maximum(self._blank.index(np.asarray(upper_enu_m, float)) + 1, 0)
        self._declared_free[low[0]:high[0], low[1]:high[1], low[2]:high[2]] = True
        self._reach(low, high)

    def hold_free(self, known: VoxelGrid, from_enu_m: Array, to_enu_m: Array, radius_m: float) -> None:
        """What an earlier map knew to be free within radius_m of a straight way (3,) to (3,) stays so until it is seen
        to be solid."""
        low = np.maximum(known.index(np.minimum(from_enu_m, to_enu_m) - radius_m), 0)
        high = np.maximum(known.index(np.maximum(from_enu_m, to_enu_m) + radius_m) + 1, 0)
        box = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
        voxels = np.argwhere((known.state[box] == FREE) & ~self._declared_free[box]) + low
        offset, way = known.centers(voxels) - from_enu_m, to_enu_m - from_enu_m
        share = np.clip(offset @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
        near = voxels[np.linalg.norm(offset - share[:, None] * way, axis=1) <= radius_m]
        if len(near):
            self._declared_free[tuple(near.T)] = True
            self._reach(near.min(axis=0), near.max(axis=0) + 1)

    def grid(self) -> VoxelGrid:
        """The map as planning sees it, not to be written to."""
        if self._latest is None:
            low, high = np.maximum(self._reached[0] - 1, 0), self._reached[1] + 1
            box = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
            state = self._blank.state.copy()
            if state[box].size:
                state[box] = self._state(box)
            self._latest = VoxelGrid(self._blank.origin_enu_m, self._blank.voxel_m, state)
        return self._latest

    def _state(self, box: tuple[slice, ...]) -> NDArray[np.uint8]:
        """What is known in a part of the grid."""
        s, touched = self.settings, self.touched_pictures[box]
        share = touched / np.maximum(touched + self.free_pictures[box], 1)
        occupied = (self.hit_pictures[box] >= s.occupied_pictures) & (share >= s.occupied_share)
        free = self._free_area[box] >= s.free_swept * carving.AREA_UNIT
        free &= share < s.erase_share
        state = np.where(occupied, OCCUPIED, np.where(free | self._declared_free[box], FREE, UNKNOWN)).astype(np.uint8)
        state[specks(state, s.speck_voxels)] = FREE
        return state

    def _reach(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        """There is new evidence from voxel low to before voxel high."""
        self._reached = np.minimum(self._reached[0], low), np.maximum(self._reached[1], high)
        self._latest = None

    def surface(self) -> SurfaceVoxels:
        """One row per occupied voxel: mean point, outward normal, number of pictures that measured it."""
        state = self.grid().state
        flat, point = self._measured()
        index = np.stack(np.unravel_index(flat, state.shape), axis=-1)
        normal = normals.estimate(index, point, self._view_sum[flat].astype(float), state.shape)
        return SurfaceVoxels(point, normal, self.hit_pictures.reshape(-1)[flat].astype(np.int64))

    def surface_points(self) -> Array:
        """(n, 3) mean point of each occupied voxel: `surface` without normals, which take longest."""
        return self._measured()[1]

    def adrift(self) -> NDArray[np.bool_]:
        """(n,) which of `surface_points` hang in the air by themselves (`perception.mapping.adrift`)."""
        state = self.grid().state
        flat = np.flatnonzero(state == OCCUPIED)
        return adrift(flat, state.shape, self.free_pictures.reshape(-1)[flat])

    def _measured(self) -> tuple[NDArray[np.int64], Array]:
        """(n,) flat index of every occupied voxel and (n, 3) its mean point."""
        grid = self.grid()
        flat = np.flatnonzero(grid.state == OCCUPIED)
        count = np.maximum(self.hit_pixels.reshape(-1)[flat], 1)
        mean = self._offset_sum[flat] / (count[:, None] * QUANTUM)
        index = np.stack(np.unravel_index(flat, grid.state.shape), axis=-1)
        return flat, grid.origin_enu_m + (index + mean) * grid.voxel_m

    def _free_until(self, depth: DepthMap, forward: Array) -> Array:
        """(n,) distance along each ray that the depth map proves free."""
        s = self.settings
        z, sigma = depth.depth_m.reshape(-1).astype(float), depth.sigma_m().reshape(-1).astype(float)
        margin, open_ = s.margin_voxels * self._blank.voxel_m, depth.sky | depth.beyond
        seen = np.minimum((z - s.margin_sigmas * sigma) / forward - margin, s.sensing_range_m)
        result: Array = np.where(depth.valid.reshape(-1), seen, np.where(open_.reshape(-1), s.sky_range_m, 0.0))
        return result

    def _hits(self, depth: DepthMap, start: Array, direction: Array, forward: Array) -> tuple[NDArray[Any], ...]:
        """The first four of `Evidence`."""
        s = self.settings
        distance = depth.depth_m.reshape(-1) / forward
        use = depth.valid.reshape(-1) & (distance <= s.sensing_range_m)
        use &= depth.confidence.reshape(-1) >= s.min_confidence
        cell = (start + direction[use] * distance[use, None] - self._blank.origin_enu_m) / self._blank.voxel_m
        index = np.floor(cell).astype(np.int64)
        inside = self._blank.inside(index)
        index, cell, towards = index[inside], cell[inside], -direction[use][inside]
        flat = np.ravel_multi_index(tuple(index.T), self._blank.state.shape)
        voxels, inverse, pixels = np.unique(flat, return_inverse=True, return_counts=True)
        sums = [np.stack([np.bincount(inverse, quantised[:, axis], len(voxels)).astype(np.int64) for axis in range(3)],
                         axis=1) for quantised in (np.round(value * QUANTUM) for value in (cell - index, towards))]
        return voxels, *sums, pixels.astype(np.int32)


def _rays(depth: DepthMap) -> tuple[Array, Array]:
    """(n, 3) unit directions in ENU of all pixels, and (n,) their component along the optical axis."""
    local, forward = _camera_rays(depth.camera)
    return local @ depth.pose.enu_from_camera.T, forward


@lru_cache(maxsize=4)
def _camera_rays(camera: Camera) -> tuple[Array, Array]:
    """As `_rays`, in the camera's axes."""
    local = camera.rays_camera().reshape(-1, 3)
    length = np.linalg.norm(local, axis=1)
    return local / length[:, None], 1.0 / length


def specks(state: NDArray[np.uint8], voxels: int) -> NDArray[np.bool_]:
    """Which voxels belong to groups (26 neighbours) of at most so many unknown ones inside known-free space."""
    group, _ = ndimage.label(state != FREE, np.ones((3, 3, 3)))
    size = np.bincount(group.ravel())
    solid = np.bincount(group.ravel(), (state == OCCUPIED).ravel(), len(size)) > 0
    small = (size <= voxels) & ~solid
    small[0] = False
    result: NDArray[np.bool_] = small[group]
    return result
