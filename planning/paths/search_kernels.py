"""Compiled inner loops: search over the points of a lattice whose clearances are known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array
from planning.paths.kernels import chord_clear

AXIS, FACE, CUBE = 29, 41, 50
"""Costs of steps along an axis, a face diagonal and a cube diagonal: sqrt 2 and sqrt 3 within 1 %."""
BUCKETS = 512
"""More than the largest step and the largest cost of a seed."""
NONE = -1


@njit(cache=True)  # type: ignore[untyped-decorator]
def search(clearance: NDArray[np.float32], need: float, voxel: float, seeds: NDArray[np.int64],
           seed_costs: NDArray[np.int64], goal: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.int8]]:
    """Dijkstra over lattice points with 26 neighbours and integer costs in a ring of buckets (Dial 1969); towards a
    goal point, given as (i, j, k) instead of an empty array, A* that ends there.

    clearance: (nx, ny, nz) metres at the points; a step is open when those at its ends prove it clear.
    Returns costs (-1 unreached; AXIS per voxel) and for each point the index of the step that led there (-1 for seeds).
    """
    nx, ny, nz = clearance.shape
    total = nx * ny * nz
    steps, costs, lengths = _steps(voxel)
    room = clearance.reshape(total)
    cost = np.full(total, -1, np.int32)
    came = np.full(total, -1, np.int8)
    done = np.zeros(total, np.bool_)
    after, before = np.empty(total, np.int32), np.empty(total, np.int32)
    head = np.full(BUCKETS, NONE, np.int32)
    queued, now = 0, -1
    for m in range(seeds.shape[0]):
        s = seeds[m]
        if cost[s] < 0:
            cost[s] = seed_costs[m]
            key = cost[s] + _ahead(s // (ny * nz), (s // nz) % ny, s % nz, goal)
            now = key if now < 0 else min(now, key)
            _push(s, key % BUCKETS, head, after, before)
            queued += 1
    while queued > 0:
        u = head[now % BUCKETS]
        if u == NONE:
            now += 1
            continue
        i, j, k = u // (ny * nz), (u // nz) % ny, u % nz
        _drop(u, now % BUCKETS, head, after, before)
        queued -= 1
        done[u] = True
        if goal.shape[0] > 0 and i == goal[0] and j == goal[1] and k == goal[2]:
            break
        if room[u] < need:
            continue
        for d in range(26):
            x, y, z = i + steps[d, 0], j + steps[d, 1], k + steps[d, 2]
            if x < 0 or y < 0 or z < 0 or x >= nx or y >= ny or z >= nz:
                continue
            v = (x * ny + y) * nz + z
            c = cost[u] + costs[d]
            if done[v] or room[v] < need or (cost[v] >= 0 and cost[v] <= c):
                continue
            if not chord_clear(room[u], room[v], lengths[d], need):
                continue
            ahead = _ahead(x, y, z, goal)
            if cost[v] >= 0:
                _drop(v, (cost[v] + ahead) % BUCKETS, head, after, before)
            else:
                queued += 1
            cost[v], came[v] = c, d
            _push(v, (c + ahead) % BUCKETS, head, after, before)
    return cost.reshape(clearance.shape), came.reshape(clearance.shape)


@njit(cache=True)  # type: ignore[untyped-decorator]
def connected(clearance: NDArray[np.float32], need: float, seeds: NDArray[np.int64], exits: NDArray[np.int64]) -> bool:
    """Whether some of the seeds and some of the exits, flat indices of lattice points, are the same or hang together
    over neighbours (26) that have `need`.

    Both sides grow in turns, by whole runs of points along the last axis, so that a small closed room shows soon.
    """
    nx, ny, nz = clearance.shape
    side = np.zeros((nx, ny, nz), np.int8)
    runs, done, known = np.empty((2, nx * ny * nz, 2), np.int32), np.zeros(2, np.int64), np.zeros(2, np.int64)
    for s in range(2):
        for u in seeds if s == 0 else exits:
            i, j, k = u // (ny * nz), (u // nz) % ny, u % nz
            if side[i, j, k] == 2 - s:
                return True
            side[i, j, k] = s + 1
            if clearance[i, j, k] >= need:
                runs[s, known[s]] = u, u
                known[s] += 1
    while done[0] < known[0] and done[1] < known[1]:
        for s in range(2):
            u, last = runs[s, done[s]]
            done[s] += 1
            i, j, k, end = u // (ny * nz), (u // nz) % ny, u % nz, last % nz
            for x in range(max(0, i - 1), min(nx, i + 2)):
                for y in range(max(0, j - 1), min(ny, j + 2)):
                    for z in range(max(0, k - 1), min(nz, end + 2)):
                        if side[x, y, z] == s + 1 or clearance[x, y, z] < need:
                            continue
                        if side[x, y, z] != 0:
                            return True
                        line = (x * ny + y) * nz
                        low, top = _claimed(clearance[x, y], side[x, y], z, need, s + 1)
                        runs[s, known[s]] = line + low, line + top
                        known[s] += 1
    return False


@njit(cache=True)  # type: ignore[untyped-decorator]
def _claimed(line: NDArray[np.float32], side: NDArray[np.int8], k: int, need: float, mark: int) -> tuple[int, int]:
    """Mark the unmarked points of a line around k that have `need`; the first and the last of them."""
    low, top = k, k
    while low > 0 and side[low - 1] == 0 and line[low - 1] >= need:
        low -= 1
    while top < line.shape[0] - 1 and side[top + 1] == 0 and line[top + 1] >= need:
        top += 1
    side[low:top + 1] = mark
    return low, top


@njit(cache=True)  # type: ignore[untyped-decorator]
def cheapest_chain(cost: Array) -> NDArray[np.int64]:
    """The indices from 0 to n - 1, in rising order, whose steps cost (n, n) the least in all; inf is no step."""
    n = cost.shape[0]
    best, previous = np.full(n, np.inf), np.zeros(n, np.int64)
    best[0] = 0.0
    for b in range(1, n):
        for a in range(b):
            through = best[a] + cost[a, b]
            if through < best[b]:
                best[b], previous[b] = through, a
    order, last, count = np.empty(n, np.int64), n - 1, 1
    order[0] = last
    while last != 0:
        last = previous[last]
        order[count] = last
        count += 1
    return order[:count][::-1]


@njit(cache=True)  # type: ignore[untyped-decorator]
def _ahead(i: int, j: int, k: int, goal: NDArray[np.int64]) -> int:
    """The cost of the way to the goal where nothing is in it."""
    if goal.shape[0] == 0:
        return 0
    x, y, z = abs(i - goal[0]), abs(j - goal[1]), abs(k - goal[2])
    most, least = max(x, y, z), min(x, y, z)
    middle = x + y + z - most - least
    return int(CUBE * least + FACE * (middle - least) + AXIS * (most - middle))


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
