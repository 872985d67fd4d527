"""Plans that keep apart in time: the predicted flights of all vehicles, and how long the next one waits at its start.

Prioritised planning in the order in which plans are sent: what is under way is fixed, and the next plan is fitted
around it by waiting. Who is done with a plan soon goes on with the next, which keeps clear of all that is under way by
then, so its rest in between counts for REST_S only. What waiting cannot resolve is left to the vehicles, which yield
on board.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

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
REST_S = 8.0
SPARE_M = 0.4
"""Beyond the separation: vehicles launch only what keeps 0.3 m more than it by the announced trajectories."""


REST_STEPS, LONGEST_HOLD = round(REST_S / STEP_S), round(LONGEST_HOLD_S / STEP_S)


class Traffic:
    """What every vehicle that flies a plan is predicted to do."""

    def __init__(self, mission: Mission) -> None:
        self._limits = Limits.of_fleet(mission.fleet)
        self._anchor = mission.site.anchor
        self._apart_m = mission.fleet.separation_m + SPARE_M
        self._plans: dict[int, tuple[float, Array]] = {}

    def hold_s(self, state: VehicleState, waypoints: list[Waypoint], t_s: float, moving: Iterable[int],
               resting: Sequence[Array], lost: Sequence[Array]) -> float | None:
        """How long a hovering vehicle must wait before these waypoints so that nobody comes near; None when waiting
        does not help. moving: who else flies the plan that was told last; resting: where others hover that soon go on;
        lost: where nobody goes on."""
        mine = self._predicted(state, waypoints)
        others = [*(self._ahead(k, t_s) for k in moving if k in self._plans),
                  *(np.repeat(place[None], REST_STEPS, axis=0) for place in resting),
                  *(np.repeat(place[None], len(mine) + LONGEST_HOLD + REST_STEPS, axis=0) for place in lost)]
        for wait in range(0, LONGEST_HOLD, round(HOLD_STEP_S / STEP_S)):
            padded = np.pad(mine, ((wait, REST_STEPS), (0, 0)), mode="edge")
            if all(self._apart(padded, other) for other in others):
                return wait * STEP_S
        return None

    def flies(self, state: VehicleState, waypoints: list[Waypoint], t_s: float) -> None:
        """This plan is sent."""
        self._plans[state.vehicle_id] = t_s, self._predicted(state, waypoints)

    def _apart(self, a: Array, b: Array) -> bool:
        """Whether two tracks keep apart while both are known."""
        known = min(len(a), len(b))
        return bool(first_approach(a[:known], b[:known], math.ceil(SLACK_S / STEP_S), self._apart_m) == NEVER)

    def _ahead(self, vehicle_id: int, t_s: float) -> Array:
        """(n, 3) every STEP_S from now on, as long as it is known."""
        sent_s, track = self._plans[vehicle_id]
        gone = min(round((t_s - sent_s) / STEP_S), len(track) - 1)
        return np.pad(track[gone:], ((0, REST_STEPS), (0, 0)), mode="edge")

    def _predicted(self, state: VehicleState, waypoints: list[Waypoint]) -> Array:
        """(n, 3) every STEP_S from sending the plan until it is flown."""
        flight = predicted_flight(state, waypoints, self._limits, self._anchor)
        t_s = np.arange(0.0, flight.duration_s + UPLOAD_S + STEP_S, STEP_S) - UPLOAD_S
        return np.asarray(flight.curve.at(np.clip(t_s, 0.0, flight.duration_s))[0])


def holding(state: VehicleState, hold_s: float) -> Waypoint:
    """Where the vehicle is, for so long."""
    return Waypoint(position_enu_m=state.position_enu_m, yaw_enu_rad=state.yaw_enu_rad,
                    gimbal_elevation_rad=state.gimbal_elevation_rad, settle_s=hold_s)
