"""What a ground station says, and a digest of it."""

from __future__ import annotations

import hashlib

import msgspec

from missions.bus import Bus
from missions.topics import M, Topic


class Voice:
    """What a station says: to vehicles, in the lock-step, and to people. Keeps a digest of the former."""

    def __init__(self, bus: Bus | None, steers: bool = True) -> None:
        """bus: None for a station that lives through its past. steers: whether vehicles hear it."""
        self.bus, self.steers = bus, steers
        self._sha = hashlib.sha256()

    def publish(self, topic: Topic[M], message: M, who: int | str = "") -> None:
        """Say something."""
        if topic.lockstep:
            self._sha.update(f"{topic.path} {who} ".encode() + msgspec.msgpack.encode(message))
        if self.bus is not None and (self.steers or not topic.lockstep):
            self.bus.publish(topic, message, who)

    def take_digest(self) -> bytes:
        """SHA-256 (first 16 bytes) of what was said to vehicles since the last call."""
        digest, self._sha = self._sha.digest()[:16], hashlib.sha256()
        return digest
