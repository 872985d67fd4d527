"""What the vehicles' range sensors have hit, for the ways alone: it enters neither the map nor the choice of views."""

from __future__ import annotations

import numpy as np

from missions.clock import SECOND_NS
from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid
from missions.messages import RangeHits
from missions.sensors import HIT_RADIUS_M

CELL_M = 0.25
"""One hit is kept per cell, the newest."""
MEMORY_NS = 600 * SECOND_NS
"""What stands is kept out of the ways for long; what only passed by is forgotten."""
NO_HITS = np.zeros((0, 3))
CORNERS = np.array([(i, j, k) for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
ON_FACE = 1e-3 * CORNERS
"""Hits this near to an occupied voxel belong to it."""
AROUND = HIT_RADIUS_M * CORNERS


class SeenObstacles:
    """The hits that vehicles have told of."""

    def __init__(self) -> None:
        self._seen: dict[tuple[int, ...], tuple[tuple[float, float, float], int]] = {}

    def hear(self, message: RangeHits) -> None:
        """A vehicle tells what its sensor has newly hit."""
        cells = np.floor(np.array(message.points_enu_m).reshape(-1, 3) / CELL_M).astype(int).tolist()
        for cell, point in zip(cells, message.points_enu_m, strict=True):
            self._seen[tuple(cell)] = point, message.t_ns

    def unmapped(self, grid: VoxelGrid, t_ns: int) -> Array:
        """(n, 3) ENU metres: hits where the map shows nothing solid, and which narrow the space that it calls free."""
        points = np.array([p for p, seen_ns in self._seen.values() if t_ns - seen_ns <= MEMORY_NS]).reshape(-1, 3)
        for offset in ON_FACE:
            points = points[grid.state_at(points + offset) != OCCUPIED]
        beside = [grid.state_at(points + offset) == FREE for offset in AROUND]
        return np.asarray(points[np.any(beside, axis=0)])
