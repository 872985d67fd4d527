"""Two vehicles with one system id: MAVLink has no word for it, and clients show one vehicle that jumps.

A vehicle gives itself away by where its frames come from, by the uid of its AUTOPILOT_VERSION and by its time since
boot. One that restarts, or changes its port, does so once; two that share an id alternate. Only that is a conflict.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

ALTERNATE_S = 5.0
"""Two that share an id both speak within this time; heartbeats come every second."""
CLEAR_S = 10.0
"""A conflict is over when nothing has spoken for it for so long."""
BACK_MS = 1000
"""Boot times may go back so far when frames overtake each other."""
WRAP_MS = 1 << 32
SOURCES = 8
"""Remembered per system; the one that was silent for longest is forgotten for a new one."""


@dataclass(frozen=True)
class Conflict:
    """Commands to this system id reach more than one vehicle: they are to be refused."""

    system: int
    since_s: float
    reason: str
    """For people."""


@dataclass
class _Source:
    heard_s: float
    uid: int = 0


@dataclass
class _System:
    sources: dict[Hashable, _Source] = field(default_factory=dict)
    last: Hashable = None
    switched_s: float = float("-inf")
    boot_ms: int | None = None
    back_s: float = float("-inf")
    uid: tuple[int, float] = (0, float("-inf"))
    evidence_s: float = float("-inf")
    conflict: Conflict | None = None


class Duplicates:
    """Watches everything that comes from vehicles. Times are monotonic seconds."""

    def __init__(self) -> None:
        self._systems: dict[int, _System] = {}

    def heard(self, system: int, source: Hashable, now_s: float, *, boot_ms: int | None = None,
              uid: int | None = None) -> None:
        """A frame of a system has come from a source (an address); boot_ms of messages that carry it, uid of
        AUTOPILOT_VERSION (0 says nothing)."""
        state = self._systems.setdefault(system, _System())
        reason = self._other_uid(state, source, uid, now_s) or self._clock_back(state, boot_ms, now_s) \
            or self._two_sources(state, source, now_s)
        if reason:
            state.evidence_s = now_s
            if self.conflict(system, now_s) is None:
                state.conflict = Conflict(system, now_s, f"system id {system}: {reason}")

    def conflict(self, system: int, now_s: float) -> Conflict | None:
        """The conflict about a system id, if there is one now."""
        state = self._systems.get(system)
        if state is None or state.conflict is None:
            return None
        if now_s - state.evidence_s > CLEAR_S:
            state.conflict = None
        return state.conflict

    def conflicts(self, now_s: float) -> list[Conflict]:
        """All of them, by system id."""
        return [c for s in sorted(self._systems) if (c := self.conflict(s, now_s)) is not None]

    def _other_uid(self, state: _System, source: Hashable, uid: int | None, now_s: float) -> str:
        if not uid:
            return ""
        (before, then_s), state.uid = state.uid, (uid, now_s)
        if source in state.sources:
            state.sources[source].uid = uid
        else:
            state.sources[source] = _Source(now_s, uid)
        if before in (0, uid) or now_s - then_s > CLEAR_S:
            return ""
        return f"two vehicles, with uid {before} and uid {uid}; give one of them another id"

    def _clock_back(self, state: _System, boot_ms: int | None, now_s: float) -> str:
        if boot_ms is None:
            return ""
        before, state.boot_ms = state.boot_ms, boot_ms
        if before is None or (boot_ms - before) % WRAP_MS < WRAP_MS // 2 or before - boot_ms <= BACK_MS:
            return ""
        then_s, state.back_s = state.back_s, now_s
        if now_s - then_s > ALTERNATE_S:
            return ""
        return "its time since boot goes back again and again: two vehicles take turns; give one of them another id"

    def _two_sources(self, state: _System, source: Hashable, now_s: float) -> str:
        known, last = state.sources.get(source), state.last
        heard_s = known.heard_s if known is not None else float("-inf")
        uid = known.uid if known is not None else 0
        state.sources[source], state.last = _Source(now_s, uid), source
        if len(state.sources) > SOURCES:
            del state.sources[min(state.sources, key=lambda s: state.sources[s].heard_s)]
        if last is None or last == source:
            return ""
        switched_s, state.switched_s = state.switched_s, now_s
        other = state.sources.get(last)
        one_vehicle = other is not None and other.uid == uid != 0
        if one_vehicle or now_s - heard_s > ALTERNATE_S or now_s - switched_s > ALTERNATE_S:
            return ""
        return f"frames come from {_name(last)} and from {_name(source)} by turns; give one of them another id"


def _name(source: Hashable) -> str:
    return ":".join(map(str, source)) if isinstance(source, tuple) else str(source)
