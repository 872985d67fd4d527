"""Legs as the thesis leads them around a known structure, where they also keep the vehicle's clearance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ground_station.airspace import Airspace
from ground_station.prior import Prior
from missions.frames import Array
from missions.mission import Mission
from planning.paths import NoPath
from planning.paths.thesis import way_round


@dataclass(frozen=True)
class ThesisAirspace(Airspace):
    """Section 4.4.3 to 4.4.5 first; our own planner where the thesis refuses, or comes nearer to the structure or to a
    teammate than vehicles accept: it knows of neither clearance nor other vehicles."""

    triangles: Array
    """(t, 3, 3) of the prior model."""
    seed: int

    @classmethod
    def with_prior(cls, plain: Airspace, prior: Prior, mission: Mission) -> ThesisAirspace:
        """The airspace of a prior model, thought of as the thesis does."""
        return cls(plain.field, plain.clearance_m, plain.separation_m, plain.lower_enu_m, plain.upper_enu_m,
                   np.asarray(prior.mesh.triangles, dtype=np.float64), mission.seed)

    def known_way(self, start_enu_m: Array, goal_enu_m: Array) -> Array | None:
        """The thesis's."""
        try:
            return way_round(self.triangles, start_enu_m, goal_enu_m, self.lower_enu_m, self.upper_enu_m, self.seed,
                             margin_m=self.clearance_m)
        except NoPath:
            return None
