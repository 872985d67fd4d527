"""A multirotor as a point with lag, in its own local frame (north, east, down): what its control loops make of it."""

from __future__ import annotations

import math

import numpy as np

from missions.frames import Array

KP, KV, LAG_S, MOST_M_S2 = 1.4, 2.4, 0.15, 5.0
YAW_RATE_RAD_S = 1.2


class PointMass:
    """Position and velocity follow what is asked for by a PD law whose acceleration lags."""

    def __init__(self) -> None:
        self.position = np.zeros(3)
        self.velocity = np.zeros(3)
        self.acceleration = np.zeros(3)
        self.yaw = 0.0
        self.wind = np.zeros(3)
        """(3,) m/s by which the air carries it, whatever the loops do; for gusts."""

    @property
    def on_ground(self) -> bool:
        return bool(self.position[2] >= 0.0)

    def follow(self, position: Array, velocity: Array, feed_forward: Array, yaw: float, dt: float) -> None:
        """One step of flight towards a moving point."""
        wanted = KP * (position - self.position) + KV * (velocity - self.velocity) + feed_forward
        size = float(np.linalg.norm(wanted))
        wanted *= min(1.0, MOST_M_S2 / max(size, 1e-9))
        self.acceleration += (wanted - self.acceleration) * min(1.0, dt / LAG_S)
        self._move(dt)
        turn = (yaw - self.yaw + math.pi) % math.tau - math.pi
        self.yaw += max(-YAW_RATE_RAD_S * dt, min(YAW_RATE_RAD_S * dt, turn))

    def keep_speed(self, velocity: Array, dt: float) -> None:
        """One step of flight at a velocity."""
        self.follow(self.position, velocity, np.zeros(3), self.yaw, dt)

    def rest(self) -> None:
        """Motors off, on the ground."""
        self.velocity[:] = self.acceleration[:] = 0.0

    def _move(self, dt: float) -> None:
        self.velocity += self.acceleration * dt
        self.position += (self.velocity + self.wind) * dt
        if self.on_ground:
            self.position[2] = 0.0
            self.velocity[:] = self.acceleration[:] = 0.0
