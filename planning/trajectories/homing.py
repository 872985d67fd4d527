"""What coming home and landing takes out of a battery, as every vehicle reckons it before it accepts a plan.

The ground station reckons with the same, so that it gives out no view that a vehicle would have to refuse.
"""

from __future__ import annotations

import numpy as np

from missions.frames import Array
from planning.trajectories.energy import Energy
from planning.trajectories.leg import leg_time_s
from planning.trajectories.limits import Limits

DETOUR = 1.3
"""Ways home are reckoned at least this much longer than straight, and flown as slowly as detours are."""
DETOUR_SPEED_M_S = 1.5
"""Around things that the map did not show, slow enough to stop within what the sensor sees densely."""
VERTICAL_SPEED_M_S = 1.5
"""Take-off and landing."""
WAIT_S = 15.0
"""For each teammate that may come home first through the same gap."""


def way_home_percent(energy: Energy, away_enu_m: Array, slow: Limits, around_m: float = 0.0) -> Array:
    """(...) of flying by vectors away_enu_m (..., 3) to the hover point, with a detour of at least around_m; slow:
    limits of a detour."""
    straight = np.linalg.norm(away_enu_m, axis=-1)
    length = np.maximum(DETOUR * straight, straight + around_m)
    return np.asarray(energy.leg_percent(away_enu_m, length, leg_time_s(length, slow)))


def vertical_percent(energy: Energy, way_enu_m: Array, vertical: Limits) -> float:
    """Of landing or taking off by a vector (3,) between hover point and pad."""
    length = np.asarray(np.linalg.norm(way_enu_m))
    return float(energy.leg_percent(way_enu_m, length, leg_time_s(length, vertical)))


def waiting_percent(energy: Energy, teammates: int) -> float:
    """Of hovering until all of them are down."""
    return float(energy.rest_percent(WAIT_S * teammates))
