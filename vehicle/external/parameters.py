"""Parameters of the autopilot that a flight depends on: read at connect, changed where they would not do.

What happens to the aircraft when this process dies is the autopilot's own failsafe: it is checked here that it has one.
Speeds are checked because an autopilot that may not fly as fast as the mission plans would fall behind every leg.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common as mav

from missions.mavlink import AUTOPILOT_COMPONENT
from missions.mission import FleetSpec
from vehicle.dialects import Dialect

ASK_S, TRIES = 0.5, 6
RETURN, LAND, HOLD = 3.0, 4.0, 5.0
"""PX4's COM_OBL_RC_ACT."""
SPARE = 1.2
"""Speeds may be exceeded by so much while the aircraft catches up."""
ROUNDED = 0.999
"""Of what was asked for, a float32 may come back."""
_INTEGERS = {mav.MAV_PARAM_TYPE_UINT8: "<B3x", mav.MAV_PARAM_TYPE_INT8: "<b3x", mav.MAV_PARAM_TYPE_UINT16: "<H2x",
             mav.MAV_PARAM_TYPE_INT16: "<h2x", mav.MAV_PARAM_TYPE_UINT32: "<I", mav.MAV_PARAM_TYPE_INT32: "<i"}


@dataclass(frozen=True)
class Wish:
    """One parameter as it has to be. names: the newest first, of autopilots of several years."""

    names: tuple[str, ...]
    will_do: Callable[[float], bool]
    wanted: float
    vital: bool
    """Whether nothing is flown without it."""


@dataclass
class Setup:
    """Wishes on their way. `over` when each was granted, refused or is unknown to the autopilot."""

    system: int
    dialect: Dialect
    wishes: list[Wish]
    changed: list[str] = field(default_factory=list)
    _tries: dict[str, int] = field(default_factory=dict)
    _asked_s: float = -1e9
    _told: bool = False

    def poll(self, values: dict[str, tuple[float, int]], t_s: float) -> list[mav.MAVLink_message]:
        """Requests that are due. values: what the autopilot has told, as it travelled."""
        if t_s - self._asked_s < ASK_S:
            return []
        self._asked_s, self._told = t_s, True
        out = []
        for wish in self.wishes:
            name = _told_name(wish, values)
            if name is None:
                out += [self._read(n) for n in wish.names if self._may_try(n)]
            elif not wish.will_do(self.decoded(*values[name])) and self._may_try(f"{name}="):
                self._note_change(name, values[name], wish.wanted)
                out.append(self._set(name, wish.wanted, values[name][1]))
        return out

    def unmet(self, values: dict[str, tuple[float, int]], vital: bool) -> list[str]:
        """Names of such wishes that are not as they have to be."""
        return [wish.names[0] for wish in self.wishes if wish.vital == vital and not self._met(wish, values)]

    def over(self, values: dict[str, tuple[float, int]]) -> bool:
        """Whether there is nothing left to try."""
        return self._told and all(self._met(w, values) or self._tried(w, values) for w in self.wishes)

    def decoded(self, value: float, kind: int) -> float:
        """A PARAM_VALUE's number: PX4 sends the bytes of an integer in the place of a float's."""
        if not self.dialect.bytewise_parameters or kind not in _INTEGERS:
            return value
        return float(struct.unpack(_INTEGERS[kind], struct.pack("<f", value))[0])

    def encoded(self, value: float, kind: int) -> float:
        """The other way round."""
        if not self.dialect.bytewise_parameters or kind not in _INTEGERS:
            return value
        return float(struct.unpack("<f", struct.pack(_INTEGERS[kind], round(value)))[0])

    def _met(self, wish: Wish, values: dict[str, tuple[float, int]]) -> bool:
        name = _told_name(wish, values)
        return name is not None and wish.will_do(self.decoded(*values[name]))

    def _tried(self, wish: Wish, values: dict[str, tuple[float, int]]) -> bool:
        name = _told_name(wish, values)
        keys = wish.names if name is None else (f"{name}=",)
        return all(self._tries.get(key, 0) >= TRIES for key in keys)

    def _may_try(self, key: str) -> bool:
        self._tries[key] = self._tries.get(key, 0) + 1
        return self._tries[key] <= TRIES

    def _note_change(self, name: str, told: tuple[float, int], wanted: float) -> None:
        if self._tries[f"{name}="] == 1:
            self.changed.append(f"{name} from {self.decoded(*told):g} to {wanted:g}")

    def _read(self, name: str) -> mav.MAVLink_message:
        return mav.MAVLink_param_request_read_message(self.system, AUTOPILOT_COMPONENT, name.encode(), -1)

    def _set(self, name: str, value: float, kind: int) -> mav.MAVLink_message:
        return mav.MAVLink_param_set_message(self.system, AUTOPILOT_COMPONENT, name.encode(),
                                             self.encoded(value, kind), kind)


def wishes_for(dialect: Dialect, fleet: FleetSpec) -> list[Wish]:
    """What an autopilot of this dialect needs to fly this fleet's flights."""
    speed = SPARE * fleet.speed_m_s
    if dialect.name == "px4":
        return [
            Wish(("COM_OF_LOSS_T",), lambda v: 0.3 <= v <= 2.0, 1.0, vital=True),
            Wish(("COM_OBL_RC_ACT",), lambda v: v in (RETURN, LAND, HOLD), HOLD, vital=True),
            *(Wish((name,), lambda v: v >= ROUNDED * speed, speed, vital=False)
              for name in ("MPC_XY_VEL_MAX", "MPC_Z_VEL_MAX_UP", "MPC_Z_VEL_MAX_DN"))]
    return [
        Wish(("GUID_TIMEOUT",), lambda v: 0.3 <= v <= 3.0, 3.0, vital=True),
        *(Wish((f"WPNAV_{name}",), lambda v: v >= ROUNDED * 100.0 * speed, 100.0 * speed, vital=False)
          for name in ("SPEED", "SPEED_UP", "SPEED_DN"))]


def _told_name(wish: Wish, values: dict[str, tuple[float, int]]) -> str | None:
    return next((name for name in wish.names if name in values), None)
