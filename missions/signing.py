"""MAVLink 2 signing: who holds the key may speak, and nothing said before counts again.

A frame carries 13 bytes more: link id, 48 bits of time in 10 µs since 2015, and the first 48 bits of SHA-256 over key
and all that precedes (mavlink.io, "Message Signing"). Of the standard's rules for time this is the strict half: a
timestamp more than WINDOW_S off this clock is refused and changes nothing, so that one frame from the far future, which
the standard would have everyone adopt, locks nobody out. What was stamped before this end started is refused as well,
so nothing need be stored over a restart to keep recordings out. Both ends need clocks that agree to WINDOW_S.
"""

from __future__ import annotations

import hashlib
import hmac
import struct
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from pymavlink.dialects.v20 import common as mav

from missions.errors import UserError

KEY_BYTES = 32
WINDOW_S = 60.0
PER_SECOND = 100_000
EPOCH_UNIX_S = 1_420_070_400
"""2015-01-01 00:00 UTC."""
MARKER, SIGNED, SIGNATURE_BYTES = 0xFD, 0x01, 13

Refusal = Literal["unsigned", "wrong signature", "replayed", "out of time"]


def wall_clock() -> int:
    """Now, in units of 10 µs since 2015. The real link's time: simulated time may run faster and repeat itself."""
    return int((time.time() - EPOCH_UNIX_S) * PER_SECOND)


class Signing:
    """Signs the frames of one end and judges those of the others. `refused` counts per reason."""

    def __init__(self, key: bytes, link_id: int = 0, clock: Callable[[], int] = wall_clock) -> None:
        """clock: now, in units of 10 µs since 2015."""
        if len(key) != KEY_BYTES:
            raise ValueError(f"a signing key has {KEY_BYTES} bytes")
        self.refused: Counter[Refusal] = Counter()
        self._key, self._link_id, self._clock = key, link_id, clock
        self._started = clock()
        self._sent = 0
        self._newest: dict[bytes, int] = {}

    def signed(self, frame: bytes, crc_extra: int) -> bytes:
        """The unsigned MAVLink 2 frame with its signature; crc_extra is its message's."""
        body = bytearray(frame[:-2])
        body[2] |= SIGNED
        crc = mav.x25crc(body[1:])
        crc.accumulate(bytes([crc_extra]))
        self._sent = max(self._sent + 1, self._clock())
        stamped = bytes(body) + struct.pack("<HB", crc.crc, self._link_id) + self._sent.to_bytes(6, "little")
        return stamped + self._signature(stamped)

    def accepts(self, frame: bytes) -> bool:
        """Whether this whole frame was signed with the key, now, and never accepted before; else it is counted."""
        reason = self._refusal(frame)
        if reason is not None:
            self.refused[reason] += 1
        return reason is None

    def _refusal(self, frame: bytes) -> Refusal | None:
        if len(frame) < 12 + SIGNATURE_BYTES or frame[0] != MARKER or not frame[2] & SIGNED:
            return "unsigned"
        if not hmac.compare_digest(frame[-6:], self._signature(frame[:-6])):
            return "wrong signature"
        stream = frame[-SIGNATURE_BYTES:-SIGNATURE_BYTES + 1] + frame[5:7]  # link, system, component
        stamp, now = int.from_bytes(frame[-12:-6], "little"), self._clock()
        if abs(stamp - now) > WINDOW_S * PER_SECOND:
            return "out of time"
        if stamp <= self._newest.get(stream, self._started - 1):
            return "replayed"
        self._newest[stream] = stamp
        return None

    def _signature(self, stamped: bytes) -> bytes:
        return hashlib.sha256(self._key + stamped).digest()[:6]


def read_key(path: Path) -> bytes:
    """The key of a file: 64 hexadecimal digits, readable by its owner alone. Raises UserError, never naming the key."""
    try:
        mode, text = path.stat().st_mode, path.read_bytes()
    except OSError as e:
        raise UserError(f"{path}: the signing key cannot be read ({e.strerror}); make one with "
                        f"'(umask 077; openssl rand -hex {KEY_BYTES} > {path})'.") from e
    if mode & 0o077:
        raise UserError(f"{path}: others than its owner may use the signing key; run 'chmod 600 {path}'.")
    try:
        key = bytes.fromhex(text.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise UserError(f"{path}: is no signing key; it must hold {2 * KEY_BYTES} hexadecimal digits and nothing else.")
    return key
