"""What a MAVLink router reads of a frame: who sent it and whom it is for. CRCs are the receivers' business."""

from __future__ import annotations

import itertools
import struct
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mav

V1, V2 = 0xFE, 0xFD
SIGNED = 0x01
_V1_EXTRA, _V2_EXTRA, _SIGNATURE = 8, 12, 13
"""Bytes of a frame beside its payload."""


@dataclass(frozen=True)
class Header:
    """Source and target; a target of 0 is everybody."""

    system: int
    component: int
    target_system: int = 0
    target_component: int = 0

    @classmethod
    def of(cls, frame: bytes) -> Header:
        """Read it from a whole frame."""
        system, component, number, payload = _parts(frame)
        places = _TARGETS.get(number)
        if places is None:
            return cls(system, component)
        return cls(system, component, *(payload[n] if n is not None and n < len(payload) else 0 for n in places))

    @property
    def for_all(self) -> bool:
        """Whether everybody is to get it."""
        return self.target_system == 0

    def reaches(self, system: int, component: int) -> bool:
        """Whether it is for whoever has shown this id."""
        return self.target_system in (0, system) and self.target_component in (0, component)


def boot_ms_of(frame: bytes) -> int | None:
    """Milliseconds since the sender's boot, in frames that tell where and how it is now."""
    return _number(frame, _BOOT)


def uid_of(frame: bytes) -> int | None:
    """The hardware's number in AUTOPILOT_VERSION; 0 says nothing."""
    return _number(frame, _UID)


def split(datagram: bytes) -> list[bytes]:
    """The frames in a datagram; what is not a frame is left out."""
    frames, at = [], 0
    while at + _V1_EXTRA <= len(datagram):
        if datagram[at] == V1:
            size = datagram[at + 1] + _V1_EXTRA
        elif datagram[at] == V2:
            size = datagram[at + 1] + _V2_EXTRA + (_SIGNATURE if datagram[at + 2] & SIGNED else 0)
        else:
            at += 1
            continue
        if at + size <= len(datagram):
            frames.append(datagram[at:at + size])
        at += size
    return frames


def _parts(frame: bytes) -> tuple[int, int, int, bytes]:
    """System, component, number of the message, payload."""
    if frame[0] == V1:
        return frame[3], frame[4], frame[5], frame[6:-2]
    return frame[5], frame[6], int.from_bytes(frame[7:10], "little"), frame[10:10 + frame[1]]


def _number(frame: bytes, fields: dict[int, tuple[int, int]]) -> int | None:
    """A whole number of the payload, whose trailing zeros are not sent; fields: by message, where it lies."""
    *_, number, payload = _parts(frame)
    place = fields.get(number)
    return None if place is None else int.from_bytes(payload[place[0]:place[1]], "little")


def _starts(message: Any) -> dict[str, tuple[int, int]]:
    """By field, where it begins and ends in the payload."""
    sizes = [struct.calcsize("<" + code) * max(1, length)
             for code, length in zip(message.native_format.decode().lstrip("<"), message.array_lengths, strict=True)]
    ends = list(itertools.accumulate(sizes))
    return dict(zip(message.ordered_fieldnames, zip([0, *ends[:-1]], ends, strict=True), strict=True))


def _places(message: Any) -> tuple[int | None, int | None]:
    """Where in the payload target_system and target_component stand."""
    starts = _starts(message)
    system, component = (starts[n][0] if n in starts else None for n in ("target_system", "target_component"))
    return system, component


_TARGETS: dict[int, tuple[int | None, int | None]] = {
    number: _places(message) for number, message in mav.mavlink_map.items()
    if "target_system" in message.ordered_fieldnames}
_BOOT = {number: _starts(mav.mavlink_map[number])["time_boot_ms"] for number in (
    mav.MAVLINK_MSG_ID_SYSTEM_TIME, mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)}
_UID = {mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _starts(mav.mavlink_map[mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION])["uid"]}
