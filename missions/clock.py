"""Simulated time in lock-step.

sim_bridge publishes a Tick; every participant handles what was sent to it before that tick, works, and answers
TickDone with the totals of what it sent and the time at which it next has something to do. When all have answered,
the bridge renders, referees and moves time on. Deliveries are sorted by key and sequence, so a mission does not
depend on how fast or loaded the machine is. A participant that dies (its liveliness token vanishes) is left out; a
process that takes its place joins under way, is announced in a Tick, and takes part from the next one on. When the
bridge dies time stands still, until another takes its place and repeats the tick that it died in.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

from missions import topics
from missions.bus import Bus, Delivery
from missions.errors import LinkError, UserError
from missions.messages import SPEC_HASH, Join, SiteBrief, Tick, TickDone, Welcome

log = logging.getLogger(__name__)

BRIDGE = "bridge"
GROUND = "ground"
SECOND_NS = 1_000_000_000
PRESENCE_S = 40.0
"""After the bridge has come back, how long those that it has heard of are waited for."""


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
    beside: tuple[Delivery, ...] = ()
    """What came outside of the lock-step since the last turn, such as an operator's commands."""
    resumed: bool = False
    """Whether this participant takes part again, after it was away."""
    disk: tuple[tuple[bool, str], ...] = ()
    """Of a turn of the past: what the disk answered then; see `missions.disk.Disk.relive`."""


class SimClock:
    """A participant's end of the clock. Subscribe to everything else before `join`."""

    def __init__(self, bus: Bus, mission_hash: str, patience_s: float = 0.0) -> None:
        """patience_s: how long a bridge that has ended may take to come back."""
        self._bus, self._mission_hash, self._patience_s = bus, mission_hash, patience_s
        self._ticks: list[Tick] = []
        self._tick = -1
        self._done: TickDone | None = None
        self._beside: list[Delivery] = []
        self._under_way = False
        self.site: SiteBrief | None = None

    def join(self, timeout_s: float = 300.0) -> SiteBrief:
        """Take part; returns what the operator knows of the site. Raises LinkError, or UserError when refused."""
        bus = self._bus
        bus.subscribe(topics.WELCOME, bus.name)
        bus.subscribe(topics.TICK)
        bus.announce_alive()
        while self.site is None:
            bus.wait_alive({BRIDGE}, timeout_s)  # one that dies now takes this with it, and its successor hears it anew
            bus.publish(topics.JOIN, Join(name=bus.name, boot=bus.boot, spec_hash=SPEC_HASH,
                                          mission_hash=self._mission_hash), bus.name)
            while self.site is None and bus.is_alive(BRIDGE):
                got = bus.poll(until=lambda: not bus.is_alive(BRIDGE), timeout_s=timeout_s)
                if not got and bus.is_alive(BRIDGE):
                    raise LinkError(f"{bus.name}: sim_bridge is silent; restart the mission.")
                self._sort(got)
        return self.site

    def next(self) -> Turn:
        """Wait for the next tick, also while there is no bridge. Raises LinkError when it is gone for good, or comes
        back without knowing what has happened."""
        while True:
            while not self._ticks:
                self._receive()
            tick = self._ticks.pop(0)
            if tick.again and tick.tick < self._tick:
                raise LinkError(f"{self._bus.name}: sim_bridge was killed while its disk did not take its journal, and "
                                f"came back without the last {self._tick - tick.tick} ticks; 'swarmscan reconstruct' "
                                "makes the model of the pictures that are in the run folder.")
            if tick.again:
                self._catch_up(tick)
            if tick.tick <= self._tick:
                continue
            try:
                deliveries = self._bus.collect(tick.counts, broken=lambda: not self._bus.is_alive(BRIDGE),
                                               again=[BRIDGE, *tick.participants] if tick.again else None)
            except LinkError as e:
                log.warning("%s", e)
                continue
            for name, boot in sorted(tick.joins.items()):  # the counts were still those of who was there before
                self._bus.renew(name, boot)
            self._tick, self._done, self._bus.t_ns = tick.tick, None, tick.t_ns
            self._bus.turn_page()
            resumed, self._under_way = self._under_way, False
            return Turn(tick.tick, tick.t_ns, deliveries, frozenset(tick.participants), tick.stop, self.take_beside(),
                        resumed)

    def take_beside(self) -> tuple[Delivery, ...]:
        """What has come outside of the lock-step, once."""
        beside, self._beside = tuple(self._beside), []
        return beside

    def hear(self, timeout_s: float) -> tuple[Delivery, ...]:
        """Before `done`: keep everybody's clock where it is, and what comes outside of it meanwhile. Raises LinkError
        when the bridge is gone for good."""
        self._sort(self._bus.poll(until=lambda: not self._bus.is_alive(BRIDGE), timeout_s=timeout_s))
        self._await_bridge()
        return self.take_beside()

    @property
    def called_off(self) -> bool:
        """Whether the bridge goes on without waiting for `done`, which it does when it is told to stop."""
        return any(tick.tick > self._tick for tick in self._ticks)

    def done(self, wake_ns: int) -> None:
        """This tick's work is finished; nothing to do before wake_ns unless a message arrives."""
        self._done = TickDone(name=self._bus.name, tick=self._tick, counts=self._bus.take_counts(), wake_ns=wake_ns)
        self._bus.publish(topics.TICK_DONE, self._done, self._bus.name)

    def leave(self) -> None:
        """Instead of `done`: this tick was the last one here. What was sent in it is still delivered; waits until the
        clock goes on without this participant, so that the moment does not depend on how fast the process ends."""
        bus = self._bus
        bus.publish(topics.TICK_DONE, TickDone(name=bus.name, tick=self._tick, counts=bus.take_counts(),
                                               wake_ns=bus.t_ns, leaving=True), bus.name)
        while got := bus.poll(until=lambda: not bus.is_alive(BRIDGE), timeout_s=None):
            if any(isinstance(d.message, Tick) and bus.name not in d.message.participants for d in got):
                return

    def _receive(self) -> None:
        got = self._bus.poll(until=lambda: not self._bus.is_alive(BRIDGE), timeout_s=None)
        self._sort(got)
        if not got:
            self._await_bridge()

    def _await_bridge(self) -> None:
        """Time stands still without a bridge."""
        if self._bus.is_alive(BRIDGE):
            return
        if self._patience_s:
            log.warning("%s: sim_bridge is gone; holds for %.0f s until it is back", self._bus.name, self._patience_s)
        try:
            self._bus.wait_alive({BRIDGE}, self._patience_s)
        except LinkError:
            raise LinkError(f"{self._bus.name}: sim_bridge is gone; restart the mission.") from None

    def _catch_up(self, tick: Tick) -> None:
        """The router has ended with what it held: send again what somebody may be missing."""
        bus = self._bus
        try:
            bus.wait_alive(set(tick.participants), PRESENCE_S)
        except LinkError as e:
            log.warning("%s", e)
        bus.publish_again()
        if tick.tick == self._tick and self._done is not None:
            bus.publish(topics.TICK_DONE, self._done, bus.name)

    def _sort(self, got: list[Delivery]) -> None:
        for delivery in got:
            message = delivery.message
            if isinstance(message, Tick):
                if self._tick >= 0 or self._bus.name in message.participants:  # before it takes part, ticks are others'
                    self._ticks.append(message)
            elif not isinstance(message, Welcome):
                self._beside.append(delivery)
            elif message.boot == self._bus.boot:
                if not message.accepted:
                    raise UserError(f"{self._bus.name}: sim_bridge refused this process: {message.reason}")
                self.site, self._under_way = message.site, message.under_way
                self._bus.skip(message.counts)
