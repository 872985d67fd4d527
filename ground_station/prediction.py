"""How a vehicle will fly a plan: the ground station smooths waypoints exactly as the vehicle does."""

from __future__ import annotations

import math

import numpy as np

from missions.mavlink import Waypoint
from missions.messages import VehicleState
from planning.trajectories import Flight, Limits, State, Via, fly_route


def predicted_flight(state: VehicleState, waypoints: list[Waypoint], limits: Limits) -> Flight:
    """From hovering over these waypoints, nobody and nothing in the way."""
    vias = [Via(np.array(w.position_enu_m), w.yaw_enu_rad, w.gimbal_elevation_rad, w.stop, w.settle_s, w.pass_m,
                w.speed_m_s or math.inf) for w in waypoints]
    return fly_route(State.at_rest(np.array(state.position_enu_m)), state.yaw_enu_rad, state.gimbal_elevation_rad, vias,
                     limits)
