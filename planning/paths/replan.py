"""A path between two points around obstacles: the shortest way over the field's lattice, then straightened.

Source of the search: Hart, Nilsson and Raphael, "A formal basis for the heuristic determination of minimum cost
paths", 1968.
"""

from __future__ import annotations

import numpy as np

from missions.frames import Array
from planning.paths import search_kernels
from planning.paths.fields import ObstacleField
from planning.paths.lattice import lattice_path
from planning.paths.refusal import NoPath

WINDOWS_M = (8.0, np.inf)
"""How far around both ends a way is looked for, first and then."""
SHORTCUT_POINTS = 32
SHORTCUT_ROUNDS = 6
WORTHWHILE = 0.98
"""Another round is made after one that left at most this share of the cost."""
CORNER_M = 1.5
"""What a corner costs beside its length: vehicles slow down there."""


def plan_path(field: ObstacleField, start_enu_m: Array, goal_enu_m: Array, clearance_m: float, lower_enu_m: Array,
              upper_enu_m: Array) -> Array:
    """(k, 3) waypoints from start to goal, both included, in the box lower..upper, at least clearance_m from the field.

    A clear straight line is returned at once. Equal arguments give equal paths. Raises NoPath.
    """
    ends = np.array([start_enu_m, goal_enu_m], dtype=np.float64)
    if np.any(ends < lower_enu_m) or np.any(ends > upper_enu_m):
        raise NoPath("outside")
    free = field.clearance_m(ends) >= clearance_m
    if not free.all():
        raise NoPath("goal" if free[0] else "start")
    if field.segments_clear(ends[0], ends[1], clearance_m)[0]:
        return ends
    return _way_around(field, ends, clearance_m, (np.asarray(lower_enu_m), np.asarray(upper_enu_m)))


def _way_around(field: ObstacleField, ends: Array, clearance_m: float, box: tuple[Array, Array]) -> Array:
    """Over the field's lattice, nearby and then everywhere; where that leads nowhere, over a finer one nearby."""
    low, high = ends.min(axis=0), ends.max(axis=0)
    for margin in WINDOWS_M:
        try:
            way = lattice_path(field, ends, clearance_m, (np.maximum(low - margin, box[0]),
                                                          np.minimum(high + margin, box[1])))
            return straightened(field, way, clearance_m)
        except NoPath:
            continue
    fine = field.finer(ends, WINDOWS_M[0], clearance_m)
    if fine is None:
        raise NoPath("search")
    return straightened(fine, lattice_path(fine, ends, clearance_m, box), clearance_m)


def straightened(field: ObstacleField, path: Array, clearance_m: float) -> Array:
    """Shortcuts as long as they are worth it."""
    for _ in range(SHORTCUT_ROUNDS):
        before, path = _cost_m(path), shortcut(field, path, clearance_m)
        if _cost_m(path) > WORTHWHILE * before:
            break
    return path


def shortcut(field: ObstacleField, path: Array, clearance_m: float) -> Array:
    """The cheapest sub-sequence of a path (n, 3), resampled, whose segments are all clear; ends are kept.

    What the lattice does not decide is taken for clear until the cheapest sub-sequence uses it, and only then looked at
    closely: the outcome is the same, for a fraction of the cost (after Bohlin and Kavraki, "Path planning using lazy
    PRM", 2000).
    """
    path = _resampled(path, SHORTCUT_POINTS)
    n = len(path)
    i, j = np.triu_indices(n, 1)
    clear, undecided = field.lattice_verdicts(path[i], path[j], clearance_m)
    clear |= j == i + 1
    maybe = clear | undecided
    cost, in_doubt = np.full((n, n), np.inf), np.zeros((n, n), dtype=np.bool_)
    cost[i[maybe], j[maybe]] = np.linalg.norm(path[j[maybe]] - path[i[maybe]], axis=1) + CORNER_M
    in_doubt[i, j] = undecided & ~clear
    while True:
        order = search_kernels.cheapest_chain(cost)
        a, b = order[:-1], order[1:]
        asked = in_doubt[a, b]
        if not asked.any():
            return np.asarray(path[order])
        a, b = a[asked], b[asked]
        blocked = ~field.segments_clear(path[a], path[b], clearance_m)
        in_doubt[a, b], cost[a[blocked], b[blocked]] = False, np.inf


def _cost_m(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) + CORNER_M * len(path)


def _resampled(path: Array, count: int) -> Array:
    """Up to `count` points more, evenly spread over the path, its corners kept."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    keep = np.concatenate([[True], np.diff(along) > 0.0])
    path, along = path[keep], along[keep]
    t = np.unique(np.concatenate([along, np.linspace(0.0, along[-1], count)]))
    return np.stack([np.interp(t, along, path[:, axis]) for axis in range(3)], axis=1)
