"""Which pictures show which part of the map: every picture keeps a coarse depth image of the voxels before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from missions.live import LivePicture

ACROSS = 48
"""Cells of a depth image, from left to right."""
DEEPER_VOXELS = 2.0
"""A voxel is shown when it lies no more than this behind the nearest in its cell."""
MOST_CELLS = 5
"""A near voxel covers up to so many cells each way."""


@dataclass(frozen=True)
class _Shown:
    """Of points (n, 3) before a camera: their distances along its axis, and the rows and columns of their cells."""

    which: NDArray[np.int64]
    depth_m: Array
    row: NDArray[np.int64]
    column: NDArray[np.int64]


class PictureDepth:
    """One picture's view of the map."""

    def __init__(self, picture: LivePicture, voxel_m: float, range_m: float) -> None:
        self.picture, self._voxel_m, self._range_m = picture, voxel_m, range_m
        camera = picture.camera
        rows = max(1, round(ACROSS * camera.height_px / camera.width_px))
        self._camera: Camera = camera.scaled(ACROSS, rows)
        self._nearest_m = np.full((rows, ACROSS), np.inf)

    def draw(self, centers_enu_m: Array) -> None:
        """These voxels are solid."""
        seen = self._project(centers_enu_m)
        cells = np.clip(np.ceil(self._voxel_m * self._camera.fx_px / seen.depth_m), 1, MOST_CELLS).astype(np.int64)
        for size in range(1, MOST_CELLS + 1):
            near = cells >= size
            for row, column in _ring(size):
                np.minimum.at(self._nearest_m, (np.clip(seen.row[near] + row, 0, len(self._nearest_m) - 1),
                                                np.clip(seen.column[near] + column, 0, ACROSS - 1)),
                              seen.depth_m[near])

    def shows(self, points_enu_m: Array) -> NDArray[np.bool_]:
        """(n,) which points of the map's surface the picture shows."""
        seen = self._project(points_enu_m)
        result = np.zeros(len(points_enu_m), dtype=np.bool_)
        limit = self._nearest_m[seen.row, seen.column] + DEEPER_VOXELS * self._voxel_m
        result[seen.which] = seen.depth_m <= limit
        return result

    def distance_m(self, point_enu_m: Array) -> float:
        """From the camera."""
        return float(np.linalg.norm(np.array(self.picture.pose.position_enu_m) - point_enu_m))

    def _project(self, points_enu_m: Array) -> _Shown:
        pose, camera = self.picture.pose, self._camera
        local = (points_enu_m - np.array(pose.position_enu_m)) @ pose.enu_from_camera
        depth = local[:, 2]
        ahead = (depth > 0.5 * self._voxel_m) & (depth < self._range_m)
        safe = np.where(ahead, depth, 1.0)
        column = np.floor(local[:, 0] / safe * camera.fx_px + camera.cx_px).astype(np.int64)
        row = np.floor(local[:, 1] / safe * camera.fy_px + camera.cy_px).astype(np.int64)
        rows, columns = self._nearest_m.shape
        which = np.flatnonzero(ahead & (column >= 0) & (column < columns) & (row >= 0) & (row < rows))
        return _Shown(which, depth[which], row[which], column[which])


class Sightings:
    """How many pictures show each voxel, and which show a point. A voxel that comes to stand before others later does
    not take back what was counted."""

    def __init__(self) -> None:
        self._depths: list[PictureDepth] = []
        self._keys = np.zeros(0, dtype=np.int64)
        self.count = np.zeros((0, 2), dtype=np.int64)
        """(n, 2) pictures that show each voxel: all, and the survey's."""

    def take(self, index: NDArray[np.int64], centers_enu_m: Array, pictures: list[LivePicture], voxel_m: float,
             ranges_m: dict[str, float]) -> None:
        """The map is now these voxels: (n, 3) indices in rising order, and their centres. pictures: all so far;
        ranges_m: by phase, how far pictures show something."""
        keys = (index[:, 0] << 42) + (index[:, 1] << 21) + index[:, 2]
        count = np.zeros((len(keys), 2), dtype=np.int64)
        kept = np.isin(keys, self._keys, assume_unique=True)
        count[kept] = self.count[np.searchsorted(self._keys, keys[kept])]
        fresh = np.flatnonzero(~kept)
        for depth in self._depths:
            if len(fresh):
                depth.draw(centers_enu_m[fresh])
                _add(count, fresh, depth, centers_enu_m)
        everything = np.arange(len(index))
        for picture in pictures[len(self._depths):]:
            depth = PictureDepth(picture, voxel_m, ranges_m[picture.phase])
            depth.draw(centers_enu_m)
            _add(count, everything, depth, centers_enu_m)
            self._depths.append(depth)
        self._keys, self.count = keys, count

    def seen_by(self, point_enu_m: Array) -> list[LivePicture]:
        """Pictures that show a point of the surface, the nearest first."""
        found = [d for d in self._depths if d.shows(point_enu_m[None])[0]]
        return [d.picture for d in sorted(found, key=lambda d: d.distance_m(point_enu_m))]


def _add(count: NDArray[np.int64], rows: NDArray[np.int64], depth: PictureDepth, centers_enu_m: Array) -> None:
    shown = rows[depth.shows(centers_enu_m[rows])]
    count[shown, 0] += 1
    count[shown, 1] += depth.picture.phase == "survey"


def _ring(size: int) -> list[tuple[int, int]]:
    """Cells that a square of `size` has beyond one of `size - 1`, around its middle."""
    def square(n: int) -> set[tuple[int, int]]:
        first = -((n - 1) // 2)
        return {(i, j) for i in range(first, first + n) for j in range(first, first + n)}

    return sorted(square(size) - (square(size - 1) if size > 1 else set()))
