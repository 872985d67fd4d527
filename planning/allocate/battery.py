"""What a tour will cost in battery: Algorithm 1 of the thesis (its Figure 4.13), run ahead of the flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missions.frames import Array


@dataclass(frozen=True)
class Forecast:
    """Cumulative distance and battery level at every point of a tour (Algorithm 1's D and B)."""

    distance_m: Array
    level_percent: Array


def consume(points_m: Array, start_percent: float, percent_per_m: float) -> Forecast:
    """Algorithm 1 over points (k, 3): the first is where the flight starts; levels never fall below 0."""
    points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return Forecast(distance, np.maximum(start_percent - percent_per_m * distance, 0.0))


def threshold_index(forecast: Forecast, threshold_percent: float) -> int | None:
    """First point at which the level is at or below the threshold; None when it stays above."""
    low = np.flatnonzero(forecast.level_percent <= threshold_percent)
    return int(low[0]) if len(low) else None


def range_m(level_percent: float, percent_per_m: float, reserve_percent: float = 0.0) -> float:
    """Metres that can be flown before the level falls to the reserve; inf when flying costs nothing."""
    if percent_per_m <= 0.0:
        return float("inf")
    return max(0.0, (level_percent - reserve_percent) / percent_per_m)
