"""Compiled inner loops: distance to solid voxels, clearance at points and along segments, search over free voxels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array

LEAST_STEP_M = 0.02
"""Segments are walked in steps of the clearance to spare, at least this. Half of it must be to spare everywhere: what
one step does not prove clear ahead, the next proves behind it."""
AXIS, FACE, CUBE = 29, 41, 50
"""Costs of steps along an axis, a face diagonal and a cube diagonal: sqrt 2 and sqrt 3 within 1 %."""
BUCKETS = 512
"""More than the largest step and the largest cost of a seed."""
NONE = -1


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


@njit(cache=True, inline="never")  # type: ignore[untyped-decorator]
def clearance_at(x: float, y: float, z: float, distance: NDArray[np.float32], origin: Array, voxel: float,
                 spheres: Array) -> float:
    """Metres to the nearest solid voxel or sphere (x, y, z, radius), never more than true; 0 outside the grid.

    distance[i, j, k] holds at origin + (i, j, k) * voxel. The true distance changes by at most the distance moved,
    so each of the eight samples around the point bounds it from below; the best bound is taken.
    """
    gx, gy, gz = (x - origin[0]) / voxel, (y - origin[1]) / voxel, (z - origin[2]) / voxel
    nx, ny, nz = distance.shape
    if not (0.0 <= gx < nx - 1 and 0.0 <= gy < ny - 1 and 0.0 <= gz < nz - 1):
        return 0.0
    i, j, k = int(gx), int(gy), int(gz)
    best = 0.0
    for di in range(2):
        for dj in range(2):
            for dk in range(2):
                away = math.sqrt((gx - i - di) ** 2 + (gy - j - dj) ** 2 + (gz - k - dk) ** 2)
                best = max(best, distance[i + di, j + dj, k + dk] - away * voxel)
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
    """Whether the clearance along a segment is proven to stay at `need` or more, at every point of it: walks ahead by
    the clearance to spare. Who needs none gets through anything."""
    least = 0.5 * LEAST_STEP_M if need > 0.0 else 0.0
    length = math.sqrt((bx - ax) ** 2 + (by - ay) ** 2 + (bz - az) ** 2)
    done = 0.0
    while True:
        f = done / length if length > 0.0 else 0.0
        spare = clearance_at(ax + f * (bx - ax), ay + f * (by - ay), az + f * (bz - az), distance, origin, voxel,
                             spheres) - need
        if spare < (least if length > 0.0 else 0.0):
            return False
        if done >= length:
            return True
        done = min(length, done + max(spare, LEAST_STEP_M))


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
def search(clearance: NDArray[np.float32], need: float, voxel: float, seeds: NDArray[np.int64],
           seed_costs: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.int8]]:
    """Dijkstra over voxel centres with 26 neighbours and integer costs in a ring of buckets (Dial 1969).

    clearance: (nx, ny, nz) metres at the centres; a step of length s is open when the two clearances add up to at
    least 2 need + s, which proves the whole step clear. Returns costs (-1 unreached; AXIS per voxel) and for each
    voxel the index of the step that led there (-1 for seeds).
    """
    nx, ny, nz = clearance.shape
    total = nx * ny * nz
    steps, costs, lengths = _steps(voxel)
    room = clearance.reshape(total)
    cost = np.full(total, -1, np.int32)
    came = np.full(total, -1, np.int8)
    done = np.zeros(total, np.bool_)
    after, before = np.full(total, NONE, np.int32), np.full(total, NONE, np.int32)
    head = np.full(BUCKETS, NONE, np.int32)
    queued = 0
    for m in range(seeds.shape[0]):
        s = seeds[m]
        if cost[s] < 0:
            cost[s] = seed_costs[m]
            _push(s, seed_costs[m] % BUCKETS, head, after, before)
            queued += 1
    now = 0
    while queued > 0:
        u = head[now % BUCKETS]
        if u == NONE:
            now += 1
            continue
        _drop(u, now % BUCKETS, head, after, before)
        queued -= 1
        done[u] = True
        i, j, k = u // (ny * nz), (u // nz) % ny, u % nz
        for d in range(26):
            x, y, z = i + steps[d, 0], j + steps[d, 1], k + steps[d, 2]
            if x < 0 or y < 0 or z < 0 or x >= nx or y >= ny or z >= nz:
                continue
            v = (x * ny + y) * nz + z
            if done[v] or room[v] < need or room[u] + room[v] < 2.0 * need + lengths[d]:
                continue
            c = now + costs[d]
            if cost[v] >= 0 and cost[v] <= c:
                continue
            if cost[v] >= 0:
                _drop(v, cost[v] % BUCKETS, head, after, before)
            else:
                queued += 1
            cost[v], came[v] = c, d
            _push(v, c % BUCKETS, head, after, before)
    return cost.reshape(clearance.shape), came.reshape(clearance.shape)


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


@njit(cache=True)  # type: ignore[untyped-decorator]
def walk_back(came: NDArray[np.int8], i: int, j: int, k: int) -> NDArray[np.int64]:
    """(n, 3) voxels from a seed to this one."""
    steps, _, _ = _steps(1.0)
    n, x, y, z = 1, i, j, k
    while came[x, y, z] >= 0:
        d = came[x, y, z]
        x, y, z, n = x - steps[d, 0], y - steps[d, 1], z - steps[d, 2], n + 1
    out = np.empty((n, 3), np.int64)
    for m in range(n - 1, -1, -1):
        out[m, 0], out[m, 1], out[m, 2] = i, j, k
        d = came[i, j, k]
        if d >= 0:
            i, j, k = i - steps[d, 0], j - steps[d, 1], k - steps[d, 2]
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _steps(voxel: float) -> Any:
    steps, costs, lengths = np.empty((26, 3), np.int64), np.empty(26, np.int64), np.empty(26)
    n = 0
    for i in range(-1, 2):
        for j in range(-1, 2):
            for k in range(-1, 2):
                axes = abs(i) + abs(j) + abs(k)
                if axes > 0:
                    steps[n, 0], steps[n, 1], steps[n, 2] = i, j, k
                    costs[n] = AXIS if axes == 1 else (FACE if axes == 2 else CUBE)
                    lengths[n] = voxel * math.sqrt(axes)
                    n += 1
    return steps, costs, lengths


@njit(cache=True)  # type: ignore[untyped-decorator]
def _push(u: int, bucket: int, head: NDArray[np.int32], after: NDArray[np.int32], before: NDArray[np.int32]) -> None:
    first = head[bucket]
    after[u], before[u] = first, NONE
    if first != NONE:
        before[first] = u
    head[bucket] = u


@njit(cache=True)  # type: ignore[untyped-decorator]
def _drop(u: int, bucket: int, head: NDArray[np.int32], after: NDArray[np.int32], before: NDArray[np.int32]) -> None:
    if before[u] == NONE:
        head[bucket] = after[u]
    else:
        after[before[u]] = after[u]
    if after[u] != NONE:
        before[after[u]] = before[u]
