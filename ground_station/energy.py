"""What vehicles can still afford, and what plans will take out of their batteries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ground_station.prediction import predicted_flight
from missions.frames import Array
from missions.mavlink import Waypoint
from missions.messages import SiteBrief, VehicleState
from missions.mission import Mission
from missions.pads import hover_points, takeoff_points
from planning.trajectories import Clear, Limits, leg_time_s
from planning.trajectories.energy import energy_of
from planning.trajectories.homing import DETOUR, VERTICAL_SPEED_M_S, vertical_percent, waiting_percent

EXPLORE_ENERGY_SHARE = 0.5
"""Share of the usable battery that exploration may take when a survey follows."""
HANDLING_S = 0.25
"""From sending a plan to the start of its flight, and from the end of its flight to the last picture."""


class EnergyBudget:
    """Energy in percent of a full battery, by the mission's model of consumption."""

    def __init__(self, mission: Mission, site: SiteBrief) -> None:
        self._battery, self._survey = mission.battery, mission.survey.enabled
        self._energy, self._limits = energy_of(mission), Limits.of_fleet(mission.fleet)
        self._hover = [np.array(p) for p in hover_points(mission, site)]
        vertical = replace(self._limits, speed_m_s=min(self._limits.speed_m_s, VERTICAL_SPEED_M_S))
        up = [hover - np.array(pad) for pad, hover in zip(takeoff_points(mission, site), self._hover, strict=True)]
        waiting = waiting_percent(self._energy, mission.fleet.vehicles - 1)
        self._take_off = [vertical_percent(self._energy, way, vertical) for way in up]
        self._at_home = [vertical_percent(self._energy, -way, vertical) + waiting for way in up]
        self._tick_s = mission.clock.tick_s
        self._anchor = mission.site.anchor

    def usable_percent(self, vehicle_id: int, level_percent: float, exploring: bool = False) -> float:
        """What a vehicle at this level may spend until it is home again: above the threshold, and exploring only its
        share of that when a survey follows. Negative when it should be home already."""
        keep = self._battery.threshold_percent
        if exploring and self._survey:
            keep += (1.0 - EXPLORE_ENERGY_SHARE) * max(0.0, self._battery.start_of(vehicle_id) - keep)
        return level_percent - keep

    def at_home_percent(self, vehicle_id: int) -> float:
        """What a vehicle keeps for the time over its pad: waiting for the others, and landing."""
        return self._at_home[vehicle_id - 1]

    def take_off_percent(self, vehicle_id: int) -> float:
        """From the pad to the hover point, where tours begin."""
        return self._take_off[vehicle_id - 1]

    def affordable(self, vehicle_id: int, from_enu_m: Array, goals_enu_m: Array, way_m: Array,
                   usable_percent: float) -> NDArray[np.bool_]:
        """(n,) which goals (n, 3) a vehicle can fly to, on ways of these lengths (n,), and then home."""
        home = self._hover[vehicle_id - 1] - goals_enu_m
        there = self._legs(goals_enu_m - from_enu_m, np.where(np.isfinite(way_m), way_m, 0.0))
        back = self._legs(home, DETOUR * np.linalg.norm(home, axis=1))
        return np.asarray(np.isfinite(way_m) & (there + back <= usable_percent))

    def route_percent(self, state: VehicleState, waypoints: list[Waypoint], clear: Clear | None = None) -> float:
        """Of flying these waypoints from hovering, as the vehicle will: smoothed, blending corners where that is
        `clear`, waiting for the next tick at every stop, hovering while the plan is on its way up and the last picture
        on its way down."""
        flight = predicted_flight(state, waypoints, self._limits, self._anchor, clear)
        hovering_s = HANDLING_S + 0.5 * self._tick_s * sum(w.stop for w in waypoints)
        return self._energy.curve_percent(flight.curve) + self._energy.rest_percent(hovering_s)

    def home_percent(self, vehicle_id: int, position_enu_m: Array) -> float:
        """Of flying home from a position, detours included."""
        home = (self._hover[vehicle_id - 1] - position_enu_m)[None]
        return float(self._legs(home, DETOUR * np.linalg.norm(home, axis=1))[0])

    def _legs(self, displacement_enu_m: Array, length_m: Array) -> Array:
        return self._energy.leg_percent(displacement_enu_m, length_m, leg_time_s(length_m, self._limits))
