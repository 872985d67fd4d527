"""A bad link on purpose: a UDP proxy on loopback that loses, repeats, delays and reorders datagrams.

`python -m sim_bridge.faults --listen 127.0.0.1:14551 --to 127.0.0.1:14550 --loss 0.2`. What happens to the n-th
datagram of a direction depends on the seed and n alone; when it happens is wall time, for that is what clients live in.
"""

from __future__ import annotations

import argparse
import heapq
import random
import selectors
import socket
import sys
import threading
import time
from dataclasses import dataclass, field
from types import TracebackType

from missions.errors import UserError
from missions.process import run_process

MAX_DATAGRAM_BYTES = 65535
IDLE_S = 0.1
Address = tuple[str, int]


@dataclass(frozen=True)
class Faults:
    """Shares 0-1 of datagrams; loss 1.0 is a cut link. latency_s: one way. A reordered datagram is late by reorder_s
    more, so that those behind it overtake."""

    loss: float = 0.0
    duplicates: float = 0.0
    reordered: float = 0.0
    latency_s: float = 0.0
    reorder_s: float = 0.03

    def delays_s(self, rng: random.Random) -> list[float]:
        """How late each copy of one datagram arrives; empty when it is lost. Draws four numbers, whatever happens."""
        lost, twice, late, late_copy = (rng.random() < share for share in (
            self.loss, self.duplicates, self.reordered, self.reordered))
        if lost:
            return []
        return [self.latency_s + self.reorder_s * late, self.latency_s + self.reorder_s * late_copy][:1 + twice]


@dataclass
class Count:
    """Datagrams of one direction."""

    received: int = 0
    sent: int = 0


@dataclass(order=True)
class _Due:
    t_s: float
    number: int
    sender: socket.socket = field(compare=False)
    to: Address = field(compare=False)
    datagram: bytes = field(compare=False)


class LossyProxy:
    """Stands between clients and one server, in a thread of its own. Use as a context manager.

    Every client has its own socket towards the server, so that the server can tell them apart. `faults` may be replaced
    at any time, for a link that breaks and comes back.
    """

    def __init__(self, server: Address, faults: Faults, seed: int = 0, listen: Address = ("127.0.0.1", 0)) -> None:
        """Raises OSError when `listen` is taken."""
        self.faults = faults
        self.up, self.down = Count(), Count()
        self._server = server
        self._rng = {"up": random.Random(f"{seed} up"), "down": random.Random(f"{seed} down")}
        self._front = _bound(listen)
        self._client_of: dict[socket.socket, Address] = {}
        self._back_of: dict[Address, socket.socket] = {}
        self._due: list[_Due] = []
        self._number = 0
        self._closing = threading.Event()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._front, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self.serve, name="lossy-proxy", daemon=True)

    @property
    def address(self) -> Address:
        """Where clients send to."""
        host, port = self._front.getsockname()
        return host, port

    def __enter__(self) -> LossyProxy:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._closing.set()
        self._thread.join()
        self._selector.close()
        for sock in (self._front, *self._client_of):
            sock.close()

    def serve(self) -> None:
        """Forward until closed."""
        while not self._closing.is_set():
            now_s = time.monotonic()
            while self._due and self._due[0].t_s <= now_s:
                self._deliver(heapq.heappop(self._due))
            wait_s = min(IDLE_S, self._due[0].t_s - now_s) if self._due else IDLE_S
            for key, _ in self._selector.select(wait_s):
                assert isinstance(key.fileobj, socket.socket), "only sockets are registered"
                self._drain(key.fileobj)

    def _drain(self, sock: socket.socket) -> None:
        while True:
            try:
                datagram, sender = sock.recvfrom(MAX_DATAGRAM_BYTES)
            except BlockingIOError:
                return
            except ConnectionRefusedError:
                continue  # nobody listened at the other end; what was sent there is lost, as on any link
            if sock is self._front:
                self._forward("up", self.up, self._back(sender), self._server, datagram)
            else:
                self._forward("down", self.down, self._front, self._client_of[sock], datagram)

    def _forward(self, way: str, count: Count, sender: socket.socket, to: Address, datagram: bytes) -> None:
        count.received += 1
        now_s = time.monotonic()
        for delay_s in self.faults.delays_s(self._rng[way]):
            count.sent += 1
            self._number += 1
            heapq.heappush(self._due, _Due(now_s + delay_s, self._number, sender, to, datagram))

    def _deliver(self, due: _Due) -> None:
        try:
            due.sender.sendto(due.datagram, due.to)
        except (BlockingIOError, ConnectionRefusedError):
            return  # a full buffer or nobody there: lost, as on any link

    def _back(self, client: Address) -> socket.socket:
        if client not in self._back_of:
            sock = _bound(("127.0.0.1", 0))
            self._selector.register(sock, selectors.EVENT_READ)
            self._back_of[client], self._client_of[sock] = sock, client
        return self._back_of[client]


def _bound(address: Address) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    try:
        sock.bind(address)
    except OSError:
        sock.close()
        raise
    return sock


def main(argv: list[str] | None = None) -> int:
    """Serve until interrupted."""
    options = _parser().parse_args(argv)
    return run_process(lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    faults = Faults(_share("--loss", options.loss), _share("--duplicates", options.duplicates),
                    _share("--reordered", options.reordered), options.latency_ms / 1000.0)
    try:
        proxy = LossyProxy(_address("--to", options.to), faults, options.seed, _address("--listen", options.listen))
    except OSError as e:
        raise UserError(f"--listen {options.listen}: {e.strerror}; give another address.") from e
    sys.stderr.write(f"lossy link from {proxy.address[0]}:{proxy.address[1]} to {options.to}: {faults}\n")
    proxy.serve()


def _address(option: str, text: str) -> Address:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not int(port) < 2**16:
        raise UserError(f"{option} {text}: is no address; give HOST:PORT, such as 127.0.0.1:14550.")
    return host, int(port)


def _share(option: str, value: float) -> float:
    if not 0.0 <= value <= 1.0:
        raise UserError(f"{option} {value}: is no share; give a number from 0 to 1.")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m sim_bridge.faults", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--listen", default="127.0.0.1:14551", help="where clients send to (default %(default)s)")
    parser.add_argument("--to", default="127.0.0.1:14550", help="the server behind it (default %(default)s)")
    parser.add_argument("--loss", type=float, default=0.0, help="share of datagrams lost, each way")
    parser.add_argument("--duplicates", type=float, default=0.0, help="share delivered twice")
    parser.add_argument("--reordered", type=float, default=0.0, help="share that others overtake")
    parser.add_argument("--latency-ms", type=float, default=0.0, help="delay, each way")
    parser.add_argument("--seed", type=int, default=0)
    return parser


if __name__ == "__main__":
    sys.exit(main())
