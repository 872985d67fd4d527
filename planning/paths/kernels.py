"""Compiled inner loops: distance to solid voxels, clearance at points and along segments."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array

HALF_DIAGONAL = 0.5 * math.sqrt(3.0)
LEAST_STEP_M = 0.05
"""A piece of a segment that is this short and still not proven clear counts as blocked: at 1 m, 0.3 mm are lost."""


@njit(cache=True)  # type: ignore[untyped-decorator]
def distance_to_solid(solid: NDArray[np.bool_], reach: int) -> NDArray[np.float32]:
    """From every voxel's centre to the nearest solid voxel's surface, in voxels, capped at reach.

    Exact up to the cap: along each axis the gap to a cube n voxels away is max(n - 1/2, 0), squares add up, so one
    pass per axis suffices (after Felzenszwalb and Huttenlocher, "Distance transforms of sampled functions", 2012).
    """
    nx, ny, nz = solid.shape
    cap = np.float32(reach * reach)
    gap = np.empty(reach + 1, np.float32)
    for n in range(reach + 1):
        gap[n] = max(n - 0.5, 0.0) ** 2
    first = np.empty((nx, ny, nz), np.float32)
    for i in range(nx):
        for j in range(ny):
            _sweep_line(solid[i, j], first[i, j], reach, gap, cap)
    second = np.empty((nx, ny, nz), np.float32)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                best = first[i, j, k]
                for r in range(1, reach + 1):
                    if gap[r] >= best:
                        break
                    if j >= r:
                        best = min(best, first[i, j - r, k] + gap[r])
                    if j + r < ny:
                        best = min(best, first[i, j + r, k] + gap[r])
                second[i, j, k] = best
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                best = second[i, j, k]
                for r in range(1, reach + 1):
                    if gap[r] >= best:
                        break
                    if i >= r:
                        best = min(best, second[i - r, j, k] + gap[r])
                    if i + r < nx:
                        best = min(best, second[i + r, j, k] + gap[r])
                first[i, j, k] = math.sqrt(best)
    return first


@njit(cache=True)  # type: ignore[untyped-decorator]
def _sweep_line(solid: NDArray[np.bool_], out: NDArray[np.float32], reach: int, gap: NDArray[np.float32],
                cap: np.float32) -> None:
    n = solid.shape[0]
    since = reach + 1
    for k in range(n):
        since = 0 if solid[k] else since + 1
        out[k] = gap[since] if since <= reach else cap
    since = reach + 1
    for k in range(n - 1, -1, -1):
        since = 0 if solid[k] else since + 1
        if since <= reach:
            out[k] = min(out[k], gap[since])


@njit(cache=True)  # type: ignore[untyped-decorator]
def _mean_square(distance: NDArray[np.float32], i: int, j: int, k: int, fx: float, fy: float, fz: float, di: int,
                 dj: int) -> float:
    """Squares of the distances at the corners of the simplex around a point, weighted so that their mean is the point.

    The six simplices of a cube share one of its diagonals (Freudenthal), which begins at corner (di, dj, 0). Whichever
    diagonal, the corners' weighted squared distances from the point add up to f (1 - f) over the axes.
    """
    x, y, z = (1.0 - fx if di else fx), (1.0 - fy if dj else fy), fz
    first, last = max(x, y, z), min(x, y, z)
    middle = x + y + z - first - last
    a, b, c = di, dj, 0
    room = max(0.0, distance[i + a, j + b, k + c])
    total = (1.0 - first) * room * room
    for step in range(3):
        bound = first if step == 0 else (middle if step == 1 else last)
        if x == bound:
            a, x = 1 - di, -1.0
        elif y == bound:
            b, y = 1 - dj, -1.0
        else:
            c, z = 1, -1.0
        room = max(0.0, distance[i + a, j + b, k + c])
        after = middle if step == 0 else (last if step == 1 else 0.0)
        total += (bound - after) * room * room
    return float(total)


@njit(cache=True, inline="never")  # type: ignore[untyped-decorator]
def clearance_at(x: float, y: float, z: float, distance: NDArray[np.float32], origin: Array, voxel: float,
                 spheres: Array) -> float:
    """Metres to the nearest solid voxel or sphere (x, y, z, radius), never more than true; 0 outside the grid.

    distance[i, j, k] holds at origin + (i, j, k) * voxel. Two bounds from below follow from the eight samples around a
    point, and the better one is taken. The distance changes by at most the distance moved. And for weights w_n of
    samples n whose mean is the point p, every obstacle point q has (parallel axis theorem)
    |q - p|^2 = sum w_n |q - n|^2 - sum w_n |p - n|^2.
    """
    gx, gy, gz = (x - origin[0]) / voxel, (y - origin[1]) / voxel, (z - origin[2]) / voxel
    nx, ny, nz = distance.shape
    if not (0.0 <= gx < nx - 1 and 0.0 <= gy < ny - 1 and 0.0 <= gz < nz - 1):
        return 0.0
    i, j, k = int(gx), int(gy), int(gz)
    fx, fy, fz = gx - i, gy - j, gz - k
    best, squares = 0.0, 0.0
    for di in range(2):
        for dj in range(2):
            squares = max(squares, _mean_square(distance, i, j, k, fx, fy, fz, di, dj))
            for dk in range(2):
                away = math.sqrt((fx - di) ** 2 + (fy - dj) ** 2 + (fz - dk) ** 2)
                best = max(best, distance[i + di, j + dj, k + dk] - away * voxel)
    squares -= voxel * voxel * (fx * (1.0 - fx) + fy * (1.0 - fy) + fz * (1.0 - fz))
    if squares > best * best:
        best = math.sqrt(squares)
    for m in range(spheres.shape[0]):
        dx, dy, dz = x - spheres[m, 0], y - spheres[m, 1], z - spheres[m, 2]
        room = best + spheres[m, 3]
        squared = dx * dx + dy * dy + dz * dz
        if squared < room * room:
            best = max(0.0, math.sqrt(squared) - spheres[m, 3])
    return best


@njit(cache=True)  # type: ignore[untyped-decorator]
def clearances(points: Array, distance: NDArray[np.float32], origin: Array, voxel: float, spheres: Array) -> Array:
    """clearance_at for points (n, 3)."""
    out = np.empty(points.shape[0])
    for m in range(points.shape[0]):
        out[m] = clearance_at(points[m, 0], points[m, 1], points[m, 2], distance, origin, voxel, spheres)
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def clear_of_spheres(a: Array, b: Array, need: float, spheres: Array) -> NDArray[np.bool_]:
    """Whether segments from a (n, 3) to b (n, 3) keep `need` from spheres (m, 4)."""
    out = np.ones(a.shape[0], np.bool_)
    for n in range(a.shape[0]):
        span = b[n] - a[n]
        squared = span[0] ** 2 + span[1] ** 2 + span[2] ** 2
        for m in range(spheres.shape[0]):
            x, y, z = spheres[m, 0] - a[n, 0], spheres[m, 1] - a[n, 1], spheres[m, 2] - a[n, 2]
            f = (x * span[0] + y * span[1] + z * span[2]) / squared if squared > 0.0 else 0.0
            f = min(1.0, max(0.0, f))
            gap = (x - f * span[0]) ** 2 + (y - f * span[1]) ** 2 + (z - f * span[2]) ** 2
            if gap < (need + spheres[m, 3]) ** 2:
                out[n] = False
                break
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def segment_clear(ax: float, ay: float, az: float, bx: float, by: float, bz: float, need: float,
                  distance: NDArray[np.float32], origin: Array, voxel: float, spheres: Array) -> bool:
    """Whether the clearance along a segment is proven to stay at `need` or more at every point of it, not at samples
    alone: walks ahead as far as two clearances prove all between them. Who needs none gets through anything."""
    length = math.sqrt((bx - ax) ** 2 + (by - ay) ** 2 + (bz - az) ** 2)
    room = clearance_at(ax, ay, az, distance, origin, voxel, spheres)
    done = 0.0
    while room >= need and done < length and need > 0.0:
        step = max(2.0 * math.sqrt(room * room - need * need), LEAST_STEP_M)
        while True:
            ahead = min(length, done + step)
            f = ahead / length
            there = clearance_at(ax + f * (bx - ax), ay + f * (by - ay), az + f * (bz - az), distance, origin, voxel,
                                 spheres)
            if there >= need and chord_clear(room, there, ahead - done, need):
                break
            step = 0.5 * (ahead - done)
            if step < LEAST_STEP_M:
                return False
        room, done = there, ahead
    return bool(room >= need)


@njit(cache=True)  # type: ignore[untyped-decorator]
def chord_clear(room_a: float, room_b: float, length: float, need: float) -> bool:
    """Whether clearances at the ends of a segment, both at least `need`, prove `need` all along it.

    An obstacle point lies outside of both balls around the ends; nearest to the segment it lies on both spheres, at
    the height of the triangle with these sides.
    """
    foot = (room_a * room_a - room_b * room_b + length * length) / (2.0 * length) if length > 0.0 else 0.0
    return bool(foot <= 0.0 or foot >= length or room_a * room_a - foot * foot >= need * need)


@njit(cache=True)  # type: ignore[untyped-decorator]
def surely_blocked(a: Array, b: Array, need: float, distance: NDArray[np.float32], origin: Array,
                   voxel: float) -> NDArray[np.bool_]:
    """Whether segments from a (n, 3) to b (n, 3) certainly come nearer than `need`. Distances above 0 must be exact
    up to `need`; 0 is a voxel that the surface touches, less than 0 is inside."""
    out, node = np.zeros(a.shape[0], np.bool_), np.empty(3, np.int64)
    shape = distance.shape
    for n in range(a.shape[0]):
        length = math.sqrt((b[n, 0] - a[n, 0]) ** 2 + (b[n, 1] - a[n, 1]) ** 2 + (b[n, 2] - a[n, 2]) ** 2)
        count = int(length / (0.5 * voxel)) + 1
        for m in range(count + 1):
            away = 0.0
            for axis in range(3):
                g = (a[n, axis] + (b[n, axis] - a[n, axis]) * m / count - origin[axis]) / voxel
                node[axis] = min(max(0, round(g)), shape[axis] - 1)
                away += (g - node[axis]) ** 2
            room = distance[node[0], node[1], node[2]]
            most = room if room > 0.0 else (0.0 if room < 0.0 else HALF_DIAGONAL * voxel)
            if most + math.sqrt(away) * voxel < need:
                out[n] = True
                break
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def segments_clear(a: Array, b: Array, need: float, distance: NDArray[np.float32], origin: Array, voxel: float,
                   spheres: Array) -> NDArray[np.bool_]:
    """segment_clear for many segments, a and b (n, 3)."""
    out = np.empty(a.shape[0], np.bool_)
    for m in range(a.shape[0]):
        out[m] = segment_clear(a[m, 0], a[m, 1], a[m, 2], b[m, 0], b[m, 1], b[m, 2], need, distance, origin, voxel,
                               spheres)
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def lower_by_spheres(clearance: NDArray[np.float32], origin: Array, voxel: float, spheres: Array,
                     margin: float) -> None:
    """Take spheres into account at the voxel centres within `margin` of them, in place."""
    for m in range(spheres.shape[0]):
        reach = spheres[m, 3] + margin
        lo, hi = np.empty(3, np.int64), np.empty(3, np.int64)
        for axis in range(3):
            lo[axis] = max(0, math.floor((spheres[m, axis] - reach - origin[axis]) / voxel))
            top = math.ceil((spheres[m, axis] + reach - origin[axis]) / voxel) + 1
            hi[axis] = min(clearance.shape[axis], top)
        for i in range(lo[0], hi[0]):
            for j in range(lo[1], hi[1]):
                for k in range(lo[2], hi[2]):
                    dx, dy, dz = (origin[0] + i * voxel - spheres[m, 0], origin[1] + j * voxel - spheres[m, 1],
                                  origin[2] + k * voxel - spheres[m, 2])
                    gap = math.sqrt(dx * dx + dy * dy + dz * dz) - spheres[m, 3]
                    clearance[i, j, k] = max(0.0, min(clearance[i, j, k], gap))
