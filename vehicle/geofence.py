"""The volume that a vehicle does not leave: the mission's box, and the polygons and circles that somebody uploaded.

A fence that only acts once it is crossed is crossed. What is asked here is where the vehicle would come to rest if it
braked at the next look: that place, and the way there, must lie inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missions.frames import Array
from planning.trajectories import Flight, Limits

FENCE_TOLERANCE_M = 0.05
"""Waypoints may lie this far outside: MAVLink rounds positions to about 1 cm."""
STEP_S = 0.05
STEP_M = 0.1


@dataclass(frozen=True)
class Circle:
    """A zone around a place, from the ground up."""

    center_enu_m: Array
    """(2,)"""
    radius_m: float


@dataclass(frozen=True, eq=False)
class Geofence:
    """Inside is what lies in the box, in one at least of the zones to stay in (where there are any), and in none of
    those to stay out of. Zones are polygons (n, 2), n >= 3, or circles, without floor and ceiling."""

    lower_enu_m: Array
    upper_enu_m: Array
    stay_in: tuple[Array | Circle, ...] = ()
    stay_out: tuple[Array | Circle, ...] = ()

    def room_m(self, points_enu_m: Array) -> Array:
        """(n,) how far points (n, 3) lie inside; negative outside. Never more than the distance to the border."""
        points = np.atleast_2d(points_enu_m)
        below, above = points - self.lower_enu_m, self.upper_enu_m - points
        room = np.minimum(below, above).min(axis=1)
        if self.stay_in:
            room = np.minimum(room, np.max([_depth_m(zone, points[:, :2]) for zone in self.stay_in], axis=0))
        for zone in self.stay_out:
            room = np.minimum(room, -_depth_m(zone, points[:, :2]))
        return np.asarray(np.where(np.isfinite(points).all(axis=1), room, -np.inf))

    def more_than(self, lower_enu_m: Array, upper_enu_m: Array) -> bool:
        """Whether it keeps the vehicle out of anything in this box."""
        smaller = bool(np.any(self.lower_enu_m > lower_enu_m) or np.any(self.upper_enu_m < upper_enu_m))
        return smaller or bool(self.stay_in) or bool(self.stay_out)

    def holds_flight(self, flight: Flight, from_s: float, margin_m: float) -> bool:
        """Whether the rest of a flight stays this far inside."""
        return bool(self.room_m(flight.curve.sample(STEP_S, from_s)[1]).min() >= margin_m)

    def stops_inside(self, flight: Flight, brake_at_s: float, margin_m: float) -> bool:
        """Whether a vehicle on this flight that brakes at that time has stayed inside until it rests."""
        stop = flight.stop(brake_at_s).curve
        return bool(self.room_m(stop.sample(STEP_S)[1]).min() >= margin_m)

    def holds_drift(self, position_enu_m: Array, velocity_enu_m_s: Array, limits: Limits, look_s: float,
                    margin_m: float) -> bool:
        """The same for a vehicle that is not where its flight has it: it is taken to go straight on until the next
        look, and then to need the whole stopping distance."""
        speed = float(np.linalg.norm(velocity_enu_m_s))
        reach = speed * look_s + (stopping_distance_m(speed, limits) if speed > 0.0 else 0.0)
        ahead = np.linspace(0.0, reach, 1 + max(1, round(reach / STEP_M)))
        direction = velocity_enu_m_s / max(speed, 1e-9)
        return bool(self.room_m(position_enu_m + ahead[:, None] * direction).min() >= margin_m)


def stopping_distance_m(speed_m_s: float, limits: Limits) -> float:
    """From this speed to rest, at most: v^2 / 2a + v a / 2j, exact where the full acceleration a is reached. It may be
    speeding up by a as it begins to brake: until the jerk has undone that, it gains a^2 / 2j in a / j."""
    _, acceleration, jerk = limits.motion
    undone_s = acceleration / jerk
    top = speed_m_s + 0.5 * acceleration * undone_s
    return top * undone_s + 0.5 * top * (top / acceleration + undone_s)


def _depth_m(zone: Array | Circle, points: Array) -> Array:
    """(n,) how far points (n, 2) lie inside a zone; negative outside."""
    if isinstance(zone, Circle):
        return np.asarray(zone.radius_m - np.linalg.norm(points - zone.center_enu_m, axis=1))
    a, b = zone, np.roll(zone, -1, axis=0)
    edge, away = b - a, points[:, None] - a
    along = np.clip((away * edge).sum(axis=2) / np.maximum((edge * edge).sum(axis=1), 1e-12), 0.0, 1.0)
    apart = np.linalg.norm(away - along[:, :, None] * edge, axis=2).min(axis=1)
    spans = (a[:, 1] > points[:, 1, None]) != (b[:, 1] > points[:, 1, None])
    slope = np.where(spans, (points[:, 1, None] - a[:, 1]) / np.where(edge[:, 1] == 0.0, 1.0, edge[:, 1]), 0.0)
    crossed = spans & (points[:, 0, None] < a[:, 0] + slope * edge[:, 0])
    return np.asarray(np.where(crossed.sum(axis=1) % 2 == 1, apart, -apart))
