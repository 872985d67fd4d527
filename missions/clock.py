"""Simulated time in lock-step.

sim_bridge publishes a Tick; every participant handles what was sent to it before that tick, works, and answers
TickDone with the totals of what it sent and the time at which it next has something to do. When all have answered,
the bridge renders, referees and moves time on. Deliveries are sorted by key and sequence, so a mission does not
depend on how fast or loaded the machine is. A participant that dies (its liveliness token vanishes) is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

from missions import topics
from missions.bus import Bus, Delivery
from missions.errors import LinkError, UserError
from missions.messages import SPEC_HASH, Join, SiteBrief, Tick, TickDone, Welcome

BRIDGE = "bridge"
GROUND = "ground"
SECOND_NS = 1_000_000_000


def vehicle_name(vehicle_id: int) -> str:
    """The name of a vehicle process on the bus and in the clock."""
    return f"uav{vehicle_id}"


@dataclass(frozen=True)
class Turn:
    """One tick as a participant sees it: the time, and everything sent to it before."""

    tick: int
    t_ns: int
    deliveries: list[Delivery]
    participants: frozenset[str]
    stop: bool


class SimClock:
    """A participant's end of the clock. Subscribe to everything else before `join`."""

    def __init__(self, bus: Bus, mission_hash: str) -> None:
        self._bus, self._mission_hash = bus, mission_hash
        self._ticks: list[Tick] = []
        self._tick = -1
        self.site: SiteBrief | None = None

    def join(self, timeout_s: float = 300.0) -> SiteBrief:
        """Take part; returns what the operator knows of the site. Raises LinkError, or UserError when refused."""
        bus = self._bus
        bus.subscribe(topics.WELCOME, bus.name)
        bus.subscribe(topics.TICK)
        bus.announce_alive()
        bus.wait_alive({BRIDGE}, timeout_s)
        bus.publish(topics.JOIN, Join(name=bus.name, boot=bus.boot, spec_hash=SPEC_HASH,
                                      mission_hash=self._mission_hash), bus.name)
        while self.site is None:
            self._receive(timeout_s)
        return self.site

    def next(self) -> Turn:
        """Wait for the next tick. Raises LinkError when the bridge is gone."""
        while not self._ticks:
            self._receive(None)
        tick = self._ticks.pop(0)
        self._tick = tick.tick
        self._bus.t_ns = tick.t_ns
        return Turn(tick.tick, tick.t_ns, self._bus.collect(tick.counts), frozenset(tick.participants), tick.stop)

    def done(self, wake_ns: int) -> None:
        """This tick's work is finished; nothing to do before wake_ns unless a message arrives."""
        self._bus.publish(topics.TICK_DONE, TickDone(
            name=self._bus.name, tick=self._tick, counts=self._bus.take_counts(), wake_ns=wake_ns), self._bus.name)

    def leave(self) -> None:
        """Instead of `done`: this tick was the last one here. What was sent in it is still delivered; waits until the
        clock goes on without this participant, so that the moment does not depend on how fast the process ends."""
        bus = self._bus
        bus.publish(topics.TICK_DONE, TickDone(name=bus.name, tick=self._tick, counts=bus.take_counts(),
                                               wake_ns=bus.t_ns, leaving=True), bus.name)
        while got := bus.poll(until=lambda: not bus.is_alive(BRIDGE), timeout_s=None):
            if any(isinstance(d.message, Tick) and bus.name not in d.message.participants for d in got):
                return

    def _receive(self, timeout_s: float | None) -> None:
        got = self._bus.poll(until=lambda: not self._bus.is_alive(BRIDGE), timeout_s=timeout_s)
        for delivery in got:
            message = delivery.message
            if isinstance(message, Tick):
                self._ticks.append(message)
            elif isinstance(message, Welcome) and message.boot == self._bus.boot:
                if not message.accepted:
                    raise UserError(f"{self._bus.name}: sim_bridge refused this process: {message.reason}")
                self.site = message.site
        if not got:
            raise LinkError(f"{self._bus.name}: sim_bridge is gone or silent; restart the mission.")
