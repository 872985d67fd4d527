"""Battery by Algorithm 1 of the thesis: percent per metre flown, and optionally percent per second in the air."""

from __future__ import annotations

import numpy as np

from missions.frames import Array


def consume(points_m: Array, max_percent: float, percent_per_m: float) -> tuple[Array, Array]:
    """(cumulative distances (n,), remaining levels (n,)) along points (n, 3): the thesis's Algorithm 1."""
    points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    distances = np.concatenate([[0.0], np.cumsum(steps)])
    return distances, np.maximum(max_percent - percent_per_m * distances, 0.0)


class Battery:
    """The level of one vehicle's battery."""

    def __init__(self, level_percent: float, percent_per_m: float, hover_percent_per_s: float = 0.0) -> None:
        self.level_percent = level_percent
        self._per_m, self._per_s = percent_per_m, hover_percent_per_s

    def spend(self, distance_m: float, airborne_s: float) -> None:
        """Take off what was flown since the last call; the level never falls below zero."""
        self.level_percent = max(0.0, self.level_percent - self.cost_percent(distance_m, airborne_s))

    def cost_percent(self, distance_m: float, airborne_s: float = 0.0) -> float:
        """What a flight of this length and time takes."""
        return self._per_m * distance_m + self._per_s * airborne_s
