"""Ray casting through a labelled voxel grid, compiled: Amanatides & Woo, Eurographics 1987.

Every function writes each result in its own slot and sums in a fixed order, so results do not depend on the number
of threads. Grid coordinates are voxels: (position - origin) / voxel.
"""
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numba as nb
import numpy as np

FAR = 1e30


@nb.njit(cache=True)
def _axis(start, direction):
    """Along one axis: voxel, ray length to its wall, ray length between walls, step."""
    voxel = np.int64(math.floor(start))
    if direction > 1e-12:
        return voxel, (voxel + 1.0 - start) / direction, 1.0 / direction, 1
    if direction < -1e-12:
        return voxel, (voxel - start) / direction, -1.0 / direction, -1
    return voxel, FAR, FAR, 0


@nb.njit(cache=True)
def inside(shape, voxel):
    """Whether a voxel (i, j, k) is one of the grid's."""
    return 0 <= voxel[0] < shape[0] and 0 <= voxel[1] < shape[1] and 0 <= voxel[2] < shape[2]


@nb.njit(cache=True)
def box_span(start, direction, lower, upper):
    """(enter, leave) ray lengths of a box; enter > leave when the ray misses it."""
    enter, leave = 0.0, FAR
    for a in range(3):
        if abs(direction[a]) < 1e-12:
            if start[a] < lower[a] or start[a] > upper[a]:
                return 1.0, 0.0
            continue
        t0 = (lower[a] - start[a]) / direction[a]
        t1 = (upper[a] - start[a]) / direction[a]
        enter = max(enter, min(t0, t1))
        leave = min(leave, max(t0, t1))
    return enter, leave


@nb.njit(cache=True)
def walk(start, direction):
    """A walk along a ray: the first voxel, ray lengths to its walls, ray lengths between walls, steps; one per axis."""
    i, tx, dx, si = _axis(start[0], direction[0])
    j, ty, dy, sj = _axis(start[1], direction[1])
    k, tz, dz, sk = _axis(start[2], direction[2])
    return (i, j, k), (tx, ty, tz), (dx, dy, dz), (si, sj, sk)


@nb.njit(cache=True)
def next_axis(walls):
    """The axis along which a walk goes on to the next voxel."""
    tx, ty, tz = walls
    if tx <= ty and tx <= tz:
        return 0
    return 1 if ty <= tz else 2


@nb.njit(cache=True)
def next_voxel(voxel, walls, spans, steps):
    """The next voxel of a walk, the ray length at which it is entered, and ray lengths to its walls."""
    (i, j, k), (tx, ty, tz) = voxel, walls
    axis = next_axis(walls)
    if axis == 0:
        return (i + steps[0], j, k), tx, (tx + spans[0], ty, tz)
    if axis == 1:
        return (i, j + steps[1], k), ty, (tx, ty + spans[1], tz)
    return (i, j, k + steps[2]), tz, (tx, ty, tz + spans[2])


@nb.njit(cache=True)
def ray_gain(label, chance, value, start, direction, reach, flat_reach):
    """Expected sum over the voxels along one ray of value * min(d, flat_reach)^2, in voxel^2 per steradian.

    chance[label] is the probability that a voxel stops the ray, value[label] what it is worth when it does.
    """
    voxel, walls, spans, steps = walk(start, direction)
    t, through, gain = 0.0, 1.0, 0.0
    while t < reach and through > 0.02:
        if inside(label.shape, voxel):
            here = label[voxel]
            p = chance[here]
            if p > 0.0:
                d = min(t + 0.5, flat_reach)
                gain += through * p * value[here] * d * d
                through *= 1.0 - p
        voxel, t, walls = next_voxel(voxel, walls, spans, steps)
    return gain


@nb.njit(cache=True, parallel=True)
def view_gains(label, chance, value, starts, directions, lower, upper, reach, flat_reach, first_view, views, count):
    """(p, count) sums of ray gains per start and orientation.

    views[first_view[r]:first_view[r + 1]] are the orientations that see direction r. Rays that miss the box of interest
    are not cast, and none is followed beyond it.
    """
    gains = np.zeros((len(starts), count))
    for p in nb.prange(len(starts)):
        for r in range(len(directions)):
            enter, leave = box_span(starts[p], directions[r], lower, upper)
            if enter >= leave or enter >= reach:
                continue
            gain = ray_gain(label, chance, value, starts[p], directions[r], min(reach, leave), flat_reach)
            if gain > 0.0:
                for at in range(first_view[r], first_view[r + 1]):
                    gains[p, views[at]] += gain
    return gains


@nb.njit(cache=True)
def first_hit(state, wanted, start, direction, reach):
    """Ray length at which the first voxel with the wanted state is entered; inf when there is none within reach."""
    voxel, walls, spans, steps = walk(start, direction)
    t = 0.0
    while t < reach:
        if inside(state.shape, voxel) and state[voxel] == wanted:
            return t
        voxel, t, walls = next_voxel(voxel, walls, spans, steps)
    return np.inf


@nb.njit(cache=True)
def first_hits(state, wanted, start, directions, reach):
    """(r,) `first_hit` along each direction (r, 3)."""
    out = np.empty(len(directions))
    for r in range(len(directions)):
        out[r] = first_hit(state, wanted, start, directions[r], reach)
    return out


@nb.njit(cache=True)
def segment_blocked(state, free, start, end, tolerance):
    """Whether any voxel that is not `free` lies between start and `tolerance` before end; outside the grid blocks."""
    direction = end - start
    length = math.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    reach = length - tolerance
    if reach <= 0.0:
        return False
    voxel, walls, spans, steps = walk(start, direction / length)
    t = 0.0
    while t < reach:
        if not inside(state.shape, voxel) or state[voxel] != free:
            return True
        voxel, t, walls = next_voxel(voxel, walls, spans, steps)
    return False
