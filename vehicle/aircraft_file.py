"""What outlives a vehicle's process: the aircraft, which its autopilot holds in the air where its computer left it.

The simulated aircraft is flown inside the vehicle's process, so this file stands for it while there is none. It has
what an autopilot knows without its companion computer: where it hovers, with which battery, armed, and what it was
about. The aircraft is taken to rest where it told last that it was, without a way to brake; its battery goes on
spending. Plan and map are not in it: an interrupted plan is not flown on, the ground station sends a new one.
"""

from __future__ import annotations

import logging
import os
import zlib
from pathlib import Path

import msgspec

from missions.messages import Vector
from vehicle.lease import Sender

log = logging.getLogger(__name__)


class AircraftState(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The aircraft at a time."""

    t_ns: int
    position_enu_m: Vector
    yaw_enu_rad: float
    gimbal_elevation_rad: float
    battery_percent: float
    swapped_ns: int | None
    """When the battery that is being put in is there."""
    mode: str
    paused_by: Sender | None
    """Who has told it to hold."""
    below_hover: bool
    trail_enu_m: list[Vector]
    """Where it rested and turned since take-off: its way back."""


class AircraftFile:
    """Holds the newest state, in one write, so that a process that is killed leaves a whole one."""

    def __init__(self, path: Path, mission_hash: str) -> None:
        """Raises OSError."""
        self._mark = mission_hash.encode()
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        self._troubled = False
        self.found = self._read()
        """The state that an earlier process of this mission left."""

    def write(self, state: AircraftState) -> None:
        """Keep this one; a disk that does not take it keeps the last one that it took, or none."""
        body = self._mark + msgspec.msgpack.encode(state)
        data = zlib.crc32(body).to_bytes(4, "little") + len(body).to_bytes(4, "little") + body
        try:
            os.pwrite(self._fd, data, 0)
        except OSError as e:
            if not self._troubled:
                log.error("not kept where the aircraft is, so that nobody can take this process's place: %s", e)
            self._troubled = True
        else:
            self._troubled = False

    def close(self) -> None:
        """No more is written."""
        os.close(self._fd)

    def _read(self) -> AircraftState | None:
        data = os.pread(self._fd, os.fstat(self._fd).st_size, 0)
        body = data[8:8 + int.from_bytes(data[4:8], "little")]
        if zlib.crc32(body) != int.from_bytes(data[:4], "little") or not body.startswith(self._mark):
            return None
        return msgspec.msgpack.decode(body[len(self._mark):], type=AircraftState)
