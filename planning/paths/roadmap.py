"""Collision-free ways between all of many places at once: a visibility graph over the places and some milestones.

Straight edges are checked against the field; shortest ways through them are Dijkstra's. What the graph does not
connect is searched for voxel by voxel (reach.py), which is complete at the field's resolution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from missions.frames import Array
from planning.paths import NoPath, ObstacleField
from planning.paths.reach import reachable
from planning.paths.replan import shortcut

MILESTONES = 400
"""Free cells of about this many are given milestones."""
ALL_PAIRS = 600
"""Up to so many places are tried straight in all pairs; of more, each with its nearest."""
NEAREST = 48
"""Milestones and places are joined to so many of their nearest."""
TIGHT = 1.05
"""Milestones near obstacles keep this much of the clearance asked for, so that ways round corners are short."""


@dataclass(frozen=True)
class Roadmap:
    """Ways between n places, each the same in both directions."""

    field: ObstacleField
    clearance_m: float
    places_enu_m: Array
    """(n, 3)"""
    lengths_m: Array
    """(n, n) of collision-free ways; inf where there is none."""
    corners_enu_m: Array
    """(n, n, k, 3) of the way from the first place to the second, in order; NaN in between where there are fewer."""

    def path(self, start: int, goal: int) -> Array:
        """(k, 3) waypoints from one place to another, both included, shortened. Raises NoPath."""
        if not np.isfinite(self.lengths_m[start, goal]):
            raise NoPath("search")
        corners = self.corners_enu_m[start, goal]
        inner = corners[np.isfinite(corners[:, 0])]
        path = np.concatenate([self.places_enu_m[[start]], inner, self.places_enu_m[[goal]]])
        return shortcut(self.field, path, self.clearance_m) if len(inner) else path


def build_roadmap(field: ObstacleField, places_enu_m: Array, clearance_m: float, starts: int = 0) -> Roadmap:
    """Ways between places (n, 3) that keep the clearance.

    The first `starts` places are where vehicles are: one that lacks the clearance is left straight (reach.py).
    """
    places = np.ascontiguousarray(places_enu_m, dtype=np.float64).reshape(-1, 3)
    nodes = np.concatenate([places, _milestones(field, clearance_m)])
    edges = _clear_edges(field, nodes, _candidates(nodes, len(places)), clearance_m)
    nodes, edges = _joined(field, nodes, edges, len(places), clearance_m, starts)
    reached, before = dijkstra(_graph(nodes, edges), directed=False, indices=np.arange(len(places)),
                               return_predecessors=True)
    start, goal = np.nonzero(np.tril(np.isfinite(reached[:, :len(places)])))
    ways = _tightened(field, nodes[_pulled(field, nodes, before, start, goal, clearance_m)], clearance_m)
    return _both_ways(field, clearance_m, places, start, goal, ways)


def _pulled(field: ObstacleField, nodes: Array, before: NDArray[np.int32], start: NDArray[np.int64],
            goal: NDArray[np.int64], clearance_m: float) -> NDArray[np.int64]:
    """(m, k) nodes of m ways, from the goal back to the start, which is repeated where a way has fewer.

    Pulled tight from the goal: each is the last node on the way back that the one before can see.
    """
    rows = [goal]
    left = np.flatnonzero(goal != start)
    while len(left):
        here = rows[-1]
        last = before[start[left], here[left]].astype(np.int64)
        seeing = np.flatnonzero(last != start[left])
        while len(seeing):
            m = left[seeing]
            further = before[start[m], last[seeing]]
            clear = field.segments_clear(nodes[here[m]], nodes[further], clearance_m)
            seeing = seeing[clear]
            last[seeing] = further[clear]
            seeing = seeing[last[seeing] != start[left[seeing]]]
        row = start.copy()
        row[left] = last
        rows.append(row)
        left = left[last != start[left]]
    return np.stack(rows, axis=1)


def _both_ways(field: ObstacleField, clearance_m: float, places: Array, start: NDArray[np.int64],
               goal: NDArray[np.int64], ways: Array) -> Roadmap:
    """The ways (m, k, 3) from goal to start, and back."""
    n = len(places)
    lengths, corners = np.full((n, n), np.inf), np.full((n, n, max(ways.shape[1] - 2, 0), 3), np.nan)
    lengths[goal, start] = lengths[start, goal] = np.linalg.norm(np.diff(ways, axis=1), axis=2).sum(axis=1)
    repeated = (ways[:, 1:-1] == ways[:, -1:]).all(axis=2)
    corners[goal, start] = np.where(repeated[..., None], np.nan, ways[:, 1:-1])
    corners[start, goal] = corners[goal, start, ::-1]
    return Roadmap(field, clearance_m, places, lengths, corners)


def _tightened(field: ObstacleField, ways: Array, clearance_m: float) -> Array:
    """Ways (m, k, 3) with every corner moved halfway to the line past it, where that is clear."""
    ways = ways.copy()
    for k in range(1, ways.shape[1] - 1):
        m = np.flatnonzero((ways[:, k] != ways[:, -1]).any(axis=1))
        before, here, after = ways[m, k - 1], ways[m, k], ways[m, k + 1]
        span = after - before
        share = ((here - before) * span).sum(axis=1) / np.maximum((span * span).sum(axis=1), 1e-12)
        moved = 0.5 * (here + before + np.clip(share, 0.0, 1.0)[:, None] * span)
        clear = field.segments_clear(before, moved, clearance_m)
        clear[clear] = field.segments_clear(moved[clear], after[clear], clearance_m)
        ways[m[clear], k] = moved[clear]
    return ways


def _milestones(field: ObstacleField, clearance_m: float) -> Array:
    """(m, 3) in each free cell of a coarse lattice the widest point, and the nearest to an obstacle that is free."""
    free = np.argwhere(field.distance >= clearance_m * TIGHT)
    points = field.origin + free * field.voxel_m
    room = field.clearance_m(points)
    wide = room >= clearance_m * TIGHT
    free, points, room = free[wide], points[wide], room[wide]
    if len(free) == 0:
        return np.zeros((0, 3))
    cells = free // math.ceil((len(free) / MILESTONES) ** (1.0 / 3.0))
    cell = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    chosen = [order[np.unique(cell[order], return_index=True)[1]]
              for order in (np.argsort(-room, kind="stable"), np.argsort(room, kind="stable"))]
    return np.asarray(points[np.unique(np.concatenate(chosen))])


def _candidates(nodes: Array, places: int) -> NDArray[np.int64]:
    """(e, 2) pairs of nodes to be tried."""
    count = min(NEAREST + 1, len(nodes))
    near = cKDTree(nodes).query(nodes, k=count)[1].reshape(len(nodes), count)
    pairs = [np.column_stack([np.repeat(np.arange(len(nodes)), count), near.ravel()])]
    if places <= ALL_PAIRS:
        pairs.append(np.column_stack(np.triu_indices(places, 1)))
    found = np.sort(np.concatenate(pairs), axis=1)
    return np.unique(found[found[:, 0] < found[:, 1]], axis=0)


def _clear_edges(field: ObstacleField, nodes: Array, pairs: NDArray[np.int64], clearance_m: float) -> NDArray[np.int64]:
    return pairs[field.segments_clear(nodes[pairs[:, 0]], nodes[pairs[:, 1]], clearance_m)]


def _graph(nodes: Array, edges: NDArray[np.int64]) -> csr_array:
    # coinciding places: an edge of length 0 would be none
    length = np.maximum(np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1), 1e-9)
    return csr_array((length, (edges[:, 0], edges[:, 1])), shape=(len(nodes), len(nodes)))


def _joined(field: ObstacleField, nodes: Array, edges: NDArray[np.int64], places: int, clearance_m: float,
            starts: int) -> tuple[Array, NDArray[np.int64]]:
    """Nodes and edges with ways added from places that hang together with others, but not with the most."""
    part = connected_components(_graph(nodes, edges), directed=False)[1]
    root = int(np.argmax(np.bincount(part[:places])[part[:places]]))
    _, lone = np.unique(part[:places], return_index=True)
    lone = lone[part[lone] != part[root]]
    if len(lone) == 0:
        return nodes, edges
    whole = reachable(field, nodes[root], clearance_m)
    wide = np.isfinite(whole.distance_to(nodes[lone]))
    for place, found in zip(lone.tolist(), wide, strict=True):
        if found:
            nodes, edges = _with_way(nodes, edges, whole.path_to(nodes[place]), root, place)
        elif place < starts:
            reach = reachable(field, nodes[place], clearance_m)
            if np.isfinite(reach.distance_to(nodes[root])[0]):
                nodes, edges = _with_way(nodes, edges, reach.path_to(nodes[root]), place, root)
    return nodes, edges


def _with_way(nodes: Array, edges: NDArray[np.int64], path: Array, start: int,
              goal: int) -> tuple[Array, NDArray[np.int64]]:
    inner = np.arange(len(nodes), len(nodes) + len(path) - 2)
    way = np.concatenate([[start], inner, [goal]])
    added = np.sort(np.column_stack([way[:-1], way[1:]]), axis=1)
    return np.concatenate([nodes, path[1:-1]]), np.concatenate([edges, added])
