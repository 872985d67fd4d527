"""One vehicle as the mission sees it: where it is in its own little life, what it has on board, who holds it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from ground_station.fleet_link import VehicleLink
from missions.frames import Array
from missions.mavlink import Waypoint
from missions.messages import FenceOrder, FenceVerdict, LegReport, VehicleState

FULL_PERCENT = 100.0
STANDING_M_S = 0.05


@dataclass
class FenceAsked:
    """An order to widen the fence, and the vehicle's verdict once it is there."""

    order: FenceOrder
    verdict: FenceVerdict | None = None


class Stage(Enum):
    """Where a vehicle is in its own little life."""

    PARKED = "parked"
    LAUNCHING = "launching"
    READY = "ready"
    FLYING = "flying"
    HOMING = "homing"
    SWAPPING = "swapping"
    MISSING = "missing"
    """Its process is gone; it may come back, and keeps its views for a while."""
    LOST = "lost"


@dataclass
class Drone:
    """One vehicle. `awaited` holds the views of its plan whose pictures have neither come nor been given up."""

    vehicle_id: int
    link: VehicleLink
    hover_enu_m: Array
    stage: Stage = Stage.PARKED
    awaited: list[int] = field(default_factory=list)
    goal: Waypoint | None = None
    reports: list[LegReport] = field(default_factory=list)
    reported: set[tuple[int, int]] = field(default_factory=set)
    """(plan, view) of all reports so far: vehicles repeat theirs to a ground station that was away."""
    refused: str = ""
    spent: bool = False
    """It came home by itself for lack of energy, or cannot take off: it flies no more with this battery."""
    dropped: bool = False
    """An operator has taken it out of the mission, or it is in reserve and has not been added yet."""
    reserve: bool = False
    """It has taken no part so far, and waits on its pad until an operator adds it."""
    fence_asked: FenceAsked | None = None
    """The newest order to widen the fence on board."""
    swaps_left: int = 0
    launches_failed: int = 0
    idle_since_ns: int = -1
    missing_since_ns: int = -1

    @property
    def gone(self) -> bool:
        """Whether there is no sign of life."""
        return self.stage in (Stage.MISSING, Stage.LOST)

    @property
    def state(self) -> VehicleState | None:
        """The newest state."""
        return self.link.telemetry.state

    @property
    def position_enu_m(self) -> Array:
        """(3,) the newest position; the hover point before anything is known."""
        return self.hover_enu_m if self.state is None else np.array(self.state.position_enu_m)

    @property
    def battery_percent(self) -> float:
        """The newest battery level; that of the new battery while it is put in."""
        if self.stage is Stage.SWAPPING:
            return FULL_PERCENT
        return self.link.telemetry.battery_percent if self.state is None else self.state.battery_percent

    @property
    def standing(self) -> bool:
        """Whether it does not move."""
        return self.state is not None and float(np.linalg.norm(self.state.velocity_enu_m_s)) < STANDING_M_S

    @property
    def available(self) -> bool:
        """Whether it can be given anything to fly, now or after a launch."""
        return not (self.spent or self.dropped) and self.stage is not Stage.LOST

    @property
    def held(self) -> bool:
        """Whether it waits, in the air or on its pad, until an operator resumes it: it is given nothing to fly, and
        nothing is taken from it."""
        return self.link.held

    @property
    def recalled(self) -> bool:
        """Whether an operator has called it home."""
        return self.held and self.stage in (Stage.HOMING, Stage.PARKED)

    @property
    def on_pad(self) -> bool:
        """Whether it stands on its pad as far as the mission knows."""
        return self.stage in (Stage.PARKED, Stage.SWAPPING)

    @property
    def airborne(self) -> bool:
        """Whether it is in the air as far as is known."""
        return self.stage is not Stage.LOST and self.state is not None and self.state.flying
