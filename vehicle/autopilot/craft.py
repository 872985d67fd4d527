"""What all faces of a vehicle show and serve: one body, one plan, one camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions.camera import Camera
from missions.frames import Array, Site
from missions.mavlink import Item
from missions.messages import PictureMeta, RangeScan, Vector, vector
from vehicle.autopilot.photos import Photos
from vehicle.executor import Executor
from vehicle.failsafe_table import Action, Trigger
from vehicle.settings import Settings

MISSION, FENCE, RALLY = mav.MAV_MISSION_TYPE_MISSION, mav.MAV_MISSION_TYPE_FENCE, mav.MAV_MISSION_TYPE_RALLY


@dataclass
class Shelf:
    """The accepted items of one mission type, and the number of the one that is next."""

    items: list[Item] = field(default_factory=list)
    current: int = 0

    def put(self, items: list[Item]) -> None:
        """A new plan."""
        self.items, self.current = items, 0

    def reached(self, seq: int) -> None:
        """This item is done."""
        self.current = min(seq + 1, max(0, len(self.items) - 1))


@dataclass
class Craft:
    """One vehicle as MAVLink describes it."""

    system: int
    site: Site
    executor: Executor
    photos: Photos
    survey_camera: Camera
    settings: Settings
    """What may be set in flight; see `set`."""
    apply: Callable[[Settings], None]
    """Makes new settings felt."""
    fastest_m_s: float
    shelves: dict[int, Shelf] = field(default_factory=lambda: {kind: Shelf() for kind in (MISSION, FENCE, RALLY)})
    scan: RangeScan | None = None
    """The newest of the range sensor."""
    fence_enabled: bool = True
    amiss: frozenset[Trigger] = frozenset()
    """What the failsafe sees, and what it does about it."""
    action: Action = Action.NONE
    endurance_s: float = 0.0
    """How long a full battery hovers."""
    why_not_there: Callable[[Array], str] = lambda point_enu_m: ""
    """Why a point (3,) may not be flown to; "" when it may."""

    @property
    def takeoff_up_m(self) -> float:
        """Height in ENU to which the vehicle takes off when nobody says another one."""
        given = self.settings.takeoff_altitude_m
        return float(self.executor.hover[2]) if given is None else given + float(self.executor.pad[2])

    def set(self, settings: Settings) -> None:
        """Change what may be set in flight."""
        self.settings = settings
        self.apply(settings)

    def set_speed(self, speed_m_s: float) -> None:
        """Fly this fast from now on, but never faster than the mission's vehicles do."""
        self.set(replace(self.settings, cruise_m_s=min(speed_m_s, self.fastest_m_s)))

    @property
    def plan(self) -> Shelf:
        """The flight plan."""
        return self.shelves[MISSION]

    @property
    def images(self) -> list[PictureMeta]:
        """All pictures in storage, in the order of their index."""
        return self.executor.camera.captured

    def geodetic(self, position_enu_m: Vector) -> tuple[int, int, int, int]:
        """degE7, degE7, mm above the ellipsoid of the site, mm above home."""
        lat, lon, alt = self.site.geodetic_from_enu(np.array(position_enu_m))
        above = position_enu_m[2] - float(self.executor.pad[2])
        return round(lat * 1e7), round(lon * 1e7), round(alt * 1000), round(above * 1000)

    @property
    def home(self) -> tuple[int, int, int, int]:
        """The pad, likewise."""
        return self.geodetic(vector(self.executor.pad))
