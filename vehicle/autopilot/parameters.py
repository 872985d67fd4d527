"""Parameters under the names that users of PX4 and ArduPilot know. Each one is a field of the vehicle's settings."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import common as mav

from vehicle.autopilot.craft import FENCE, MISSION, RALLY, Craft
from vehicle.dialects import Dialect
from vehicle.failsafe_table import Action, Trigger
from vehicle.settings import Settings

REAL, INT = mav.MAV_PARAM_TYPE_REAL32, mav.MAV_PARAM_TYPE_INT32


@dataclass(frozen=True)
class Parameter:
    """One name. `put` returns the new settings; raises ValueError with a sentence when a value makes no sense."""

    name: str
    kind: int
    get: Callable[[Craft], float]
    put: Callable[[Craft, float], Settings] | None = None
    """None: read only."""


def _number(name: str, field: str, scale: float = 1.0) -> Parameter:
    """A field of the settings, in units of 1 / scale."""
    return Parameter(name, REAL, lambda craft: getattr(craft.settings, field) * scale,
                     lambda craft, value: craft.settings.with_number(field, value / scale))


def _takeoff(name: str, scale: float = 1.0) -> Parameter:
    return Parameter(name, REAL, lambda craft: (craft.takeoff_up_m - float(craft.executor.pad[2])) * scale,
                     lambda craft, value: replace(craft.settings, takeoff_altitude_m=value / scale))


def _action(name: str, numbers: dict[int, Action], *triggers: Trigger) -> Parameter:
    """What is done about these triggers."""
    def get(craft: Craft) -> float:
        action = craft.settings.steps(triggers[0])[0].action
        return float(next((n for n, a in numbers.items() if a is action), _nearest(numbers, action)))

    def put(craft: Craft, value: float) -> Settings:
        if value not in numbers:
            raise ValueError(f"{value:g} is not known here; give one of {', '.join(map(str, numbers))}.")
        settings = craft.settings
        for trigger in triggers:
            settings = settings.with_action(trigger, numbers[int(value)])
        return settings

    return Parameter(name, INT, get, put)


def _nearest(numbers: dict[int, Action], action: Action) -> int:
    """The number of the mildest action that is no milder."""
    worse = [n for n, a in numbers.items() if a >= action]
    return min(worse, key=lambda n: numbers[n]) if worse else max(numbers, key=lambda n: numbers[n])


def _fixed(name: str, kind: int, get: Callable[[Craft], float]) -> Parameter:
    return Parameter(name, kind, get)


PX4_PARAMETERS = (
    _fixed("MAV_SYS_ID", INT, lambda craft: craft.system),
    _number("MPC_XY_CRUISE", "cruise_m_s"), _number("MPC_ACC_HOR", "acceleration_m_s2"),
    _number("MPC_JERK_AUTO", "jerk_m_s3"), _number("MPC_Z_V_AUTO_UP", "climb_m_s"), _takeoff("MIS_TAKEOFF_ALT"),
    _number("BAT_LOW_THR", "battery_low_percent", 0.01), _number("BAT_CRIT_THR", "battery_critical_percent", 0.01),
    _number("BAT_EMERGEN_THR", "battery_emergency_percent", 0.01), _number("COM_DL_LOSS_T", "ground_lost_s"),
    _number("COM_FAIL_ACT_T", "hold_first_s"),
    _action("COM_LOW_BAT_ACT", {0: Action.WARN, 2: Action.LAND, 3: Action.RETURN}, Trigger.BATTERY_CRITICAL),
    _action("NAV_DLL_ACT", {0: Action.WARN, 1: Action.HOLD, 2: Action.RETURN, 3: Action.LAND}, Trigger.GROUND_LOST),
    _action("GF_ACTION", {1: Action.WARN, 2: Action.HOLD, 3: Action.RETURN, 5: Action.LAND},
            Trigger.FENCE_AHEAD, Trigger.FENCE_BREACHED),
    _fixed("CAL_GYRO0_ID", INT, lambda craft: 1.0), _fixed("CAL_ACC0_ID", INT, lambda craft: 1.0),
    _fixed("CAL_MAG0_ID", INT, lambda craft: 1.0), _fixed("SYS_HITL", INT, lambda craft: 0.0),
)
ARDUPILOT_PARAMETERS = (
    _fixed("SYSID_THISMAV", INT, lambda craft: craft.system),
    _number("WPNAV_SPEED", "cruise_m_s", 100.0), _number("WPNAV_ACCEL", "acceleration_m_s2", 100.0),
    _number("WPNAV_JERK", "jerk_m_s3"), _number("WPNAV_SPEED_UP", "climb_m_s", 100.0),
    _takeoff("PILOT_TKOFF_ALT", 100.0), _number("FS_GCS_TIMEOUT", "ground_lost_s"),
    _number("FENCE_MARGIN", "fence_margin_m"),
    _action("BATT_FS_LOW_ACT", {0: Action.WARN, 1: Action.LAND, 2: Action.RETURN}, Trigger.BATTERY_LOW),
    _action("BATT_FS_CRT_ACT", {0: Action.WARN, 1: Action.LAND, 2: Action.RETURN}, Trigger.BATTERY_CRITICAL),
    _action("FS_GCS_ENABLE", {0: Action.WARN, 1: Action.RETURN, 5: Action.LAND}, Trigger.GROUND_LOST),
    _action("FENCE_ACTION", {0: Action.WARN, 1: Action.RETURN, 2: Action.LAND, 4: Action.HOLD},
            Trigger.FENCE_AHEAD, Trigger.FENCE_BREACHED),
    Parameter("FENCE_ENABLE", INT, lambda craft: float(craft.fence_enabled)),
    _fixed("FENCE_TOTAL", INT, lambda craft: float(len(craft.shelves[FENCE].items))),
    _fixed("RALLY_TOTAL", INT, lambda craft: float(len(craft.shelves[RALLY].items))),
    _fixed("MIS_TOTAL", INT, lambda craft: float(len(craft.shelves[MISSION].items))),
    _fixed("FRAME_CLASS", INT, lambda craft: 1.0),
)
OF_DIALECT = {"px4": PX4_PARAMETERS, "ardupilot": ARDUPILOT_PARAMETERS}


def answer_list(craft: Craft, dialect: Dialect) -> list[Any]:
    """PARAM_VALUE of all."""
    table = OF_DIALECT[dialect.name]
    return [_value(p, n, craft, dialect) for n, p in enumerate(table)]


def answer_read(craft: Craft, dialect: Dialect, message: Any, sender: tuple[int, int]) -> list[Any]:
    """PARAM_VALUE of one, by name or index; PARAM_ERROR when there is none such."""
    table = OF_DIALECT[dialect.name]
    index = message.param_index if message.param_index >= 0 else _index(table, message.param_id)
    if index is None or index >= len(table):
        return [_error(message, sender, mav.MAV_PARAM_ERROR_DOES_NOT_EXIST)]
    return [_value(table[index], index, craft, dialect)]


def answer_set(craft: Craft, dialect: Dialect, message: Any, sender: tuple[int, int]) -> tuple[list[Any], str]:
    """Set one; the answers, and why it was refused."""
    table = OF_DIALECT[dialect.name]
    index = _index(table, message.param_id)
    if index is None:
        return [_error(message, sender, mav.MAV_PARAM_ERROR_DOES_NOT_EXIST)], ""
    parameter = table[index]
    if parameter.put is None:
        return [_error(message, sender, mav.MAV_PARAM_ERROR_READ_ONLY),
                _value(parameter, index, craft, dialect)], f"{parameter.name} is read only"
    value = _decoded(message.param_value, message.param_type, dialect)
    try:
        if not math.isfinite(value):
            raise ValueError("it is not a number.")
        craft.set(parameter.put(craft, value))
    except ValueError as e:
        return [_error(message, sender, mav.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE),
                _value(parameter, index, craft, dialect)], f"{parameter.name} stays: {e}"
    return [_value(parameter, index, craft, dialect)], ""


def refuse_set(message: Any, sender: tuple[int, int]) -> list[Any]:
    """PARAM_ERROR for somebody who may not set anything."""
    return [_error(message, sender, mav.MAV_PARAM_ERROR_PERMISSION_DENIED)]


def _value(parameter: Parameter, index: int, craft: Craft, dialect: Dialect) -> Any:
    value, count = parameter.get(craft), len(OF_DIALECT[dialect.name])
    return mav.MAVLink_param_value_message(parameter.name.encode(), _encoded(value, parameter.kind, dialect),
                                           parameter.kind, count, index)


def _encoded(value: float, kind: int, dialect: Dialect) -> float:
    """Integers travel as their bytes with PX4, as a cast with ArduPilot."""
    if kind == INT and dialect.bytewise_parameters:
        return float(struct.unpack("<f", struct.pack("<i", round(value)))[0])
    return float(value)


def _decoded(value: float, kind: int, dialect: Dialect) -> float:
    if kind == REAL or not dialect.bytewise_parameters:
        return float(value)
    return float(struct.unpack("<i", struct.pack("<f", value))[0])


def _index(table: tuple[Parameter, ...], name: str | bytes) -> int | None:
    text = (name.decode("ascii", "replace") if isinstance(name, bytes) else name).rstrip("\0")
    return next((n for n, p in enumerate(table) if p.name == text), None)


def _error(message: Any, sender: tuple[int, int], error: int) -> Any:
    name = message.param_id
    raw = name.encode() if isinstance(name, str) else bytes(name)
    return mav.MAVLink_param_error_message(*sender, raw, getattr(message, "param_index", -1), error)
