"""What MACARONS knows of a scene while it explores: the surface, and points of space that are carved, seen, judged.

Lengths are metres; the constants are shares of the sensing range, from MACARONS' numbers over its range of 70 units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.frames import Array
from perception.macarons.harmonics import BINS, nearest_bin
from perception.macarons.surface import Cells, Surface

CARVING_TOLERANCE = 10.0 / 70.0
"""Sensing ranges in front of a surface that still count as the surface."""
SOLID_SHARE = 0.95
"""Of the pictures that have a point in view, those that must not see past it."""
VIEW_SPACINGS = 3.0
"""A point counts as seen when it lies less than so many spacings behind the surface."""
FREE_SPACINGS, FREE_LOOKS = 1.5, 3
"""So many pictures must see a point free, so many spacings before what they show, before a vehicle may fly there."""
UNKNOWN_OCCUPANCY = 0.5


@dataclass(frozen=True)
class Look:
    """One depth map: (h, w) depth along the optical axis, metres, inf in the sky; which of it is believed."""

    depth_m: NDArray[np.float32]
    valid: NDArray[np.bool_]
    camera: Camera
    pose: Pose

    def points(self, range_m: float) -> Array:
        """(n, 3) ENU of what is believed and within range."""
        use = self.valid & np.isfinite(self.depth_m) & (self.depth_m < range_m)
        local = self.camera.rays_camera()[use] * self.depth_m[use][:, None].astype(np.float64)
        result: Array = local @ self.pose.enu_from_camera.T + np.array(self.pose.position_enu_m)
        return result

    def signed_m(self, points_enu_m: Array, range_m: float) -> tuple[NDArray[np.int64], Array]:
        """Which points (n, 3) lie in view, within range and on a believed pixel, and how far behind the surface there,
        along the optical axis."""
        number, u, v, z = in_view(points_enu_m, self.camera, self.pose, range_m)
        row, column = v.astype(np.int64), u.astype(np.int64)
        known = self.valid[row, column]
        return number[known], z[known] - self.depth_m[row[known], column[known]]


def in_view(points_enu_m: Array, camera: Camera, pose: Pose, range_m: float) -> tuple[NDArray[np.int64], Array, Array,
                                                                                      Array]:
    """Numbers of the points (n, 3) in the picture and within range, and their pixel coordinates and depths."""
    local = (points_enu_m - np.array(pose.position_enu_m)) @ pose.enu_from_camera
    z = np.maximum(local[:, 2], 1e-6)
    u, v = camera.fx_px * local[:, 0] / z + camera.cx_px, camera.fy_px * local[:, 1] / z + camera.cy_px
    inside = (local[:, 2] > 1e-6) & (u >= 0) & (u < camera.width_px) & (v >= 0) & (v < camera.height_px)
    number = np.flatnonzero(inside & (np.einsum("ij,ij->i", local, local) <= range_m**2))
    return number, u[number], v[number], z[number]


class Field:
    """Surface and proxies of one scene. Equal calls on equal seeds give equal fields."""

    def __init__(self, lower_enu_m: Array, upper_enu_m: Array, range_m: float, proxies: int, seed: int) -> None:
        """proxies: how many points are spread over the box."""
        self._rng = np.random.default_rng([seed, 0x4D4143])
        self.lower_enu_m, self.upper_enu_m, self.range_m = lower_enu_m, upper_enu_m, range_m
        self.cells = Cells.of_box(lower_enu_m, upper_enu_m)
        self.surface = Surface(self.cells)
        self.proxies = self._rng.uniform(lower_enu_m, upper_enu_m, (proxies, 3))
        self.proxy_cell = self.cells.numbers(self.proxies)
        self.spacing_m = float(np.prod(upper_enu_m - lower_enu_m) / proxies) ** (1.0 / 3.0)
        self.looks, self.kept, self.passed = (np.zeros(proxies, dtype=np.int64) for _ in range(3))
        self.nearest_m = np.full(proxies, np.inf)
        self.seen_from = np.zeros((proxies, BINS), dtype=np.bool_)
        self.occupancy = np.full(proxies, UNKNOWN_OCCUPANCY, dtype=np.float32)
        self.changed = np.zeros(self.cells.count, dtype=np.bool_)

    @property
    def diagonal_m(self) -> float:
        """Of the box."""
        return float(np.linalg.norm(self.upper_enu_m - self.lower_enu_m))

    def add(self, look: Look, share: float) -> Array:
        """Take a depth map in; `share` of its points go to the surface. Returns the points that were new to it."""
        points = look.points(self.range_m)
        points = points[self._rng.permutation(len(points))[:round(share * len(points))]]
        new, cells = self.surface.add(points)
        for cell in cells:
            self.changed[self.cells.around(int(cell))] = True
        self._carve(look)
        return new

    def _carve(self, look: Look) -> None:
        number, behind = look.signed_m(self.proxies, self.range_m)
        self.looks[number] += 1
        self.kept[number] += behind >= -CARVING_TOLERANCE * self.range_m
        self.passed[number] += behind < -FREE_SPACINGS * self.spacing_m
        self.nearest_m[number] = np.minimum(self.nearest_m[number], np.abs(behind))
        seen = number[behind < VIEW_SPACINGS * self.spacing_m]
        self.seen_from[seen, nearest_bin(np.array(look.pose.position_enu_m) - self.proxies[seen])] = True
        self.changed[np.unique(self.proxy_cell[seen])] = True

    def solid(self) -> NDArray[np.bool_]:
        """(m,) carving's verdict, which is the pseudo-truth: solid until enough pictures see past a point."""
        return self.kept >= SOLID_SHARE * self.looks

    def open_queries(self) -> NDArray[np.int64]:
        """Proxies that were seen and are not carved: those whose occupancy the network is asked for."""
        return np.flatnonzero((self.looks > 0) & self.solid())

    def settle(self) -> None:
        """Occupancy of what needs no network: carved is 0, never in view UNKNOWN_OCCUPANCY."""
        self.occupancy[self.looks == 0] = UNKNOWN_OCCUPANCY
        self.occupancy[(self.looks > 0) & ~self.solid()] = 0.0

    def blocked(self, start_enu_m: Array, end_enu_m: Array, clearance_m: float) -> int:
        """How much of what is not known to be free lies within clearance of a straight leg: proxies that
        fewer than FREE_LOOKS pictures have seen past, and surface points."""
        proxies = self.proxies[self.passed < FREE_LOOKS]
        return int((_distance(proxies, start_enu_m, end_enu_m) < max(clearance_m, self.spacing_m)).sum()
                   + (_distance(self.surface.points, start_enu_m, end_enu_m) < clearance_m).sum())


def _distance(points: Array, start: Array, end: Array) -> Array:
    """(n,) of points (n, 3) from a segment."""
    way = end - start
    t = np.clip((points - start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
    result: Array = np.linalg.norm(points - start - t[:, None] * way, axis=1)
    return result
