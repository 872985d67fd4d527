"""What a tour will cost in battery: Algorithm 1 of the thesis, run ahead of the flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missions.frames import Array


@dataclass(frozen=True)
class Forecast:
    """Cumulative distance and battery level at every point of a tour (Algorithm 1's D and B)."""

    distance_m: Array
    level_percent: Array


def predict(leg_m: Array, start_percent: float, percent_per_m: float) -> Forecast:
    """Forecast over k legs: (k + 1,) distances and levels, the start included; levels never fall below 0."""
    distance = np.concatenate([[0.0], np.cumsum(leg_m)])
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


def affordable_views(leg_m: Array, home_m: Array, start_percent: float, percent_per_m: float,
                     threshold_percent: float) -> int:
    """How many views of a tour can be flown before the vehicle must turn home.

    leg_m: (k,) length of the leg to each view. home_m: (k,) way home from each. A view is affordable when the vehicle
    leaves for it above the threshold and could still reach home from it.
    """
    level = predict(leg_m, start_percent, percent_per_m).level_percent
    drained = start_percent - percent_per_m * (np.cumsum(leg_m) + home_m)
    good = (level[:-1] > threshold_percent) & (drained >= 0.0)
    return int(np.argmin(good)) if not good.all() else len(good)
