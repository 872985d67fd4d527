"""The bridge's end of the lock-step clock: admits participants, hands out ticks, leaves the dead behind."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from functools import partial

from missions import topics
from missions.bus import Bus, Delivery
from missions.clock import SECOND_NS
from missions.errors import LinkError
from missions.messages import SPEC_HASH, Join, SiteBrief, Tick, TickDone, Welcome
from missions.mission import ClockSpec

log = logging.getLogger(__name__)

PRESENCE_S = 10.0
"""Presence travels beside the Join and may come a moment after it."""


@dataclass(frozen=True)
class Round:
    """What the participants sent during the tick that just ended."""

    tick: int
    t_ns: int
    deliveries: list[Delivery]
    participants: frozenset[str]


class ClockServer:
    """Paces the mission. Subscribe the bus to the topics of the world before `admit`."""

    def __init__(self, bus: Bus, spec: ClockSpec, mission_hash: str, site: SiteBrief) -> None:
        self._bus, self._spec, self._mission_hash, self._site = bus, spec, mission_hash, site
        self._live: set[str] = set()
        self._tick, self.t_ns = 0, 0
        self._counts: dict[str, int] = {}
        self._step_ns = round(spec.tick_s * SECOND_NS)
        self._latency_ns = round(spec.link_latency_s * SECOND_NS)
        self._wall_start = 0.0
        self._interrupted = False

    def admit(self, names: set[str], timeout_s: float) -> None:
        """Wait until all these participants have joined. Raises LinkError naming those missing, or when interrupted."""
        self._bus.subscribe(topics.JOIN)
        self._bus.subscribe(topics.TICK_DONE)
        self._bus.announce_alive()
        deadline = time.monotonic() + timeout_s
        boots: dict[str, str] = {}
        while boots.keys() < names:
            for d in self._bus.poll(until=lambda: self._interrupted, timeout_s=max(0.0, deadline - time.monotonic())):
                if isinstance(d.message, Join) and self._accept(d.message, names):
                    boots[d.message.name] = d.message.boot
            if self._interrupted:
                raise LinkError("bridge: told to stop before everybody had joined.")
            if time.monotonic() > deadline:
                missing = ", ".join(sorted(names - boots.keys()))
                raise LinkError(f"bridge: did not join within {timeout_s:.0f} s: {missing}; look at their logs.")
        self._bus.wait_alive(set(boots), PRESENCE_S)
        for name, boot in sorted(boots.items()):
            self._welcome(name, boot, "")
        self._live = set(boots)
        self._wall_start = time.monotonic()

    def interrupt(self) -> None:
        """Stop waiting for participants; may be called from a signal handler."""
        self._interrupted = True
        self._bus.wake()

    @property
    def interrupted(self) -> bool:
        """Whether somebody asked to stop."""
        return self._interrupted

    def run_tick(self, stop: bool = False) -> Round:
        """Publish one tick and wait until every live participant has done its work for it."""
        self._pace()
        self._bus.t_ns = self.t_ns
        self._bus.publish(topics.TICK, Tick(tick=self._tick, t_ns=self.t_ns, counts=self._counts,
                                            participants=sorted(self._live), stop=stop))
        done = self._wait_done(stop)
        self._counts = {key: total for d in done for key, total in d.counts.items()}
        result = Round(self._tick, self.t_ns, self._bus.collect(self._counts), frozenset(self._live))
        self._tick += 1
        grid = (self.t_ns // self._step_ns + 1) * self._step_ns
        wake = min((d.wake_ns for d in done if d.name in self._live), default=grid)
        self.t_ns = min(grid, max(self.t_ns + self._latency_ns, wake))
        return result

    def include_own(self) -> None:
        """Count what the bridge itself published since the tick; call before the next `run_tick`."""
        self._counts |= self._bus.take_counts()

    def _wait_done(self, stop: bool) -> list[TickDone]:
        """Answers to this tick, by name; who has left afterwards or died is no longer live."""
        done: dict[str, TickDone] = {}
        while not (self._interrupted or self._live <= done.keys()):
            gone = {n for n in self._live - done.keys() if not self._bus.is_alive(n)}
            if gone:
                if not stop:
                    log.warning("left the clock without a word: %s", ", ".join(sorted(gone)))
                self._live -= gone
                continue
            for d in self._bus.poll(until=partial(self._call_off, self._live - done.keys()), timeout_s=None):
                if isinstance(d.message, TickDone) and d.message.tick == self._tick:
                    done[d.message.name] = d.message
                elif isinstance(d.message, Join):
                    self._welcome(d.message.name, d.message.boot, "the mission is under way; start it again.")
        self._live -= {d.name for d in done.values() if d.leaving}
        return [done[name] for name in sorted(done)]

    def _call_off(self, pending: set[str]) -> bool:
        return self._interrupted or any(not self._bus.is_alive(n) for n in pending)

    def _accept(self, join: Join, names: set[str]) -> bool:
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

    def _welcome(self, name: str, boot: str, reason: str) -> None:
        self._bus.publish(topics.WELCOME, Welcome(accepted=not reason, reason=reason, name=name, boot=boot,
                                                  site=self._site), name)

    def _pace(self) -> None:
        if self._spec.speed > 0:
            due = self._wall_start + self.t_ns / SECOND_NS / self._spec.speed
            time.sleep(max(0.0, due - time.monotonic()))
