"""How a vehicle will fly a plan: the ground station smooths waypoints exactly as the vehicle does."""

from __future__ import annotations

import math

import numpy as np

from missions.frames import Site
from missions.mavlink import Route, Waypoint, items_from_route, route_from_items
from missions.messages import VehicleState
from planning.trajectories import Clear, Flight, Limits, State, Via, fly_route


def predicted_flight(state: VehicleState, waypoints: list[Waypoint], limits: Limits, anchor: Site,
                     clear: Clear | None = None) -> Flight:
    """From hovering over these waypoints, nobody and nothing in the way. clear: where corners may be blended; left out,
    everywhere."""
    waypoints = as_received(waypoints, anchor)
    vias = [Via(np.array(w.position_enu_m), w.yaw_enu_rad, w.gimbal_elevation_rad, w.stop, w.settle_s, w.pass_m,
                w.speed_m_s or math.inf) for w in waypoints]
    return fly_route(State.at_rest(np.array(state.position_enu_m)), state.yaw_enu_rad, state.gimbal_elevation_rad, vias,
                     limits, clear)


def as_received(waypoints: list[Waypoint], anchor: Site) -> list[Waypoint]:
    """The waypoints as the vehicle reads them: MAVLink rounds positions to about 1 cm, which bends short stretches."""
    sent = Route(plan_id=0, phase="explore", waypoints=waypoints)
    return route_from_items(items_from_route(sent, anchor), anchor, sent.plan_id).waypoints
