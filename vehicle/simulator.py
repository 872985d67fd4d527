"""The simulated body: it is exactly where its trajectory says (kinematic; no dynamics, no wind)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missions.camera import Pose
from missions.frames import Array
from missions.messages import vector
from planning.trajectories import Curve, Flight, State
from vehicle.health import HEALTHY

NS = 1_000_000_000


@dataclass(frozen=True)
class Kinematics:
    """Where the simulated body is, how it moves, and where its camera looks."""

    state: State
    yaw_enu_rad: float
    gimbal_elevation_rad: float

    @property
    def speed_m_s(self) -> float:
        """Norm of the velocity."""
        return float(np.linalg.norm(self.state.velocity))

    @property
    def pose(self) -> Pose:
        """Of the camera, which sits at the body's centre."""
        return Pose(vector(self.state.position), self.yaw_enu_rad, self.gimbal_elevation_rad)


class KinematicSimulator:
    """Follows one flight at a time; rests at its end. Never anywhere else than where its flight has it."""

    astray: Flight | None = None
    surrendered = False
    health = HEALTHY

    def __init__(self, position_enu_m: Array, yaw_enu_rad: float) -> None:
        self.flight = resting(position_enu_m, yaw_enu_rad, 0.0)
        self.start_ns = 0

    def step(self, t_ns: int) -> None:
        """Nothing to take in."""

    def fly(self, flight: Flight, t_ns: int) -> None:
        """Follow this flight from now; it must begin in the present state."""
        self.flight, self.start_ns = flight, t_ns

    def elapsed_s(self, t_ns: int) -> float:
        """Time on the present flight."""
        return (t_ns - self.start_ns) / NS

    @property
    def end_ns(self) -> int:
        """When the present flight ends."""
        return self.start_ns + round(self.flight.duration_s * NS)

    def at(self, t_ns: int) -> Kinematics:
        """The kinematics at a time."""
        t = self.elapsed_s(t_ns)
        return Kinematics(self.flight.curve.state(t), *self.flight.attitude(t))

    def measured(self, t_ns: int) -> Kinematics:
        """The same: it measures exactly."""
        return self.at(t_ns)

    def take_texts(self) -> list[str]:
        """It has nothing to say."""
        return []


def resting(position_enu_m: Array, yaw_enu_rad: float, gimbal_elevation_rad: float) -> Flight:
    """No motion at all."""
    return coasting(Curve.hold(position_enu_m, 0.0), yaw_enu_rad, gimbal_elevation_rad)


def coasting(curve: Curve, yaw_enu_rad: float, gimbal_elevation_rad: float) -> Flight:
    """Motion with the camera left as it is."""
    return Flight(curve, np.array([curve.duration_s]), np.zeros(1), np.array([yaw_enu_rad]),
                  np.array([gimbal_elevation_rad]))

