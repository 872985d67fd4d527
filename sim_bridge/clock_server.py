"""The bridge's end of the lock-step clock: admits participants, hands out ticks, leaves the dead behind."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import msgspec

from missions import topics
from missions.bus import Bus, Delivery
from missions.clock import SECOND_NS
from missions.errors import LinkError
from missions.messages import SPEC_HASH, Join, SiteBrief, Tick, TickDone, Welcome
from missions.simulation import ClockSpec

log = logging.getLogger(__name__)

CATCH_UP_S = 1.0
"""A clock that is later than this, because somebody held it or computed for long, does not race to make up for it."""
MAKES_UP_S = 0.05
"""A clock with a speed hurries to make up for this much lateness at most."""
PRESENCE_S = 40.0
"""Presence travels beside the Join and may come a moment after it."""


@dataclass(frozen=True)
class Round:
    """What the participants sent during the tick that just ended."""

    tick: int
    t_ns: int
    deliveries: list[Delivery]
    participants: frozenset[str]


class ClockState(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The clock as a tick is sent. changed: totals by sender and key, of those that the tick tells."""

    tick: int
    t_ns: int
    changed: dict[str, dict[str, int]]
    live: list[str]
    lost: list[str]
    boots: dict[str, str]


class ClockServer:
    """Paces the mission. Subscribe the bus to the topics of the world before `admit`."""

    def __init__(self, bus: Bus, spec: ClockSpec, mission_hash: str, site: SiteBrief) -> None:
        self._bus, self._spec, self._mission_hash, self._site = bus, spec, mission_hash, site
        self._live: set[str] = set()
        self._names: frozenset[str] = frozenset()
        self._boots: dict[str, str] = {}
        self._totals: dict[str, dict[str, int]] = {}
        """Messages counted so far, by sender and key."""
        self._joins: dict[str, str] = {}
        """Who takes part again from the next tick on ..."""
        self._asked: dict[str, str] = {}
        """... and who has asked to."""
        self.lost: set[str] = set()
        """Who has left without a word."""
        self._tick, self.t_ns = 0, 0
        self._ticked_ns = 0
        self._changed: dict[str, dict[str, int]] = {}
        """Those that have changed since the last tick."""
        self._step_ns = round(spec.tick_s * SECOND_NS)
        self._latency_ns = round(spec.link_latency_s * SECOND_NS)
        self._wall_start, self._speed = 0.0, spec.speed
        self._interrupted = False
        self._again = False
        """Whether the next tick is one that an earlier bridge died in."""

    def admit(self, names: set[str], timeout_s: float) -> None:
        """Wait until all these participants have joined. Raises LinkError naming those missing, or when interrupted."""
        self._bus.subscribe(topics.JOIN)
        self._bus.subscribe(topics.TICK_DONE)
        self._bus.announce_alive()
        deadline = time.monotonic() + timeout_s
        boots: dict[str, str] = {}
        while boots.keys() < names:
            for d in self._bus.poll(until=lambda: self._interrupted, timeout_s=max(0.0, deadline - time.monotonic())):
                if isinstance(d.message, Join) and self._accept(d.message, frozenset(names)):
                    boots[d.message.name] = d.message.boot
            if self._interrupted:
                raise LinkError("bridge: told to stop before everybody had joined.")
            if time.monotonic() > deadline:
                missing = ", ".join(sorted(names - boots.keys()))
                raise LinkError(f"bridge: did not join within {timeout_s:.0f} s: {missing}; look at their logs.")
        self._bus.wait_alive(set(boots), PRESENCE_S)
        for name, boot in sorted(boots.items()):
            self._welcome(name, boot, "")
        self._live, self._names, self._boots = set(boots), frozenset(names), boots
        self._wall_start = time.monotonic()

    def readmit(self, names: set[str], past: list[ClockState], timeout_s: float) -> None:
        """Take the place of a bridge that has died, with the states of its clock so far, instead of `admit`; whoever of
        those that took part is not there within timeout_s is left behind."""
        for state in past:
            for name, counts in state.changed.items():
                self._totals.setdefault(name, {}).update(counts)
            for name in [n for n, boot in state.boots.items() if self._boots.get(n) != boot]:
                self._totals.pop(name, None)  # what has changed was said by who was there before
            self._boots = state.boots
        last, own = past[-1], self._bus.name
        self._tick, self.t_ns, self._names = last.tick, last.t_ns, frozenset(names)
        self._live, self.lost = set(last.live), set(last.lost)
        self._changed = {name: counts for name, counts in last.changed.items() if name != own}
        self._bus.published = {key: total for state in past[:-1] for key, total in state.changed.get(own, {}).items()}
        self._bus.subscribe(topics.JOIN)
        self._bus.subscribe(topics.TICK_DONE)
        self._bus.skip({key: total for name in self._live for key, total in self._totals.get(name, {}).items()})
        self._bus.announce_alive()
        with contextlib.suppress(LinkError):
            self._bus.wait_alive(self._live, timeout_s)
        self._live &= self._bus.alive()
        self.lost |= set(last.live) - self._live
        self._again = True
        self._wall_start = time.monotonic() - (self.t_ns / SECOND_NS / self._spec.speed if self._spec.speed else 0.0)

    def interrupt(self) -> None:
        """Stop waiting for participants; may be called from a signal handler."""
        self._interrupted = True
        self._bus.wake()

    @property
    def interrupted(self) -> bool:
        """Whether somebody asked to stop."""
        return self._interrupted

    def pace(self, visited: Callable[[float], bool] | None = None, unattended: bool = False) -> None:
        """Sleep until the next tick is due by `clock.speed`; time that a computation has cost stays lost, for no real
        aircraft could follow a clock that makes up for it. visited: waits so many seconds for somebody from outside the
        lock-step and says whether there was one; the tick then comes at once. unattended: nobody commands, and time
        goes no faster than real time meanwhile."""
        speed = self._spec.speed
        if unattended:
            speed = min(speed, 1.0) if speed > 0 else 1.0
        if speed <= 0:
            return
        if speed != self._speed:
            self._speed, self._wall_start = speed, time.monotonic() - self._ticked_ns / SECOND_NS / speed
        left_s = self._wall_start + self.t_ns / SECOND_NS / speed - time.monotonic()
        if left_s < -MAKES_UP_S:
            self._wall_start -= left_s
        left_s = max(0.0, left_s)
        if visited is None:
            time.sleep(left_s)
        elif visited(left_s):
            now_ns = round((time.monotonic() - self._wall_start) * speed * SECOND_NS)
            self.t_ns = min(self.t_ns, max(self._ticked_ns + self._latency_ns, now_ns))

    def run_tick(self, stop: bool = False, record: Callable[[ClockState], None] = lambda state: None) -> Round:
        """Publish one tick and wait until every live participant has done its work for it. record: keeps what is about
        to be sent."""
        self._ticked_ns = self._bus.t_ns = self.t_ns
        seated = self._seat()
        if not self._again:
            record(ClockState(self._tick, self.t_ns, self._changed, sorted(self._live), sorted(self.lost), self._boots))
        for name, counts in seated.items():
            self._welcome(name, self._boots[name], "", counts)
        self._bus.turn_page()
        self._bus.publish(topics.TICK, Tick(
            tick=self._tick, t_ns=self.t_ns, counts=_flat(self._changed), participants=sorted(self._live), stop=stop,
            joins=self._joins, again=self._again))
        self._again = False
        done = self._wait_done(stop)
        self._changed = {}
        for d in done:
            self._count(d.name, d.counts)
        result = Round(self._tick, self.t_ns, self._bus.collect(_flat(self._changed)), frozenset(self._live))
        self._tick += 1
        grid = (self.t_ns // self._step_ns + 1) * self._step_ns
        wake = min((d.wake_ns for d in done if d.name in self._live), default=grid)
        self.t_ns = min(grid, max(self.t_ns + self._latency_ns, wake))
        return result

    def include_own(self) -> None:
        """Count what the bridge itself published since the tick; call before the next `run_tick`."""
        self._count(self._bus.name, self._bus.take_counts())

    def _count(self, name: str, counts: dict[str, int]) -> None:
        for known in (self._changed, self._totals):
            known.setdefault(name, {}).update(counts)

    def _seat(self) -> dict[str, dict[str, int]]:
        """Who was announced in the last tick takes part from this one on, to be welcomed with these totals; who has
        asked since is announced in it, so that all others know of it before they hear it."""
        counts = _flat(self._totals)
        seated = dict.fromkeys(sorted(self._joins), counts)
        self._live |= seated.keys()
        self.lost -= seated.keys()
        self._joins = {name: boot for name, boot in self._asked.items() if self._bus.is_alive(name)}
        self._asked = {name: boot for name, boot in self._asked.items() if name not in self._joins}
        for name, boot in sorted(self._joins.items()):
            log.info("%s takes part again", name)
            self._boots = {**self._boots, name: boot}
            self._totals.pop(name, None)
            self._bus.renew(name, boot)
        return seated

    def _wait_done(self, stop: bool) -> list[TickDone]:
        """Answers to this tick, by name; who has left afterwards or died is no longer live."""
        done: dict[str, TickDone] = {}
        while not (self._interrupted or self._live <= done.keys()):
            gone = {n for n in self._live - done.keys() if not self._bus.is_alive(n)}
            if gone:
                if not stop:
                    log.warning("left the clock without a word: %s", ", ".join(sorted(gone)))
                self._lose(gone)
                continue
            for d in self._bus.poll(until=partial(self._call_off, self._live - done.keys()), timeout_s=None):
                if isinstance(d.message, TickDone) and d.message.tick == self._tick:
                    done[d.message.name] = d.message
                elif isinstance(d.message, Join) and self._accept(d.message, self._names):
                    self._lose({d.message.name} & self._live)
                    self._asked[d.message.name] = d.message.boot
        self._live -= {d.name for d in done.values() if d.leaving}
        return [done[name] for name in sorted(done)]

    def _lose(self, names: set[str]) -> None:
        self._live -= names
        self.lost |= names

    def _call_off(self, pending: set[str]) -> bool:
        return self._interrupted or any(not self._bus.is_alive(n) for n in pending)

    def _accept(self, join: Join, names: frozenset[str]) -> bool:
        reason = ""
        if join.name not in names:
            reason = f"the mission has no {join.name}; its participants are {', '.join(sorted(names))}."
        elif join.spec_hash != SPEC_HASH:
            reason = f"message definitions differ ({join.spec_hash} here {SPEC_HASH}); install the same version."
        elif join.mission_hash != self._mission_hash:
            reason = f"mission files differ ({join.mission_hash} here {self._mission_hash}); give all the same file."
        if reason:
            self._welcome(join.name, join.boot, reason)
        return not reason

    def _welcome(self, name: str, boot: str, reason: str, counts: dict[str, int] | None = None) -> None:
        self._bus.publish(topics.WELCOME, Welcome(accepted=not reason, reason=reason, name=name, boot=boot,
                                                  site=self._site, under_way=counts is not None,
                                                  counts=counts or {}), name)


def _flat(counts: dict[str, dict[str, int]]) -> dict[str, int]:
    """Totals of all senders by key; no two have one in common."""
    return {key: total for totals in counts.values() for key, total in totals.items()}
