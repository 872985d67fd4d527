"""What flying between survey views takes: seconds and percent of a battery, for all pairs at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missions.camera import View
from missions.frames import Array
from missions.mission import Mission
from planning.trajectories import Limits, leg_time_s
from planning.trajectories.energy import energy_of


@dataclass(frozen=True)
class Cost:
    """Legs in seconds and in percent of a battery, of any shape; inf where there is no way."""

    seconds: Array
    percent: Array


class LegCosts:
    """Costs of the legs of one survey, n views."""

    def __init__(self, views: list[View], mission: Mission) -> None:
        self._energy, self._limits = energy_of(mission), Limits.of_fleet(mission.fleet)
        self._positions = np.array([v.pose.position_enu_m for v in views]).reshape(-1, 3)
        self.between = self._legs(self._positions[:, None], self._positions[None])
        settle_s = mission.survey.settle_s if mission.survey.stop_at_views else 0.0
        self.service = Cost(np.full(len(views), settle_s), np.full(len(views), self._energy.rest_percent(settle_s)))

    def from_place(self, place_enu_m: Array) -> Cost:
        """(n,) from a place to every view."""
        return self._legs(place_enu_m, self._positions)

    def to_place(self, place_enu_m: Array) -> Cost:
        """(n,) from every view to a place."""
        return self._legs(self._positions, place_enu_m)

    def direct(self, from_enu_m: Array, to_enu_m: Array) -> Cost:
        """() from one place to another."""
        return self._legs(from_enu_m, to_enu_m)

    def _legs(self, from_enu_m: Array, to_enu_m: Array) -> Cost:
        gap = to_enu_m - from_enu_m
        length = np.linalg.norm(gap, axis=-1)
        seconds = leg_time_s(length, self._limits)
        return Cost(seconds, self._energy.leg_percent(gap, length, seconds))
