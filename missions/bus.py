"""The bus: typed messages over zenoh. The only module that imports zenoh.

sim_bridge holds the router that all other processes connect to; it listens on loopback unless told otherwise, and
neither multicast nor gossip scouting is on. Lock-step topics are counted per key, so that a receiver knows when it
holds everything that was sent before a tick (see `missions.clock`).
"""

from __future__ import annotations

import json
import logging
import re
import threading
import time
import uuid
from collections import defaultdict, deque
from collections.abc import Callable, Collection
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import msgspec
import zenoh

from missions.errors import LinkError, ProtocolError
from missions.inbox import Envelope, Inbox, Sent
from missions.topics import ROOT, M, Topic

log = logging.getLogger(__name__)

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
LEASE_MS = 30_000
"""A process may compute this long without letting its link breathe; one that is killed is missed at once, since its
sockets close."""
CONNECT_MS = 120_000
"""Processes of a mission start together, and on a busy machine sim_bridge may listen a minute after the others ask."""
PATIENCE_MS = 120_000
"""How long a publisher waits for a slow receiver before zenoh gives up the link and all that is queued on it."""
MAX_MESSAGE_BYTES = 64 * 1024 * 1024
DELIVERY_TIMEOUT_S = 30.0
MALFORMED = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)
"""Everything that decoding hostile bytes can raise."""


@dataclass(frozen=True)
class Delivery:
    """A decoded message: its topic, the id in its key, who sent it, and the simulated time at which it was sent."""

    topic: Topic[Any]
    who: str
    sender: str
    t_ns: int
    message: Any


class Bus:
    """A session on the bus. Use as a context manager: a zenoh session that is not closed hangs at exit."""

    def __init__(self, name: str, fleet: str, *, connect: str = "", listen: str = "") -> None:
        """listen makes this the router (sim_bridge); connect joins one. Raises LinkError."""
        self.name, self.fleet, self.boot = name, fleet, uuid.uuid4().hex[:12]
        self.t_ns = 0
        self.rejected = 0
        self.published: dict[str, int] = {}
        self._changed: set[str] = set()
        self._recent: tuple[list[Sent], list[Sent]] = ([], [])
        """Lock-step messages of the turn before, and of this one."""
        self._patterns: list[tuple[re.Pattern[str], Topic[Any]]] = []
        self._topic_of: dict[str, tuple[Topic[Any], str] | None] = {}
        self._inboxes: dict[str, Inbox] = defaultdict(Inbox)
        self._free: deque[tuple[str, Envelope]] = deque()
        self._alive: set[str] = set()
        self._condition = threading.Condition()
        self._publishers: dict[str, Any] = {}
        self._held: list[Any] = []
        try:
            self._session = zenoh.open(_config(connect, listen))
        except zenoh.ZError as e:
            what = (f"cannot listen on {listen}; give an endpoint that is free" if listen
                    else f"no bus at {connect}; start sim_bridge there")
            raise LinkError(f"{name}: {what} ({e}).") from e
        prefix = f"{ROOT}/{fleet}/alive/"
        self._held.append(self._session.liveliness().declare_subscriber(
            prefix + "*", lambda s: self._on_alive(str(s.key_expr)[len(prefix):], s.kind), history=True))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bus."""
        if not self._session.is_closed():
            self._session.close()  # type: ignore[no-untyped-call]

    def subscribe(self, topic: Topic[M], who: int | str = "*") -> None:
        """Receive a topic, from one id or from all."""
        key = topic.key(self.fleet, who)
        pattern = re.compile("([^/]+)".join(re.escape(part) for part in key.split("*")))
        with self._condition:
            self._patterns.append((pattern, topic))
            self._topic_of.clear()
        self._held.append(self._session.declare_subscriber(key, self._on_sample))

    def announce_alive(self) -> None:
        """Show presence. Call after the last `subscribe`: who sees us alive knows that we hear it."""
        self._held.append(self._session.liveliness().declare_token(f"{ROOT}/{self.fleet}/alive/{self.name}"))

    def alive(self) -> frozenset[str]:
        """Names of the processes on the bus."""
        with self._condition:
            return frozenset(self._alive)

    def publish(self, topic: Topic[M], message: M, who: int | str = "") -> None:
        """Send a message, stamped with the bus's simulated time `t_ns`."""
        key = topic.key(self.fleet, who)
        if topic.plain_json:
            self._put(key, msgspec.json.encode(message), zenoh.CongestionControl.DROP)
            return
        body, number = msgspec.Raw(msgspec.msgpack.encode(message)), 0
        if topic.lockstep:
            number = self.published[key] = self.published.get(key, 0) + 1
            self._changed.add(key)
        payload = msgspec.msgpack.encode(Envelope(self.name, self.boot, number, self.t_ns, body))
        if topic.lockstep:
            self._recent[-1].append(Sent(key, payload))
        self._put(key, payload)

    def turn_page(self) -> None:
        """A turn begins: everybody has what was sent before the one that has just ended."""
        self._recent = (self._recent[-1], [])

    def publish_again(self) -> None:
        """Send the messages of this turn and of the one before once more, with the numbers that they had: the router
        may have ended with them. Who has them already passes them over."""
        for sent in (*self._recent[0], *self._recent[1]):
            self._put(sent.key, sent.payload)

    def _put(self, key: str, payload: bytes, control: Any = zenoh.CongestionControl.BLOCK) -> None:
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self._session.declare_publisher(
                key, congestion_control=control, express=True)
        publisher.put(payload)

    @property
    def sent(self) -> int:
        """Lock-step messages published so far."""
        return sum(self.published.values())

    def take_counts(self) -> dict[str, int]:
        """Totals of the lock-step keys that were published on since the last call."""
        changed, self._changed = self._changed, set()
        return {key: self.published[key] for key in sorted(changed)}

    def collect(self, counts: dict[str, int], broken: Callable[[], bool] = lambda: False,
                again: Collection[str] | None = None) -> list[Delivery]:
        """The lock-step messages up to these totals, in an order that depends on keys alone.

        Waits for what is still under way: what was counted has reached the router, also when its sender has died
        since. again: the router has ended with what it held, and these alone send it once more; what others have said
        and is not here is lost. Any other message that does not come, because the machine slept until the link broke,
        costs DELIVERY_TIMEOUT_S once and is then counted as lost. Raises LinkError, nothing taken, as soon as `broken`
        (called with the lock held) says that it is no use to wait.
        """
        with self._condition:
            for key, total in counts.items():
                if self._topic(key) is not None:
                    self._inboxes[key].expected = total
            due = sorted(k for k, box in self._inboxes.items() if box.expected > box.delivered)

            def lost(box: Inbox) -> bool:
                return again is not None and box.sender != "" and box.sender not in again

            def here() -> bool:
                return all(self._inboxes[k].complete or lost(self._inboxes[k]) for k in due)

            self._condition.wait_for(lambda: here() or broken(), DELIVERY_TIMEOUT_S)
            if not here() and broken():
                raise LinkError(f"{self.name}: the router went away with messages that it held.")
            missing = [k for k in due if not self._inboxes[k].complete]
            if missing:
                log.warning("%s: messages lost: %s", self.name, missing)
            raw = [(key, envelope) for key in due for envelope in self._inboxes[key].take()]
        return self._decode(raw)

    def skip(self, counts: dict[str, int]) -> None:
        """The messages up to these totals were for others: who takes part from here on does not wait for them."""
        with self._condition:
            for key in counts:
                if self._topic(key) is not None:
                    self._inboxes[key].expected = counts[key]
                    self._inboxes[key].take()

    def renew(self, name: str, boot: str) -> None:
        """This process has started anew: forget what its predecessor sent and nobody counted."""
        with self._condition:
            for box in self._inboxes.values():
                if box.sender == name and box.boot != boot:
                    box.renew(boot)

    def poll(self, until: Callable[[], bool] | None = None, timeout_s: float | None = 0.0) -> list[Delivery]:
        """Messages of topics outside the lock-step, waiting for at least one (or for `until`, which is called with
        the lock held) up to timeout_s; None waits for ever."""
        with self._condition:
            self._condition.wait_for(lambda: bool(self._free) or (until is not None and until()), timeout_s)
            raw = list(self._free)
            self._free.clear()
        return self._decode(raw)

    def wake(self) -> None:
        """Make a waiting `poll` look at its `until` again; may be called from a signal handler.

        A thread of its own gets the lock only while the poll truly waits, so that the call cannot fall into the gap
        between its look and its wait.
        """
        threading.Thread(target=self._notify, daemon=True).start()

    def _notify(self) -> None:
        with self._condition:
            self._condition.notify_all()

    def is_alive(self, name: str) -> bool:
        """Whether a process is on the bus; may be called with the lock held."""
        return name in self._alive

    def wait_alive(self, names: set[str], timeout_s: float) -> None:
        """Wait until all these processes are on the bus. Raises LinkError naming those missing."""
        deadline = time.monotonic() + timeout_s
        with self._condition:
            if not self._condition.wait_for(lambda: names <= self._alive, max(0.0, deadline - time.monotonic())):
                missing = ", ".join(sorted(names - self._alive))
                raise LinkError(f"{self.name}: not on the bus after {timeout_s:.0f} s: {missing}; start them too.")

    def _decode(self, raw: list[tuple[str, Envelope]]) -> list[Delivery]:
        out = []
        for key, envelope in raw:
            found = self._topic(key)
            if found is None:
                continue
            topic, who = found
            try:
                decode = msgspec.json.decode if topic.plain_json else msgspec.msgpack.decode
                message = decode(envelope.body, type=topic.type)
            except MALFORMED as e:
                self._reject(key, e)
                continue
            out.append(Delivery(topic, who, envelope.sender, envelope.t_ns, message))
        return out

    def _topic(self, key: str) -> tuple[Topic[Any], str] | None:
        if key not in self._topic_of:
            self._topic_of[key] = next(
                ((topic, self._who(topic, key)) for pattern, topic in self._patterns if pattern.fullmatch(key)), None)
        return self._topic_of[key]

    def _who(self, topic: Topic[Any], key: str) -> str:
        head, _, tail = topic.wildcard(self.fleet).partition("*")
        return key[len(head):len(key) - len(tail)] if "{id}" in topic.path else ""

    def _on_sample(self, sample: Any) -> None:
        key = str(sample.key_expr)
        with self._condition:
            found = self._topic(key)
        if found is None:
            return
        payload = bytes(sample.payload)
        try:
            envelope = (Envelope("", "", 0, 0, msgspec.Raw(payload)) if found[0].plain_json else
                        msgspec.msgpack.decode(payload, type=Envelope))
        except MALFORMED as e:
            self._reject(key, e)
            return
        with self._condition:
            if not found[0].lockstep:
                self._free.append((key, envelope))
            elif not self._inboxes[key].put(envelope):
                self._reject(key, ProtocolError(f"{envelope.sender} {envelope.boot} is not its sender"))
            self._condition.notify_all()

    def _on_alive(self, name: str, kind: Any) -> None:
        with self._condition:
            (self._alive.add if kind == zenoh.SampleKind.PUT else self._alive.discard)(name)
            self._condition.notify_all()

    def _reject(self, key: str, error: Exception) -> None:
        self.rejected += 1
        log.warning("%s: refused a message on %s: %s", self.name, key, error)


def _config(connect: str, listen: str) -> Any:
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": "router" if listen else "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [listen] if listen else [],
        "connect/endpoints": [connect] if connect else [],
        "connect/timeout_ms": CONNECT_MS,
        "connect/exit_on_failure": True,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": 1000 * PATIENCE_MS,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config
