"""The map: what all pictures together say about every voxel, as integer sums so that their order does not matter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from missions.frames import Array
from missions.grid import FREE, OCCUPIED, UNKNOWN, SurfaceVoxels, VoxelGrid
from perception.depth.depth_map import DepthMap
from perception.mapping import carving, normals

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
        self._swept = np.zeros(shape, np.int32)
        self._touched = np.zeros(size, np.int64)
        self._reached = np.array(shape), np.zeros(3, np.int64)
        """First and last + 1 index of the part of the grid that any evidence concerns."""
        self._latest: VoxelGrid | None = None

    def integrate(self, depth: DepthMap, sign: int = 1) -> None:
        """Adds a depth map's evidence; sign = -1 takes exactly the same evidence out again."""
        direction, forward = _rays(depth)
        start = np.array(depth.pose.position_enu_m)
        hit = self._add_hits(depth, start, direction, forward, sign)
        reach = self._free_until(depth, forward)
        use = reach > 0
        area = forward[use] ** 3 / (depth.camera.fx_px * depth.camera.fy_px)
        origin, voxel = self._blank.origin_enu_m, self._blank.voxel_m
        count = carving.trace((start - origin) / voxel, direction[use], reach[use] / voxel, area,
                              self._swept, self._touched)
        self._add_free(self._touched[:count], hit, sign)
        for flat in (self._touched[:count], hit):
            if len(flat):
                index = np.stack(np.unravel_index(flat, self._blank.state.shape))
                self._reach(index.min(axis=1), index.max(axis=1) + 1)

    def mark_free(self, lower_enu_m: Array, upper_enu_m: Array) -> None:
        """Declares every voxel that touches the box free: a take-off column, a place flown through."""
        low = np.maximum(self._blank.index(np.asarray(lower_enu_m, float)), 0)
        high = np.maximum(self._blank.index(np.asarray(upper_enu_m, float)) + 1, 0)
        self._declared_free[low[0]:high[0], low[1]:high[1], low[2]:high[2]] = True
        self._reach(low, high)

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

    def _add_free(self, touched: NDArray[np.int64], hit: NDArray[np.int64], sign: int) -> None:
        """Adds what one picture swept, except in voxels that it hit, and clears the scratch array."""
        swept = self._swept.reshape(-1)
        area = np.minimum(swept[touched], carving.AREA_UNIT)
        swept[touched] = 0
        counts = (area >= self.settings.min_swept * carving.AREA_UNIT) & ~np.isin(touched, hit)
        self.free_pictures.reshape(-1)[touched[counts]] += sign
        self._free_area.reshape(-1)[touched[counts]] += sign * area[counts]

    def _add_hits(self, depth: DepthMap, start: Array, direction: Array, forward: Array,
                  sign: int) -> NDArray[np.int64]:
        """Sums up the measured points; flat indices of the voxels that this picture hit."""
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
        for total, value in ((self._offset_sum, cell - index), (self._view_sum, towards)):
            quantised = np.round(value * QUANTUM)
            for axis in range(3):
                total[voxels, axis] += sign * np.bincount(inverse, quantised[:, axis], len(voxels)).astype(np.int64)
        self.hit_pixels.reshape(-1)[voxels] += sign * pixels.astype(np.int32)
        self.hit_pictures.reshape(-1)[voxels[pixels >= s.min_hit_pixels]] += sign
        self.touched_pictures.reshape(-1)[voxels] += sign
        result: NDArray[np.int64] = voxels
        return result


def _rays(depth: DepthMap) -> tuple[Array, Array]:
    """(n, 3) unit directions in ENU of all pixels, and (n,) their component along the optical axis."""
    local = depth.camera.rays_camera().reshape(-1, 3)
    length = np.linalg.norm(local, axis=1)
    return (local / length[:, None]) @ depth.pose.enu_from_camera.T, 1.0 / length


def specks(state: NDArray[np.uint8], voxels: int) -> NDArray[np.bool_]:
    """Which voxels belong to groups (26 neighbours) of at most so many unknown ones inside known-free space."""
    group, _ = ndimage.label(state != FREE, np.ones((3, 3, 3)))
    size = np.bincount(group.ravel())
    solid = np.bincount(group.ravel(), (state == OCCUPIED).ravel(), len(size)) > 0
    small = (size <= voxels) & ~solid
    small[0] = False
    result: NDArray[np.bool_] = small[group]
    return result
