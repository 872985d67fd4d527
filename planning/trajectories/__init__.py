"""Jerk-limited motion: legs, stops and runs over several waypoints."""

from planning.trajectories.curve import Curve, State
from planning.trajectories.leg import Leg, Limits, brake, leg_time_s
from planning.trajectories.route import Flight, Via, fly_route, fly_run, straight_run

__all__ = ["Curve", "Flight", "Leg", "Limits", "State", "Via", "brake", "fly_route", "fly_run", "leg_time_s",
           "straight_run"]
