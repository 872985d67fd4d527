"""What PX4 and ArduPilot Copter do differently, in one table.

A vehicle shows itself to other ground stations in one of these dialects, and reads the table again when a real
autopilot is its body. Numbers: PX4 `px4_custom_mode.h` (main << 16 | sub << 24), ArduCopter `mode.h`; behaviour as
observed on simulated builds of both (docs/protocol.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pymavlink.dialects.v20 import common as mav

Mode = Literal["hold", "guided", "offboard", "takeoff", "mission", "return", "land", "manual"]


@dataclass(frozen=True)
class Dialect:
    """How one kind of autopilot speaks MAVLink."""

    name: Literal["px4", "ardupilot"]
    autopilot: int
    """MAV_AUTOPILOT of its heartbeat."""
    mode_numbers: dict[Mode, int]
    """custom_mode by which each mode is commanded and shown."""
    other_numbers: dict[int, Mode]
    """custom_mode numbers that mean the same as one of these modes, or that only a person's hands fly."""
    item_zero_is_home: bool
    """Item 0 of a mission is the home position and is not flown; counts of MISSION_CURRENT leave it out."""
    request_ints: bool
    """An upload is asked for by MISSION_REQUEST_INT, else by MISSION_REQUEST."""
    unset: float
    """What an unused parameter of an item or command is sent as."""
    nan_allowed: bool
    """Whether NaN is taken in parameters of mission items that are not positions or headings."""
    bytewise_parameters: bool
    """Integer parameters travel as their bytes, else as a cast to float."""
    streams_unasked: bool
    """Telemetry comes by itself, else each message has to be asked for."""
    arms_in_mission: bool
    """Arming is allowed with the mission mode set; else in the guided mode alone, then the mode is changed."""
    starts_by_command: bool
    """A mission starts with MISSION_START in addition to the mode."""
    pauses_by_command: bool
    """DO_PAUSE_CONTINUE and DO_SET_MISSION_CURRENT are known; else the mode changes and MISSION_SET_CURRENT is sent."""

    def mode_number(self, param2: float, param3: float) -> int:
        """The custom_mode that DO_SET_MODE asks for: PX4 sends main and sub mode apart."""
        return px4_mode(int(param2), int(param3)) if self.name == "px4" else int(param2)

    def mode_of(self, custom_mode: int) -> Mode | None:
        """The mode that a custom_mode means; None for one that this project does not know."""
        for mode, number in self.mode_numbers.items():
            if number == custom_mode:
                return mode
        return self.other_numbers.get(custom_mode)


def px4_mode(main: int, sub: int = 0) -> int:
    """PX4's custom_mode."""
    return main << 16 | sub << 24


_MANUAL: Mode = "manual"

PX4 = Dialect(
    name="px4", autopilot=mav.MAV_AUTOPILOT_PX4,
    mode_numbers={"manual": px4_mode(3), "takeoff": px4_mode(4, 2), "hold": px4_mode(4, 3), "mission": px4_mode(4, 4),
                  "return": px4_mode(4, 5), "land": px4_mode(4, 6), "offboard": px4_mode(6)},
    other_numbers=dict.fromkeys(map(px4_mode, (1, 2, 5, 7, 8)), _MANUAL) | {px4_mode(4, 1): "hold"},
    item_zero_is_home=False, request_ints=True, unset=float("nan"), nan_allowed=True, bytewise_parameters=True,
    streams_unasked=True, arms_in_mission=True, starts_by_command=False, pauses_by_command=False)

ARDUPILOT = Dialect(
    name="ardupilot", autopilot=mav.MAV_AUTOPILOT_ARDUPILOTMEGA,
    mode_numbers={"manual": 0, "mission": 3, "guided": 4, "return": 6, "land": 9, "hold": 17},
    other_numbers=dict.fromkeys((1, 2, 7, 11, 13, 14, 15, 16, 18), _MANUAL) | {
        5: "hold", 20: "guided", 21: "return", 27: "return"},
    item_zero_is_home=True, request_ints=False, unset=0.0, nan_allowed=False, bytewise_parameters=False,
    streams_unasked=False, arms_in_mission=False, starts_by_command=True, pauses_by_command=True)

DIALECTS = {d.name: d for d in (PX4, ARDUPILOT)}


def dialect_of(autopilot: int) -> Dialect | None:
    """The dialect of a heartbeat's MAV_AUTOPILOT; None for one that is not spoken here."""
    return next((d for d in DIALECTS.values() if d.autopilot == autopilot), None)
