"""Legs over the roadmap with which tours were reckoned, so that what is flown is what was planned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ground_station.airspace import Airspace
from missions.frames import Array
from planning.paths import NoPath
from planning.paths.roadmap import Roadmap

SAME_PLACE_M = 0.1
"""A vehicle that hovers this near to a place of the roadmap is there: MAVLink rounds positions to about 1 cm."""


@dataclass(frozen=True)
class RoadmapAirspace(Airspace):
    """The roadmap's ways between its places while no teammate hovers beside them; else a way searched for."""

    roadmap: Roadmap

    @classmethod
    def over(cls, airspace: Airspace, roadmap: Roadmap) -> RoadmapAirspace:
        """The same airspace with a roadmap over it."""
        return cls(airspace.field, airspace.clearance_m, airspace.separation_m, airspace.lower_enu_m,
                   airspace.upper_enu_m, roadmap)

    def known_way(self, start_enu_m: Array, goal_enu_m: Array) -> Array | None:
        """The roadmap's."""
        start, goal = place_near(self.roadmap, start_enu_m), place_near(self.roadmap, goal_enu_m)
        if start is None or goal is None:
            return None
        try:
            between = self.roadmap.path(start, goal)[1:-1]
        except NoPath:
            return None
        return np.concatenate([start_enu_m[None], between, goal_enu_m[None]])


def place_near(roadmap: Roadmap, position_enu_m: Array) -> int | None:
    """The place of a roadmap where a position is; None when it is at none."""
    away = np.linalg.norm(roadmap.places_enu_m - position_enu_m, axis=1)
    nearest = int(np.argmin(away)) if len(away) else 0
    return nearest if len(away) and away[nearest] <= SAME_PLACE_M else None
