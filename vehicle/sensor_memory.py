"""What the vehicle knows of space: the ground's map, what its own range sensor swept free, and what it hit."""

from __future__ import annotations

import math
import zlib

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array
from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from missions.messages import RangeScan, SiteBrief, Vector, vector
from missions.mission import Mission
from missions.pads import fence_limit, takeoff_columns
from missions.sensors import HIT_RADIUS_M, RANGE_DIRECTIONS
from planning.deconflict import distance_to_polyline_m
from planning.paths import MeshField, ObstacleField, VoxelField

HIT_CELL_M = 0.25
HIT_MEMORY_NS = 120_000_000_000
FORGET_EVERY_NS = 10_000_000_000
CORNERS = np.array([(i, j, k) for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
GROUND_BAND_M = 0.3
"""Hits this low are the ground, which is known: it is the floor of the fence."""
CROP_MARGIN_M = 1.5
ON_FACE_M = 1e-3
"""Hits this near to an occupied voxel belong to it."""


@njit(cache=True)  # type: ignore[untyped-decorator]
def _sweep(position: Array, directions: Array, ranges: Array, reach: float, origin: Array, voxel: float,
           swept: NDArray[np.bool_]) -> None:
    """Mark the voxels that the rays passed, up to one voxel before what they hit."""
    nx, ny, nz = swept.shape
    step = 0.5 * voxel
    for m in range(directions.shape[0]):
        far = min(ranges[m] - voxel, reach)
        t = 0.0
        while t <= far:
            i = math.floor((position[0] + t * directions[m, 0] - origin[0]) / voxel)
            j = math.floor((position[1] + t * directions[m, 1] - origin[1]) / voxel)
            k = math.floor((position[2] + t * directions[m, 2] - origin[2]) / voxel)
            if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
                swept[i, j, k] = True
            t += step


class Sensed(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What a memory holds of its own sensor's, in bytes."""

    cells: bytes
    points_enu_m: bytes
    seen_ns: bytes
    origin_enu_m: Vector
    shape: tuple[int, int, int]
    swept: bytes
    """Packed bits of the grid that begins at the origin, deflated."""


class SensorMemory:
    """A grid over what the geofence may become: map states, voxels swept free, and hits with the time of the last one.

    `map_version` and `hit_version` change whenever map or hits do.
    """

    def __init__(self, lower_enu_m: Array, upper_enu_m: Array, voxel_m: float, reach_m: float,
                 columns: list[tuple[Array, Array]], prior: MeshField | None = None) -> None:
        """columns: boxes (lower, upper) known to be free from the start. prior: the operator's model, which then says
        what is solid and what is free, but for the hits."""
        self._prior = prior
        self._lower, self._upper, self._reach, self._columns = lower_enu_m, upper_enu_m, reach_m, columns
        self.map_version = self.hit_version = 0
        self._keys: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._points: Array = np.zeros((0, 3))
        self._new: Array = np.zeros((0, 3))
        self._untold: Array = np.zeros((0, 3))
        self._seen_ns: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._forget_ns = 0
        self._grid = VoxelGrid.unknown(lower_enu_m, upper_enu_m, voxel_m)
        self._swept: NDArray[np.bool_] = self._columns_swept()

    @classmethod
    def of(cls, mission: Mission, site: SiteBrief, prior: MeshField | None = None) -> SensorMemory:
        """What a vehicle of this mission knows before it takes off."""
        return cls(*fence_limit(mission, site), mission.explore.voxel_m, mission.fleet.range_sensor_m,
                   takeoff_columns(mission, site), prior)

    @property
    def sensed(self) -> Sensed:
        """What the range sensor has hit and swept free."""
        swept = zlib.compress(np.packbits(self._swept).tobytes(), level=1)
        i, j, k = self._swept.shape
        return Sensed(self._keys.tobytes(), self._points.tobytes(), self._seen_ns.tobytes(),
                      vector(self._grid.origin_enu_m), (i, j, k), swept)

    def recall(self, sensed: Sensed) -> None:
        """Know what another memory of this mission knew of that; the map is still to come. Raises ValueError or
        zlib.error for what is not whole."""
        count = math.prod(sensed.shape)
        packed = np.frombuffer(zlib.decompress(sensed.swept), np.uint8)
        swept = np.unpackbits(packed, count=count).astype(np.bool_).reshape(sensed.shape)
        points = np.frombuffer(sensed.points_enu_m).reshape(-1, 3).copy()
        state = np.full(sensed.shape, UNKNOWN, dtype=np.uint8)
        self._grid = VoxelGrid(np.array(sensed.origin_enu_m), self._grid.voxel_m, state)
        self._swept, self._points = swept, points
        self._keys = np.frombuffer(sensed.cells, np.int64).copy()
        self._seen_ns = np.frombuffer(sensed.seen_ns, np.int64).copy()
        self.map_version += 1
        self.hit_version += 1
        self._note_new()

    def put_map(self, grid: VoxelGrid) -> None:
        """Take over the ground's newest map; the fence outside it stays unknown."""
        if grid.voxel_m != self._grid.voxel_m or not self._aligned(grid):
            self._grid = self._covering(grid)
            self._swept = self._columns_swept()
        state = np.full(self._grid.state.shape, UNKNOWN, dtype=np.uint8)
        first = np.round((grid.origin_enu_m - self._grid.origin_enu_m) / grid.voxel_m).astype(int)
        last = first + grid.state.shape
        lo, hi = np.maximum(first, 0), np.minimum(last, state.shape)
        if np.all(hi > lo):
            there = tuple(slice(a, b) for a, b in zip(lo, hi, strict=True))
            here = tuple(slice(a - f, b - f) for a, b, f in zip(lo, hi, first, strict=True))
            state[there] = grid.state[here]
        self._grid = VoxelGrid(self._grid.origin_enu_m, grid.voxel_m, state)
        self.map_version += 1
        self._note_new()

    def put_scan(self, scan: RangeScan, teammates_enu_m: Array, near_teammate_m: float) -> None:
        """Remember a scan. Echoes from teammates (m, 3) are not obstacles: teammates tell where they are."""
        position, ranges = np.array(scan.position_enu_m), np.array(scan.ranges_m)
        grid = self._grid
        _sweep(position, RANGE_DIRECTIONS, ranges, self._reach, grid.origin_enu_m, grid.voxel_m, self._swept)
        echo = np.isfinite(ranges) & (ranges <= self._reach)
        hits = position + RANGE_DIRECTIONS[echo] * ranges[echo, None]
        keep = hits[:, 2] > self._lower[2] + GROUND_BAND_M
        for teammate in teammates_enu_m:
            keep &= np.linalg.norm(hits - teammate, axis=1) > near_teammate_m
        self._remember(hits[keep], scan.t_ns)

    def take_untold(self) -> Array:
        """(n, 3) what has been hit for the first time since this was last asked."""
        untold, self._untold = self._untold, np.zeros((0, 3))
        return untold

    def field(self, a_enu_m: Array, b_enu_m: Array, margin_m: float) -> ObstacleField:
        """The obstacles in the box around a and b, grown by margin_m and some more. Everything outside is solid,
        unless a prior model knows better."""
        grown = margin_m + CROP_MARGIN_M
        lower, upper = np.minimum(a_enu_m, b_enu_m) - grown, np.maximum(a_enu_m, b_enu_m) + grown
        near = self._new[np.all((self._new >= lower) & (self._new <= upper), axis=1)]
        if self._prior is not None:
            return self._prior.with_spheres(near, HIT_RADIUS_M)
        grid, shape = self._grid, np.array(self._grid.state.shape)
        lo = np.clip(grid.index(lower), 0, shape - 1)
        hi = np.clip(grid.index(upper) + 1, lo + 1, shape)
        crop = tuple(slice(p, q) for p, q in zip(lo, hi, strict=True))
        state = np.where(self._swept[crop] & (grid.state[crop] == UNKNOWN), FREE, grid.state[crop]).astype(np.uint8)
        part = VoxelGrid(grid.origin_enu_m + lo * grid.voxel_m, grid.voxel_m, state)
        return VoxelField.from_grid(part).with_spheres(near, HIT_RADIUS_M)

    @property
    def ends_at_box(self) -> bool:
        """Whether a `field` of a larger box may show more ways: a prior model is the same in all of them."""
        return self._prior is None

    def hits_clear(self, way_enu_m: Array, clearance_m: float) -> bool:
        """Whether a polyline (k, 3) keeps this distance from all that the sensor has hit and the map does not hold."""
        lower, upper = way_enu_m.min(axis=0) - clearance_m, way_enu_m.max(axis=0) + clearance_m
        near = self._new[np.all((self._new >= lower) & (self._new <= upper), axis=1)]
        return not len(near) or bool(distance_to_polyline_m(near, way_enu_m).min() >= clearance_m)

    def _remember(self, hits: Array, t_ns: int) -> None:
        """Keep one point per cell, in the order of the cells' numbers."""
        cells = np.floor((hits - self._lower) / HIT_CELL_M).astype(np.int64)
        keys, first = np.unique((cells[:, 0] << 40) + (cells[:, 1] << 20) + cells[:, 2], return_index=True)
        place = np.searchsorted(self._keys, keys)
        known = np.zeros(len(keys), dtype=np.bool_)
        inside = place < len(self._keys)
        known[inside] = self._keys[place[inside]] == keys[inside]
        self._seen_ns[place[known]] = t_ns
        if not known.all():
            fresh = ~known
            self._keys = np.insert(self._keys, place[fresh], keys[fresh])
            self._points = np.insert(self._points, place[fresh], hits[first[fresh]], axis=0)
            self._seen_ns = np.insert(self._seen_ns, place[fresh], t_ns)
            self._untold = np.concatenate([self._untold, hits[first[fresh]]])
            self.hit_version += 1
            self._note_new()
        if t_ns >= self._forget_ns:
            self._forget(t_ns)

    def _forget(self, t_ns: int) -> None:
        keep = self._seen_ns >= t_ns - HIT_MEMORY_NS
        if not keep.all():
            self._keys, self._points, self._seen_ns = self._keys[keep], self._points[keep], self._seen_ns[keep]
            self.hit_version += 1
            self._note_new()
        self._forget_ns = t_ns + FORGET_EVERY_NS

    def _note_new(self) -> None:
        """Hits in voxels that the map calls occupied add nothing: those voxels are solid as a whole."""
        new = self._points
        for offset in ON_FACE_M * CORNERS:
            new = new[self._grid.state_at(new + offset) != OCCUPIED]
        self._new = new

    def _columns_swept(self) -> NDArray[np.bool_]:
        grid = self._grid
        swept = np.zeros(grid.state.shape, dtype=np.bool_)
        for lower, upper in self._columns:
            lo = np.clip(np.ceil((lower - grid.origin_enu_m) / grid.voxel_m - 1e-6).astype(int), 0, swept.shape)
            hi = np.clip(np.floor((upper - grid.origin_enu_m) / grid.voxel_m + 1e-6).astype(int), 0, swept.shape)
            swept[lo[0]:hi[0], lo[1]:hi[1], lo[2]:hi[2]] = True
        return swept

    def _aligned(self, grid: VoxelGrid) -> bool:
        offset = (grid.origin_enu_m - self._grid.origin_enu_m) / grid.voxel_m
        return bool(np.abs(offset - np.round(offset)).max() < 1e-6)

    def _covering(self, grid: VoxelGrid) -> VoxelGrid:
        """An unknown grid over the fence in the lattice of this one."""
        before = np.ceil((grid.origin_enu_m - self._lower) / grid.voxel_m - 1e-6)
        return VoxelGrid.unknown(grid.origin_enu_m - before * grid.voxel_m, self._upper, grid.voxel_m)
