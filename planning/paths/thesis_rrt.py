"""Bidirectional RRT* around boxes (thesis section 4.4.5; LaValle, Planning Algorithms, section 5.5.3).

OMPL has no bidirectional RRT*: its RRTConnect is bidirectional but never improves, its RRTstar improves but grows one
tree. So the thesis's own algorithm stands here: two trees, each new vertex of the one drawn towards by the other, the
smaller tree grown next. The star is that of Karaman and Frazzoli: a vertex takes the parent through which it is
cheapest, and becomes the parent of neighbours for which that is shorter. All iterations are made and the best
connection counts, so that equal samples give equal paths.

Two slips in print: the trees are said to meet "if q_s' = q_n'", where q_s' = q_s is meant; and T_a and T_b are said to
change places if |T_b| > |T_a|, which would let the larger one grow, where the sentence beside it wants the smaller.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array

NONE = -1
NEAR_STEPS = 3.0
"""Neighbours for the choice of parents lie within this many steps."""


def connect(start_enu_m: Array, goal_enu_m: Array, boxes: Array, lower_enu_m: Array, upper_enu_m: Array, step_m: float,
            iterations: int, seed: int) -> Array | None:
    """(k, 3) points from start to goal, both included, outside all boxes (b, 2, 3); None when the trees do not meet.

    Samples are drawn from the search space lower..upper. step_m: longest edge.
    """
    samples = np.random.default_rng(seed).uniform(lower_enu_m, upper_enu_m, (iterations, 3))
    ends = np.stack([start_enu_m, goal_enu_m]).astype(np.float64)
    path: Array = grow(ends, np.ascontiguousarray(boxes, dtype=np.float64), samples, step_m)
    return path if len(path) else None


@njit(cache=True)  # type: ignore[untyped-decorator]
def grow(ends: Array, boxes: Array, samples: Array, step: float) -> Array:
    """The best path between two ends (2, 3) after all samples (n, 3); (0, 3) when there is none."""
    room = 2 * len(samples) + 1
    points, parent, size = np.empty((2, room, 3)), np.full((2, room), NONE), np.ones(2, np.int64)
    points[:, 0] = ends
    best, join = np.inf, np.full(2, NONE)
    active = 0
    for i in range(len(samples)):
        other = 1 - active
        new = extend(points[active], parent[active], size[active], samples[i], boxes, step)
        if new != NONE:
            size[active] += 1
            target = points[active, new]
            met = extend(points[other], parent[other], size[other], target, boxes, step)
            if met != NONE:
                size[other] += 1
                total = cost_to(points[active], parent[active], new) + cost_to(points[other], parent[other], met)
                if distance(points[other, met], target) < 1e-9 and total < best:
                    best, join[active], join[other] = total, new, met
        if size[other] < size[active]:
            active = other
    if best == np.inf:
        return np.empty((0, 3))
    path: Array = joined(points, parent, join)
    return path


@njit(cache=True)  # type: ignore[untyped-decorator]
def extend(points: Array, parent: NDArray[np.int64], size: int, target: Array, boxes: Array, step: float) -> int:
    """Add a vertex at most one step from the tree's nearest towards a target; its index, or NONE when a box is met."""
    nearest, gap = 0, np.inf
    for k in range(size):
        d = distance(points[k], target)
        if d < gap:
            nearest, gap = k, d
    if gap < 1e-9:
        return NONE
    share = min(1.0, step / gap)
    for axis in range(3):
        points[size, axis] = points[nearest, axis] + share * (target[axis] - points[nearest, axis])
    if share == 1.0:
        points[size] = target
    if not clear(points[nearest], points[size], boxes):
        return NONE
    parent[size] = nearest
    improve(points, parent, size, boxes, NEAR_STEPS * step)
    return size


@njit(cache=True)  # type: ignore[untyped-decorator]
def improve(points: Array, parent: NDArray[np.int64], new: int, boxes: Array, radius: float) -> None:
    """Choose the cheapest parent for a new vertex, then make it the parent of neighbours that it brings nearer."""
    cost = cost_to(points, parent, new)
    costs = np.full(new, np.inf)
    for k in range(new):
        d = distance(points[k], points[new])
        if d > radius:
            continue
        costs[k] = cost_to(points, parent, k)
        if costs[k] + d < cost - 1e-9 and clear(points[k], points[new], boxes):
            parent[new], cost = k, costs[k] + d
    for k in range(1, new):
        d = distance(points[k], points[new])
        if cost + d < costs[k] - 1e-9 and costs[k] < np.inf and clear(points[k], points[new], boxes):
            parent[k] = new


@njit(cache=True)  # type: ignore[untyped-decorator]
def cost_to(points: Array, parent: NDArray[np.int64], k: int) -> float:
    """Length of the way from the root to a vertex."""
    total = 0.0
    while parent[k] != NONE:
        total += distance(points[k], points[parent[k]])
        k = parent[k]
    return total


@njit(cache=True)  # type: ignore[untyped-decorator]
def joined(points: Array, parent: NDArray[np.int64], join: NDArray[np.int64]) -> Array:
    """The way from the first root over the join to the second root."""
    count = 0
    for tree in range(2):
        k = join[tree]
        while k != NONE:
            count, k = count + 1, parent[tree, k]
    out = np.empty((count - 1, 3))
    ahead = 0
    k = join[0]
    while k != NONE:
        ahead, k = ahead + 1, parent[0, k]
    k, at = join[0], ahead - 1
    while k != NONE:
        out[at] = points[0, k]
        at, k = at - 1, parent[0, k]
    k, at = parent[1, join[1]], ahead
    while k != NONE:
        out[at] = points[1, k]
        at, k = at + 1, parent[1, k]
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def clear(a: Array, b: Array, boxes: Array) -> bool:
    """Whether the segment from a to b stays out of every box (touching a face is allowed)."""
    for k in range(len(boxes)):
        enter, leave = 0.0, 1.0
        for axis in range(3):
            way = b[axis] - a[axis]
            low, high = boxes[k, 0, axis] - a[axis], boxes[k, 1, axis] - a[axis]
            if abs(way) < 1e-12:
                if low >= 0.0 or high <= 0.0:
                    leave = -1.0
                continue
            first, last = low / way, high / way
            enter, leave = max(enter, min(first, last)), min(leave, max(first, last))
        if enter < leave:
            return False
    return True


@njit(cache=True)  # type: ignore[untyped-decorator]
def distance(a: Array, b: Array) -> float:
    """Between two points (3,)."""
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
