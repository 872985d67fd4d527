"""What an autopilot has said of itself. What it has not said is None: a default is not a fact."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions.frames import Array
from vehicle.dialects import Dialect, Mode, dialect_of

NEVER = -math.inf
STALE_S = 10.0
"""A charge this old is none."""


@dataclass(frozen=True)
class Telemetry:
    """The newest of each kind. Times are seconds of the link's clock."""

    dialect: Dialect | None = None
    mode: Mode | None = None
    """None as well for a mode that this project does not know."""
    armed: bool | None = None
    heartbeat_s: float = NEVER
    position_ned_m: Array | None = None
    """(3,) in the autopilot's local frame."""
    velocity_ned_m_s: Array = field(default_factory=lambda: np.zeros(3))
    position_s: float = NEVER
    geodetic: tuple[float, float, float] | None = None
    """Latitude and longitude in degrees, altitude above mean sea level in metres."""
    heading_rad: float | None = None
    """Clockwise from North."""
    landed: bool | None = None
    battery_percent: float | None = None
    battery_s: float = NEVER
    last_text: str = ""
    """Its newest warning."""

    @property
    def located(self) -> bool:
        """Whether it knows where it is, on its own map and on Earth's."""
        return self.position_ned_m is not None and self.geodetic is not None and self.heading_rad is not None

    def battery_known(self, t_s: float) -> bool:
        """Whether the charge was told of late."""
        return self.battery_percent is not None and t_s - self.battery_s < STALE_S


def heard(before: Telemetry, message: Any, t_s: float) -> Telemetry:
    """What is known after a message of the autopilot."""
    handler = _HANDLERS.get(message.get_type())
    return before if handler is None else handler(before, message, t_s)


def _heartbeat(before: Telemetry, message: Any, t_s: float) -> Telemetry:
    dialect = dialect_of(message.autopilot)
    if dialect is None and before.dialect is not None:
        return before  # something else that goes by this system id
    mode = dialect.mode_of(message.custom_mode) if dialect is not None else None
    return replace(before, dialect=dialect, mode=mode, heartbeat_s=t_s,
                   armed=bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED))


def _local_position(before: Telemetry, message: Any, t_s: float) -> Telemetry:
    motion = np.array([message.x, message.y, message.z, message.vx, message.vy, message.vz], dtype=np.float64)
    if not np.isfinite(motion).all():
        return before
    return replace(before, position_ned_m=motion[:3], velocity_ned_m_s=motion[3:], position_s=t_s)


def _global_position(before: Telemetry, message: Any, t_s: float) -> Telemetry:
    if message.lat == 0 and message.lon == 0:
        return before  # what an autopilot sends that has no fix yet
    return replace(before, geodetic=(message.lat / 1e7, message.lon / 1e7, message.alt / 1e3))


def _attitude(before: Telemetry, message: Any, t_s: float) -> Telemetry:
    return replace(before, heading_rad=float(message.yaw)) if math.isfinite(message.yaw) else before


def _extended_state(before: Telemetry, message: Any, t_s: float) -> Telemetry:
    if message.landed_state == mav.MAV_LANDED_STATE_UNDEFINED:
        return before
    return replace(before, landed=message.landed_state == mav.MAV_LANDED_STATE_ON_GROUND)


def _battery(before: Telemetry, message: Any, t_s: float) -> Telemetry:
    if getattr(message, "id", 0) != 0 or not 0 <= message.battery_remaining <= 100:
        return before
    return replace(before, battery_percent=float(message.battery_remaining), battery_s=t_s)


def _text(before: Telemetry, message: Any, t_s: float) -> Telemetry:
    return replace(before, last_text=message.text) if message.severity <= mav.MAV_SEVERITY_WARNING else before


_HANDLERS: dict[str, Callable[[Telemetry, Any, float], Telemetry]] = {
    "HEARTBEAT": _heartbeat, "LOCAL_POSITION_NED": _local_position, "GLOBAL_POSITION_INT": _global_position,
    "ATTITUDE": _attitude, "EXTENDED_SYS_STATE": _extended_state, "BATTERY_STATUS": _battery, "STATUSTEXT": _text,
}
