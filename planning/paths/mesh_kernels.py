"""Compiled inner loops over triangles: which voxels they touch, and how far voxel centres nearby lie from them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array
from planning.paths.kernels import HALF_DIAGONAL

TOUCH_M = 1e-6
"""Triangles this near to a voxel touch it."""


@njit(cache=True)  # type: ignore[untyped-decorator]
def touched_voxels(triangles: Array, origin: Array, voxel: float, touched: NDArray[np.bool_]) -> None:
    """Mark the voxels that triangles (m, 3, 3) touch; voxel (i, j, k) begins at origin + (i, j, k) * voxel."""
    for m in range(triangles.shape[0]):
        a, b, c = triangles[m, 0], triangles[m, 1], triangles[m, 2]
        lo, hi = _voxels_around(a, b, c, origin, voxel, TOUCH_M, touched.shape)
        for i in range(lo[0], hi[0]):
            for j in range(lo[1], hi[1]):
                for k in range(lo[2], hi[2]):
                    if not touched[i, j, k]:
                        x, y, z = (origin[0] + (i + 0.5) * voxel, origin[1] + (j + 0.5) * voxel,
                                   origin[2] + (k + 0.5) * voxel)
                        touched[i, j, k] = _meets_cube(a, b, c, x, y, z, 0.5 * voxel + TOUCH_M)


@njit(cache=True)  # type: ignore[untyped-decorator]
def lower_by_triangles(distance: NDArray[np.float32], triangles: Array, origin: Array, voxel: float,
                       band: float) -> None:
    """Lower distance[i, j, k], which holds at origin + (i, j, k) * voxel, to the distance to the nearest of the
    triangles (m, 3, 3) where that is less than band."""
    corner = origin - 0.5 * voxel
    for m in range(triangles.shape[0]):
        a, b, c = triangles[m, 0], triangles[m, 1], triangles[m, 2]
        lo, hi = _voxels_around(a, b, c, corner, voxel, band, distance.shape)
        low = np.minimum(np.minimum(a, b), c)
        top = np.maximum(np.maximum(a, b), c)
        for i in range(lo[0], hi[0]):
            x = origin[0] + i * voxel
            gx = max(low[0] - x, 0.0, x - top[0])
            for j in range(lo[1], hi[1]):
                y = origin[1] + j * voxel
                gy = max(low[1] - y, 0.0, y - top[1])
                left = band * band - gx * gx - gy * gy
                if left <= 0.0:
                    continue
                reach = math.sqrt(left)
                first = max(lo[2], math.floor((low[2] - reach - origin[2]) / voxel))
                for k in range(first, min(hi[2], math.ceil((top[2] + reach - origin[2]) / voxel) + 1)):
                    z = origin[2] + k * voxel
                    gz = max(low[2] - z, 0.0, z - top[2])
                    known = distance[i, j, k]
                    if gx * gx + gy * gy + gz * gz < known * known:
                        distance[i, j, k] = min(known, _distance(a, b, c, x, y, z))


@njit(cache=True)  # type: ignore[untyped-decorator]
def mark_inside(distance: NDArray[np.float32], origin: Array, voxel: float, known: NDArray[np.float32],
                known_origin: Array, known_voxel: float, inside: float) -> None:
    """Set distance to `inside` where no point of a coarser lattice that is known to be outside (above 0) lies within
    the distance: those that do are on the same side of the surface."""
    for i in range(distance.shape[0]):
        for j in range(distance.shape[1]):
            for k in range(distance.shape[2]):
                x, y, z = ((origin[0] + i * voxel - known_origin[0]) / known_voxel,
                           (origin[1] + j * voxel - known_origin[1]) / known_voxel,
                           (origin[2] + k * voxel - known_origin[2]) / known_voxel)
                squared = (distance[i, j, k] / known_voxel) ** 2
                if not _near_outside(x, y, z, squared, known):
                    distance[i, j, k] = inside


@njit(cache=True)  # type: ignore[untyped-decorator]
def outside(points: Array, gap: Array, distance: NDArray[np.float32], origin: Array, voxel: float) -> NDArray[np.bool_]:
    """(n,) whether some of the eight lattice points around each of the points (n, 3) that are known to be outside
    (above 0) lie within its gap (n,)."""
    out = np.empty(points.shape[0], np.bool_)
    for m in range(points.shape[0]):
        out[m] = _near_outside((points[m, 0] - origin[0]) / voxel, (points[m, 1] - origin[1]) / voxel,
                               (points[m, 2] - origin[2]) / voxel, (gap[m] / voxel) ** 2, distance)
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _near_outside(x: float, y: float, z: float, squared: float, known: NDArray[np.float32]) -> bool:
    nx, ny, nz = known.shape
    for corner in range(8):
        a, b, c = (int(x) + (corner & 1), int(y) + (corner >> 1 & 1), int(z) + (corner >> 2))
        if a < nx and b < ny and c < nz and known[a, b, c] > 0.0 \
                and (x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2 <= squared:
            return True
    return False


@njit(cache=True)  # type: ignore[untyped-decorator]
def cap(distance: NDArray[np.float32], origin: Array, voxel: float, known: NDArray[np.float32], known_origin: Array,
        known_voxel: float) -> None:
    """Lower distance[i, j, k], which holds at origin + (i, j, k) * voxel, to the most that the nearest point of a
    coarser lattice allows. 0 is a voxel that the surface touches there, less than 0 is inside and allows anything."""
    first, step = (origin - known_origin) / known_voxel, voxel / known_voxel
    for i in range(distance.shape[0]):
        a, x = _nearest(first[0] + i * step, known.shape[0])
        for j in range(distance.shape[1]):
            b, y = _nearest(first[1] + j * step, known.shape[1])
            for k in range(distance.shape[2]):
                c, z = _nearest(first[2] + k * step, known.shape[2])
                room = known[a, b, c]
                if room >= 0.0:
                    away = known_voxel * math.sqrt(x * x + y * y + z * z)
                    most = (room if room > 0.0 else HALF_DIAGONAL * known_voxel) + away + TOUCH_M
                    distance[i, j, k] = min(distance[i, j, k], most)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _nearest(place: float, count: int) -> tuple[int, float]:
    """The whole number below count that is nearest to a place, 0 at least, and how far off the place is."""
    whole = min(max(0, math.floor(place + 0.5)), count - 1)
    return whole, place - whole


@njit(cache=True)  # type: ignore[untyped-decorator]
def turned_to(directions: Array) -> Array:
    """(n, 3, 3) rotations that turn z into directions (n, 3); some rotation for a direction of no length."""
    out = np.empty((directions.shape[0], 3, 3))
    for m in range(directions.shape[0]):
        length = math.sqrt(directions[m, 0] ** 2 + directions[m, 1] ** 2 + directions[m, 2] ** 2)
        z = directions[m] / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
        side = np.zeros(3)
        side[np.argmin(np.abs(z))] = 1.0
        x = np.cross(side, z)
        x /= math.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
        out[m, :, 0], out[m, :, 1], out[m, :, 2] = x, np.cross(z, x), z
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _voxels_around(a: Array, b: Array, c: Array, origin: Array, voxel: float, margin: float,
                   shape: tuple[int, int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    lo, hi = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        low, top = min(a[axis], b[axis], c[axis]) - margin, max(a[axis], b[axis], c[axis]) + margin
        lo[axis] = max(0, math.floor((low - origin[axis]) / voxel))
        hi[axis] = min(shape[axis], math.floor((top - origin[axis]) / voxel) + 1)
    return lo, hi


@njit(cache=True)  # type: ignore[untyped-decorator]
def _meets_cube(a: Array, b: Array, c: Array, x: float, y: float, z: float, half: float) -> bool:
    """Separating axes (Akenine-Moeller, "Fast 3D triangle-box overlap testing", 2001); the cube's own three axes are
    left to the caller, who walks the triangle's bounding box."""
    v = np.empty((3, 3))
    for axis in range(3):
        center = x if axis == 0 else (y if axis == 1 else z)
        v[0, axis], v[1, axis], v[2, axis] = a[axis] - center, b[axis] - center, c[axis] - center
    e0, e1 = v[1] - v[0], v[2] - v[1]
    nx, ny, nz = (e0[1] * e1[2] - e0[2] * e1[1], e0[2] * e1[0] - e0[0] * e1[2], e0[0] * e1[1] - e0[1] * e1[0])
    if abs(nx * v[0, 0] + ny * v[0, 1] + nz * v[0, 2]) > half * (abs(nx) + abs(ny) + abs(nz)):
        return False
    for m in range(3):
        e = v[(m + 1) % 3] - v[m]
        for axis in range(3):
            p, q = (axis + 1) % 3, (axis + 2) % 3
            radius = half * (abs(e[p]) + abs(e[q]))
            s0, s1, s2 = (e[p] * v[0, q] - e[q] * v[0, p], e[p] * v[1, q] - e[q] * v[1, p],
                          e[p] * v[2, q] - e[q] * v[2, p])
            if min(s0, s1, s2) > radius or max(s0, s1, s2) < -radius:
                return False
    return True


@njit(cache=True)  # type: ignore[untyped-decorator]
def _distance(a: Array, b: Array, c: Array, x: float, y: float, z: float) -> float:
    """Point to triangle (Ericson, "Real-Time Collision Detection", 2005, section 5.1.5)."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    px, py, pz = x - a[0], y - a[1], z - a[2]
    d1, d2 = abx * px + aby * py + abz * pz, acx * px + acy * py + acz * pz
    along = abx * acx + aby * acy + abz * acz
    d3, d4 = d1 - (abx * abx + aby * aby + abz * abz), d2 - along
    d5, d6 = d1 - along, d2 - (acx * acx + acy * acy + acz * acz)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        v, w = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif d6 >= 0.0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w = d1 / (d1 - d3), 0.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        whole = va + vb + vc
        v, w = vb / whole, vc / whole
    dx, dy, dz = px - v * abx - w * acx, py - v * aby - w * acy, pz - v * abz - w * acz
    return math.sqrt(dx * dx + dy * dy + dz * dz)
