"""What travels on the bus, and where it waits for its receiver: envelopes, numbered per key."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec


class Envelope(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A message as it travels; boot tells one start of its sender from the next."""

    sender: str
    boot: str
    number: int
    """Which message of the lock-step on its key this is, from 1 on; 0 outside of the lock-step."""
    t_ns: int
    body: msgspec.Raw


@dataclass(frozen=True)
class Sent:
    """A message of the lock-step as it went out."""

    key: str
    payload: bytes


class Inbox:
    """Raw messages of one concrete key, of the one sender that the key belongs to."""

    def __init__(self) -> None:
        self.sender = self.boot = ""
        self.delivered = 0
        self.expected = 0
        self._waiting: dict[int, Envelope] = {}

    def put(self, envelope: Envelope) -> bool:
        """False for a message that comes from somebody else than the first sender on this key. One that is here already
        is passed over: whoever finds the router gone sends again what may have been lost with it."""
        if not self.boot:
            self.sender, self.boot = envelope.sender, envelope.boot
        if envelope.boot != self.boot:
            return False
        if envelope.number > self.delivered:
            self._waiting.setdefault(envelope.number, envelope)
        return True

    @property
    def complete(self) -> bool:
        """Whether all is here that is expected."""
        return all(n in self._waiting for n in self._due)

    def take(self) -> list[Envelope]:
        """What was expected and has come, in order; what is not here by now is lost."""
        taken = [self._waiting.pop(n) for n in self._due if n in self._waiting]
        self.delivered = self.expected
        return taken

    def renew(self, boot: str) -> None:
        """Its sender has started anew, and counts from 1."""
        self.boot = boot
        self.delivered = self.expected = 0
        self._waiting.clear()

    @property
    def _due(self) -> range:
        return range(self.delivered + 1, self.expected + 1)
