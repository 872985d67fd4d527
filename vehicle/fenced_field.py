"""Space as it is known, with walls where an uploaded geofence ends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from planning.paths import ObstacleField
from planning.paths.fields import paired
from vehicle.geofence import FENCE_TOLERANCE_M, Geofence

STEP_M = 2.0 * FENCE_TOLERANCE_M
"""A segment is sampled so finely that in between it leaves the fence by less than the tolerance."""


@dataclass(frozen=True, eq=False)
class FencedField:
    """An obstacle field in a fence. The vehicle's centre may come up to the border: the wall is spare_m behind it."""

    inner: ObstacleField
    fence: Geofence
    spare_m: float

    @cached_property
    def distance(self) -> NDArray[np.float32]:
        """As ObstacleField says."""
        inner, out = self.inner, self.inner.distance.copy()
        layer = np.zeros((*out.shape[:2], 3))
        layer[:, :, 0], layer[:, :, 1] = np.indices(out.shape[:2])
        for k in range(out.shape[2]):
            layer[:, :, 2] = k
            points = inner.origin + layer.reshape(-1, 3) * inner.voxel_m
            wall_m = self._wall_m(points).reshape(out.shape[:2])
            out[:, :, k] = np.minimum(out[:, :, k], np.maximum(wall_m, 0.0))
        return out

    @property
    def origin(self) -> Array:
        """As ObstacleField says."""
        return self.inner.origin

    @property
    def voxel_m(self) -> float:
        """As ObstacleField says."""
        return self.inner.voxel_m

    @property
    def spheres(self) -> Array:
        """As ObstacleField says."""
        return self.inner.spheres

    def with_spheres(self, centers_enu_m: Array, radius_m: Array | float) -> FencedField:
        """As ObstacleField says."""
        return FencedField(self.inner.with_spheres(centers_enu_m, radius_m), self.fence, self.spare_m)

    def finer(self, ends_enu_m: Array, around_m: float, clearance_m: float) -> FencedField | None:
        """As ObstacleField says."""
        fine = self.inner.finer(ends_enu_m, around_m, clearance_m)
        return None if fine is None else FencedField(fine, self.fence, self.spare_m)

    def clearance_m(self, points_enu_m: Array) -> Array:
        """As ObstacleField says."""
        points = np.asarray(points_enu_m, dtype=np.float64).reshape(-1, 3)
        return np.minimum(self.inner.clearance_m(points), self._wall_m(points))

    def segments_clear(self, a_enu_m: Array, b_enu_m: Array, clearance_m: float) -> NDArray[np.bool_]:
        """As ObstacleField says."""
        return self.inner.segments_clear(a_enu_m, b_enu_m, clearance_m) & self._inside(a_enu_m, b_enu_m, clearance_m)

    def lattice_verdicts(self, a_enu_m: Array, b_enu_m: Array,
                         clearance_m: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """As ObstacleField says."""
        clear, undecided = self.inner.lattice_verdicts(a_enu_m, b_enu_m, clearance_m)
        inside = self._inside(a_enu_m, b_enu_m, clearance_m)
        return clear & inside, undecided & inside

    def _wall_m(self, points: Array) -> Array:
        return self.fence.room_m(points) + self.spare_m

    def _inside(self, a_enu_m: Array, b_enu_m: Array, clearance_m: float) -> NDArray[np.bool_]:
        a, b = paired(a_enu_m, b_enu_m)
        count = 2 + int(np.linalg.norm(b - a, axis=1).max(initial=0.0) / STEP_M)
        along = np.linspace(0.0, 1.0, count)[None, :, None]
        points = (a[:, None] + along * (b - a)[:, None]).reshape(-1, 3)
        wall_m = self._wall_m(points).reshape(len(a), count).min(axis=1)
        return np.asarray(wall_m >= clearance_m - FENCE_TOLERANCE_M)
