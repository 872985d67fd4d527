"""Jerk-limited motion: runs over several waypoints with blended corners, stops, and how fast a shutter may pass."""

from planning.trajectories.course import Clear, Via
from planning.trajectories.curve import Curve, State
from planning.trajectories.flight import Flight
from planning.trajectories.leg import brake, leg_time_s
from planning.trajectories.limits import Limits, shutter_speed_m_s
from planning.trajectories.run import MAX_RUN, fly_route, fly_run, run_length

__all__ = ["MAX_RUN", "Clear", "Curve", "Flight", "Limits", "State", "Via", "brake", "fly_route", "fly_run",
           "leg_time_s", "run_length", "shutter_speed_m_s"]
