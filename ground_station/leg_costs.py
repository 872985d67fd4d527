"""What flying between survey views takes: seconds and percent of a battery, for all pairs at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ground_station.airspace import Airspace
from ground_station.legs import CORNER_PASS_M, Shooting
from ground_station.roadmap_airspace import place_near
from missions.camera import View
from missions.frames import Array
from missions.mission import Mission
from planning.allocate.flight_cost import Passing, leg_seconds
from planning.paths.roadmap import Roadmap
from planning.trajectories import Limits, leg_time_s
from planning.trajectories.energy import energy_of
from planning.trajectories.homing import DETOUR_SPEED_M_S, way_home_percent


@dataclass(frozen=True)
class Cost:
    """Legs in seconds and in percent of a battery, of any shape; inf where there is no way."""

    seconds: Array
    percent: Array


class LegCosts:
    """Costs of the legs of one survey over the ways of a roadmap, whose last n places are the n views.

    A place that the roadmap does not know is reckoned over free voxels, from rest to rest.
    """

    def __init__(self, roadmap: Roadmap, views: list[View], shooting: Shooting, mission: Mission,
                 airspace: Airspace) -> None:
        self._roadmap, self._airspace = roadmap, airspace
        self._energy, self._limits = energy_of(mission), Limits.of_fleet(mission.fleet)
        self._slow = replace(self._limits, speed_m_s=min(self._limits.speed_m_s, DETOUR_SPEED_M_S))
        self._margin_percent = mission.battery.threshold_percent - mission.battery.reserve_percent
        """What is given out ends at the threshold; vehicles refuse what would leave them less than the reserve."""
        self._first = len(roadmap.places_enu_m) - len(views)
        self._positions = roadmap.places_enu_m[self._first:]
        self._seconds = leg_seconds(roadmap, self._passing(views, shooting), self._limits, CORNER_PASS_M)
        chosen = slice(self._first, None)
        self.between = self._cost(self._positions[None] - self._positions[:, None], roadmap.lengths_m[chosen, chosen],
                                  self._seconds[chosen, chosen])
        rest_s = shooting.settle_s if shooting.stop else 0.0
        self.service = Cost(np.full(len(views), rest_s), np.full(len(views), self._energy.rest_percent(rest_s)))

    def from_place(self, place_enu_m: Array) -> Cost:
        """(n,) from a place to every view."""
        return self._cost(self._positions - place_enu_m, *self._ways(place_enu_m))

    def to_place(self, place_enu_m: Array) -> Cost:
        """(n,) from every view to a place."""
        return self._cost(place_enu_m - self._positions, *self._ways(place_enu_m))

    def home(self, hover_enu_m: Array, at_home_percent: float) -> Cost:
        """(n,) from every view to a vehicle's hover point: in energy as flown, or as much as the vehicle wants to see
        kept back before it accepts a view, where that is more. at_home_percent: kept for waiting and landing."""
        way = self.to_place(hover_enu_m)
        kept = way_home_percent(self._energy, hover_enu_m - self._positions, self._slow) + at_home_percent
        return Cost(way.seconds, np.maximum(way.percent, kept - self._margin_percent))

    def direct(self, from_enu_m: Array, to_enu_m: Array) -> Cost:
        """() from one place to another."""
        start, goal = (place_near(self._roadmap, p) for p in (from_enu_m, to_enu_m))
        if start is not None and goal is not None:
            return self._cost(to_enu_m - from_enu_m, self._roadmap.lengths_m[start, goal], self._seconds[start, goal])
        length = self._airspace.reach(from_enu_m, []).distance_to(to_enu_m[None])[0]
        return self._cost(to_enu_m - from_enu_m, length, self._rest_to_rest_s(length))

    def _passing(self, views: list[View], shooting: Shooting) -> Passing:
        def padded(values: Sequence[float]) -> Array:
            return np.concatenate([np.zeros(self._first), values])
        speed = [0.0 if shooting.stop else shooting.speed_m_s[v.view_id] for v in views]
        return Passing(padded([v.pose.yaw_enu_rad for v in views]), padded([v.pose.elevation_rad for v in views]),
                       padded(speed), padded([shooting.pass_m] * len(views)))

    def _ways(self, place_enu_m: Array) -> tuple[Array, Array]:
        """(n,) metres and seconds between a place and every view."""
        place = place_near(self._roadmap, place_enu_m)
        if place is not None:
            return self._roadmap.lengths_m[place, self._first:], self._seconds[place, self._first:]
        length = self._airspace.reach(place_enu_m, []).distance_to(self._positions)
        return length, self._rest_to_rest_s(length)

    def _rest_to_rest_s(self, length_m: Array) -> Array:
        known = np.isfinite(length_m)
        return np.where(known, leg_time_s(np.where(known, length_m, 0.0), self._limits), np.inf)

    def _cost(self, gap_enu_m: Array, length_m: Array, seconds: Array) -> Cost:
        known = np.isfinite(seconds)
        percent = self._energy.leg_percent(gap_enu_m, np.where(known, length_m, 0.0), np.where(known, seconds, 0.0))
        return Cost(seconds, np.where(known, percent, np.inf))
