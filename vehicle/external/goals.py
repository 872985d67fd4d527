"""What a companion wants of an autopilot, and the next command towards it, by dialect.

Level-triggered: whatever is not yet as it should be is commanded again, so that losses, refusals ("not armable yet")
and repeats need no bookkeeping. Source: the observed behaviour of both autopilots (docs/external_autopilots.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from pymavlink.dialects.v20 import common as mav

from vehicle.dialects import Dialect, Mode
from vehicle.external.telemetry import Telemetry

NAN = math.nan
Params = tuple[float, float, float, float, float, float, float]


class Goal(Enum):
    """What the autopilot is to do."""

    NOTHING = "nothing"
    CLIMB = "take off"
    FOLLOW = "follow set-points"
    LAND = "land"
    RETURN = "return"


@dataclass(frozen=True)
class Order:
    """A COMMAND_LONG."""

    command: int
    params: Params


def setpoint_mode(dialect: Dialect) -> Mode:
    """The mode in which set-points are followed: PX4 calls it offboard, ArduPilot guided."""
    return "offboard" if "offboard" in dialect.mode_numbers else "guided"


def modes_of(goal: Goal, dialect: Dialect) -> frozenset[Mode]:
    """The modes in which the autopilot works at a goal; any other one was chosen by somebody else."""
    climbing: tuple[Mode, ...] = ("takeoff", "hold") if "takeoff" in dialect.mode_numbers else ("guided",)
    modes: dict[Goal, tuple[Mode, ...]] = {
        Goal.NOTHING: (), Goal.CLIMB: climbing, Goal.FOLLOW: (setpoint_mode(dialect),), Goal.LAND: ("land",),
        Goal.RETURN: ("return", "land")}
    return frozenset(modes[goal])


def next_order(goal: Goal, said: Telemetry, height_m: float) -> Order | None:
    """What to command now; None when the autopilot is at it. height_m: of a climb, above the ground it stands on."""
    if said.dialect is None:
        return None
    return _RULES[goal](said, said.dialect, height_m)


def set_mode(dialect: Dialect, mode: Mode) -> Order:
    """DO_SET_MODE: PX4 takes main and sub mode apart, ArduPilot the number as it is."""
    number = dialect.mode_numbers[mode]
    custom, sub = (number >> 16 & 0xFF, number >> 24) if dialect.name == "px4" else (number, 0)
    return Order(mav.MAV_CMD_DO_SET_MODE,
                 (float(mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(custom), float(sub), 0.0, 0.0, 0.0, 0.0))


def _nothing(said: Telemetry, dialect: Dialect, height_m: float) -> Order | None:
    return None


def _climb(said: Telemetry, dialect: Dialect, height_m: float) -> Order | None:
    if said.mode not in modes_of(Goal.CLIMB, dialect):
        return set_mode(dialect, "hold" if "takeoff" in dialect.mode_numbers else "guided")
    if not said.armed:
        return _arm(1.0)
    if said.landed is not False and said.mode != "takeoff":
        return _take_off(said, dialect, height_m)
    return None


def _take_off(said: Telemetry, dialect: Dialect, height_m: float) -> Order | None:
    """PX4 is told a height above mean sea level, ArduPilot one above home."""
    if dialect.name != "px4":
        return Order(mav.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m))
    if said.geodetic is None:
        return None
    return Order(mav.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, NAN, NAN, NAN, said.geodetic[2] + height_m))


def _follow(said: Telemetry, dialect: Dialect, height_m: float) -> Order | None:
    mode = setpoint_mode(dialect)
    return None if said.mode == mode else set_mode(dialect, mode)


def _land(said: Telemetry, dialect: Dialect, height_m: float) -> Order | None:
    """Autopilots disarm by themselves when they have landed, if nobody has switched that off."""
    if not said.armed:
        return None
    if said.mode != "land":
        return set_mode(dialect, "land")
    return _arm(0.0) if said.landed else None


def _arm(yes: float) -> Order:
    """Or disarm, which an autopilot refuses in the air."""
    return Order(mav.MAV_CMD_COMPONENT_ARM_DISARM, (yes, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def _return(said: Telemetry, dialect: Dialect, height_m: float) -> Order | None:
    return set_mode(dialect, "return") if said.armed and said.mode not in ("return", "land") else None


_RULES: dict[Goal, Callable[[Telemetry, Dialect, float], Order | None]] = {
    Goal.NOTHING: _nothing, Goal.CLIMB: _climb, Goal.FOLLOW: _follow, Goal.LAND: _land, Goal.RETURN: _return}
