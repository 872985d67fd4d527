"""What exploration is asked, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass

from missions.camera import Pose
from missions.frames import Array
from missions.mavlink import Waypoint


@dataclass(frozen=True)
class Asking:
    """A hovering vehicle that wants a next view. usable_percent: of its battery, the way home included."""

    vehicle_id: int
    position_enu_m: Array
    yaw_enu_rad: float
    elevation_rad: float
    usable_percent: float


@dataclass(frozen=True)
class Busy:
    """A vehicle under way; goal is None when it has no view before it (it is climbing or going home)."""

    vehicle_id: int
    position_enu_m: Array
    goal: Pose | None


@dataclass(frozen=True)
class Leg:
    """A decision for one vehicle: the last waypoint is the key view."""

    vehicle_id: int
    waypoints: list[Waypoint]
    goal: Pose
    predicted_gain_m2: float | None = None
    """New surface that the key view is expected to show; None where it was not chosen for that."""


@dataclass(frozen=True)
class Decision:
    """Legs given out, vehicles that can reach no candidate at all, vehicles whose energy suffices for none, and
    vehicles whose energy does not suffice for all."""

    legs: list[Leg]
    stuck: list[int]
    spent: list[int]
    limited: list[int]
