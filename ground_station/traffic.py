"""Plans that keep apart in time: the predicted flights of all vehicles, and how long the next one waits at its start.

Prioritised planning in the order in which plans are sent: what is under way is fixed, and the next plan is fitted
around it by waiting. A vehicle rests at its plan's end, so plans that keep clear of it do so however long it rests.
What waiting cannot resolve is left to the vehicles, which yield on board.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from ground_station.prediction import predicted_flight
from missions.frames import Array
from missions.mavlink import Waypoint
from missions.messages import VehicleState
from missions.mission import Mission
from planning.deconflict import NEVER, first_approach
from planning.deconflict.schedule import HOLD_STEP_S, SLACK_S, STEP_S
from planning.trajectories import Limits

UPLOAD_S = 0.3
"""From sending a plan until it is flown."""
LONGEST_HOLD_S = 60.0
SPARE_M = 0.4
"""Beyond the separation: vehicles launch only what keeps 0.3 m more than it by the announced trajectories."""


class Traffic:
    """What every vehicle that flies a plan is predicted to do."""

    def __init__(self, mission: Mission) -> None:
        self._limits = Limits.of_fleet(mission.fleet)
        self._apart_m = mission.fleet.separation_m + SPARE_M
        self._plans: dict[int, tuple[float, Array]] = {}

    def hold_s(self, state: VehicleState, waypoints: list[Waypoint], t_s: float, resting: Mapping[int, Array],
               moving: Iterable[int]) -> float | None:
        """How long a hovering vehicle must wait before these waypoints so that nobody comes near; None when waiting
        does not help. resting: where others hover; moving: who else flies the plan that was told last."""
        mine = self._predicted(state, waypoints)
        most = len(mine) + round(LONGEST_HOLD_S / STEP_S)
        others = [np.repeat(place[None], most, axis=0) for k, place in resting.items() if k != state.vehicle_id]
        others += [self._ahead(k, t_s, most) for k in moving if k in self._plans]
        window = math.ceil(SLACK_S / STEP_S)
        for wait in range(0, round(LONGEST_HOLD_S / STEP_S), round(HOLD_STEP_S / STEP_S)):
            padded = np.pad(mine, ((wait, most - len(mine) - wait), (0, 0)), mode="edge")
            if all(first_approach(padded, other, window, self._apart_m) == NEVER for other in others):
                return wait * STEP_S
        return None

    def flies(self, state: VehicleState, waypoints: list[Waypoint], t_s: float) -> None:
        """This plan is sent."""
        self._plans[state.vehicle_id] = t_s, self._predicted(state, waypoints)

    def _ahead(self, vehicle_id: int, t_s: float, count: int) -> Array:
        """(count, 3) every STEP_S from now on."""
        sent_s, track = self._plans[vehicle_id]
        steps = np.arange(count) + round((t_s - sent_s) / STEP_S)
        return np.asarray(track[np.clip(steps, 0, len(track) - 1)])

    def _predicted(self, state: VehicleState, waypoints: list[Waypoint]) -> Array:
        """(n, 3) every STEP_S from sending the plan until it is flown."""
        flight = predicted_flight(state, waypoints, self._limits)
        t_s = np.arange(0.0, flight.duration_s + UPLOAD_S + STEP_S, STEP_S) - UPLOAD_S
        return np.asarray(flight.curve.at(np.clip(t_s, 0.0, flight.duration_s))[0])


def holding(state: VehicleState, hold_s: float) -> Waypoint:
    """Where the vehicle is, for so long."""
    return Waypoint(position_enu_m=state.position_enu_m, yaw_enu_rad=state.yaw_enu_rad,
                    gimbal_elevation_rad=state.gimbal_elevation_rad, settle_s=hold_s)
