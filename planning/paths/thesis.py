"""The thesis's collision detection and replanning of a tour (sections 4.4.3 to 4.4.5) against a known mesh.

A leg that meets triangles of the mesh gets their box (Eq. 4.5), expanded orthogonally to the direction of flight
(4.6), refined to what the mesh fills of it (4.7, 4.8), as an obstacle, and a bidirectional RRT* leads around it
inside the scene's bounds (4.9). The new waypoints carry no picture.

As printed the method ends there: the rest of the mesh is not looked at, so that the way round may meet the structure
elsewhere, or the same wall beside the box; boxes around flat faces have no volume; and a box may hold the view that the
leg ends at. Here the way found is tested again. Its hits give further boxes, every round expanded by alpha more, until
no segment meets the mesh. Boxes are larger than the surface by a margin (the thesis's configurable threshold). A box
that holds an end of the leg is made smaller: first by less expansion, then by cutting the triangles that are hit. A leg
for which this does not end is refused by name.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from planning.paths import NoPath
from planning.paths.thesis_boxes import FLAT_M, Box, clipped, halves, hit_triangles
from planning.paths.thesis_rrt import connect

ALPHA = 1.5
MAX_ROUNDS = 16
MAX_CUTS = 10
ITERATIONS = 600
STEPS_PER_LEG = 3.0
LEAST_STEP_M = 1.0
NO_VIEW = -1


@dataclass(frozen=True)
class RepairedRoute:
    """A tour with waypoints inserted (Eq. 4.9)."""

    points_enu_m: Array
    """(m, 3)."""
    view: NDArray[np.int64]
    """(m,) index into the given route, NO_VIEW for inserted waypoints."""
    refused: dict[int, str] = field(default_factory=dict)
    """Legs, by the index of their first point, that meet the mesh and have no way round, and why. They are left
    straight."""


def repair_route(triangles: Array, route_enu_m: Array, lower_enu_m: Array, upper_enu_m: Array, seed: int,
                 margin_m: float = 0.5, alpha: float = ALPHA) -> RepairedRoute:
    """Lead every leg of a route (n, 3) that meets the mesh (triangles (t, 3, 3)) around it, inside lower..upper.

    Equal arguments give equal routes. No segment of the result meets the mesh but those of refused legs.
    """
    route = np.asarray(route_enu_m, dtype=np.float64).reshape(-1, 3)
    points, view = [route[:1]], [np.zeros(len(route[:1]), dtype=np.int64)]
    refused: dict[int, str] = {}
    for leg in range(len(route) - 1):
        inserted = np.zeros((0, 3))
        try:
            inserted = way_round(triangles, route[leg], route[leg + 1], lower_enu_m, upper_enu_m,
                                 seed + leg, margin_m, alpha)[1:-1]
        except NoPath as e:
            refused[leg] = e.reason
        points += [inserted, route[leg + 1 : leg + 2]]
        view += [np.full(len(inserted), NO_VIEW), np.array([leg + 1])]
    return RepairedRoute(np.concatenate(points), np.concatenate(view).astype(np.int64), refused)


def way_round(triangles: Array, start_enu_m: Array, goal_enu_m: Array, lower_enu_m: Array, upper_enu_m: Array,
              seed: int, margin_m: float = 0.5, alpha: float = ALPHA) -> Array:
    """(k, 3) points from start to goal, both included; the straight leg where it does not meet the mesh.

    Raises NoPath: "start" or "goal" when every box around a hit holds that end, "outside" when an end is outside the
    bounds, "search" when the trees do not meet or rounds run out.
    """
    ends = np.stack([start_enu_m, goal_enu_m])
    path, boxes = ends, np.zeros((0, 2, 3))
    step_m = max(LEAST_STEP_M, float(np.linalg.norm(goal_enu_m - start_enu_m)) / STEPS_PER_LEG)
    for attempt in range(MAX_ROUNDS):
        hit = [(a, b) for a, b in pairwise(path) if len(hit_triangles(a, b, triangles))]
        if not hit:
            return path
        if np.any(ends < lower_enu_m) or np.any(ends > upper_enu_m):
            raise NoPath("outside")
        found = [obstacle(triangles, a, b, ends, margin_m, alpha, attempt + 1) for a, b in hit]
        boxes = np.concatenate([boxes, [(box.lower, box.upper) for box in found]])
        planned = connect(start_enu_m, goal_enu_m, boxes, lower_enu_m, upper_enu_m, step_m, ITERATIONS, seed + attempt)
        if planned is None:
            raise NoPath("search")
        path = planned
    raise NoPath("search")


def obstacle(triangles: Array, a_enu_m: Array, b_enu_m: Array, ends_enu_m: Array, margin_m: float, alpha: float,
             rounds: int) -> Box:
    """The box of the part of the mesh that a segment from a to b meets, with a margin, holding neither end (2, 3)."""
    direction = (b_enu_m - a_enu_m) / np.linalg.norm(b_enu_m - a_enu_m)
    hit = triangles[hit_triangles(a_enu_m, b_enu_m, triangles)]
    held = np.zeros(2, dtype=np.bool_)
    for cut in range(MAX_CUTS):
        for exponent in range(rounds if cut == 0 else 1, 0, -1):
            reference = Box.around(hit).expanded(direction, alpha**exponent).grown(FLAT_M)
            box = Box.around(clipped(triangles, reference)).grown(margin_m)
            held = box.contains(ends_enu_m)
            if not held.any():
                return box
        hit = halves(hit)
        hit = hit[hit_triangles(a_enu_m, b_enu_m, hit)]
    raise NoPath("start" if held[0] else "goal")
