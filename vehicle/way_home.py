"""What coming home and landing takes out of the battery, from anywhere: it is always kept back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from missions.frames import Array
from planning.trajectories import Limits, leg_time_s
from planning.trajectories.energy import Energy
from planning.trajectories.homing import vertical_percent, waiting_percent, way_home_percent

NEXT_PLACES = 8
"""Over so many of the places with the shortest ways a free way home is looked for."""
SAME_PLACE_M = 0.5


class WayHome:
    """From a place to the hover point and down to the pad. All results are percent (...) for positions (..., 3)."""

    def __init__(self, energy: Energy, hover_enu_m: Array, pad_enu_m: Array, limits: Limits, slow: Limits,
                 vertical: Limits, teammates: int) -> None:
        """limits: of a free way; slow: of a detour; vertical: of landing."""
        self._energy, self._hover, self._limits, self._slow = energy, hover_enu_m, limits, slow
        self._landing = vertical_percent(energy, pad_enu_m - hover_enu_m, vertical)
        self._waiting = waiting_percent(energy, teammates)
        self._places, self._way_m = [hover_enu_m], [0.0]
        self._around_m = 0.0

    def note(self, place_enu_m: Array, clear: Callable[[Array, Array], bool]) -> None:
        """The vehicle has come here (3,) straight from the place before. `clear` says whether it could fly straight
        from one place to another: so the shortest way home that is known to be free leads over places where it was."""
        gaps = np.linalg.norm(np.array(self._places) - place_enu_m, axis=1)
        if gaps[-1] < SAME_PLACE_M:
            return
        ways = gaps + self._way_m
        nearest = np.argsort(ways, kind="stable")[:NEXT_PLACES]
        way_m = float(ways[next((n for n in nearest if clear(place_enu_m, self._places[n])), -1)])
        self._places.append(place_enu_m)
        self._way_m.append(way_m)
        self._around_m = way_m - float(gaps[0])

    def percent(self, position_enu_m: Array) -> Array:
        """With a detour, at least as far around as from the last place noted, and waits for all teammates."""
        flying = way_home_percent(self._energy, self._hover - position_enu_m, self._slow, self._around_m)
        return np.asarray(flying + self._waiting + self._landing)

    def least_percent(self, position_enu_m: Array) -> Array:
        """If the way is free: with less than this the vehicle cannot come home."""
        away = self._hover - position_enu_m
        length = np.linalg.norm(away, axis=-1)
        return np.asarray(self._energy.leg_percent(away, length, leg_time_s(length, self._limits)) + self._landing)
