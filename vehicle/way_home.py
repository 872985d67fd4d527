"""What coming home and landing takes out of the battery, from anywhere: it is always kept back."""

from __future__ import annotations

import numpy as np

from missions.frames import Array
from planning.trajectories import Limits, leg_time_s
from planning.trajectories.energy import Energy

DETOUR = 1.3
"""Ways home are reckoned this much longer than straight, and flown as slowly as detours are."""
WAIT_S = 20.0
"""Time on the way home in which a teammate may be in the way."""


class WayHome:
    """From a place to the hover point and down to the pad. All results are percent (...) for positions (..., 3)."""

    def __init__(self, energy: Energy, hover_enu_m: Array, pad_enu_m: Array, limits: Limits, slow: Limits,
                 vertical: Limits) -> None:
        """limits: of a free way; slow: of a detour; vertical: of landing."""
        self._energy, self._hover, self._limits, self._slow = energy, hover_enu_m, limits, slow
        down = pad_enu_m - hover_enu_m
        length = np.asarray(np.linalg.norm(down))
        self._landing = float(energy.leg_percent(down, length, leg_time_s(length, vertical)))
        self._waiting = energy.rest_percent(WAIT_S)

    def percent(self, position_enu_m: Array) -> Array:
        """With a detour and a wait for a teammate."""
        away = self._hover - position_enu_m
        length = DETOUR * np.linalg.norm(away, axis=-1)
        flying = self._energy.leg_percent(away, length, leg_time_s(length, self._slow))
        return np.asarray(flying + self._waiting + self._landing)

    def least_percent(self, position_enu_m: Array) -> Array:
        """If the way is free: with less than this the vehicle cannot come home."""
        away = self._hover - position_enu_m
        length = np.linalg.norm(away, axis=-1)
        return np.asarray(self._energy.leg_percent(away, length, leg_time_s(length, self._limits)) + self._landing)
