"""A command as a vehicle gets it, whichever message it came in, and what may be answered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mav

from vehicle.dialects import Dialect

Answer = tuple[int, list[Any]]
"""MAV_RESULT, and the messages that follow the acknowledgement."""
ACCEPTED, DENIED, REJECTED, UNSUPPORTED = (mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_DENIED,
                                           mav.MAV_RESULT_TEMPORARILY_REJECTED, mav.MAV_RESULT_UNSUPPORTED)
PLACED = frozenset({mav.MAV_CMD_DO_REPOSITION, mav.MAV_CMD_NAV_TAKEOFF, mav.MAV_CMD_NAV_LAND})
"""Commands whose params 5 and 6 are a position."""


@dataclass(frozen=True)
class Request:
    """A command as it came. Of COMMAND_INT, params 5 and 6 are degrees where its frame is global."""

    command: int
    params: tuple[float, ...]
    sender: tuple[int, int]
    component: int
    frame: int = mav.MAV_FRAME_GLOBAL
    wants_ack: bool = True


def requests_of(message: Any, dialect: Dialect) -> Request | None:
    """The command in a message; None when it is something else."""
    sender, kind = (message.get_srcSystem(), message.get_srcComponent()), message.get_type()
    if kind == "COMMAND_LONG":
        return Request(message.command, tuple(getattr(message, f"param{n}") for n in range(1, 8)), sender,
                       message.target_component)
    if kind == "COMMAND_INT":
        placed = message.frame != mav.MAV_FRAME_MISSION and message.command in PLACED
        x, y = (message.x / 1e7, message.y / 1e7) if placed else (float(message.x), float(message.y))
        return Request(message.command, (message.param1, message.param2, message.param3, message.param4, x, y,
                                         message.z), sender, message.target_component, message.frame)
    if kind == "SET_MODE":
        main, sub = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24 & 0xFF
        mode = (main, sub) if dialect.name == "px4" else (message.custom_mode, 0)
        return Request(mav.MAV_CMD_DO_SET_MODE, (float(message.base_mode), *map(float, mode), 0.0, 0.0, 0.0, 0.0),
                       sender, 0, wants_ack=dialect.name == "ardupilot")
    return None
