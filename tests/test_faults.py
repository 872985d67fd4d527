"""The lossy proxy: what it does to datagrams, and that it does the same again for the same seed."""

from __future__ import annotations

import random
import socket
from collections import Counter
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from missions.errors import UserError
from sim_bridge import faults
from sim_bridge.faults import Faults, LossyProxy

shares = st.floats(0.0, 1.0)
PATIENCE_S = 60.0


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(0.3)
        yield sock


def received(sock: socket.socket, proxy: LossyProxy, sent: int) -> list[bytes]:
    """Everything that arrives until it is quiet, and the proxy has passed on what it made of all that was sent."""
    out = []
    while True:
        try:
            out.append(sock.recv(100))
        except TimeoutError:
            if proxy.up.received == sent and proxy.up.sent == len(out):
                return out


def through(server: socket.socket, faults: Faults, seed: int, n: int = 200) -> list[int]:
    """Numbers of the datagrams that arrive, in order of arrival."""
    with (LossyProxy(server.getsockname(), faults, seed) as proxy,
          socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client):
        for k in range(n):
            client.sendto(str(k).encode(), proxy.address)
        return [int(d) for d in received(server, proxy, n)]


@given(loss=shares, duplicates=shares, reordered=shares, seed=st.integers(0, 1000))
def test_every_datagram_comes_not_at_all_once_or_twice(loss: float, duplicates: float, reordered: float,
                                                        seed: int) -> None:
    link = Faults(loss, duplicates, reordered, latency_s=0.01)
    rng = random.Random(seed)
    for _ in range(50):
        delays = link.delays_s(rng)
        assert len(delays) in (0, 1, 2)
        assert all(d in (0.01, 0.01 + link.reorder_s) for d in delays)


@pytest.mark.parametrize(("link", "share_lost", "share_twice"), [
    (Faults(), 0.0, 0.0), (Faults(loss=0.2), 0.2, 0.0), (Faults(loss=0.2, duplicates=0.5), 0.2, 0.4)])
def test_shares_are_what_was_asked_for(link: Faults, share_lost: float, share_twice: float) -> None:
    rng, n = random.Random(1), 20_000
    copies = Counter(len(link.delays_s(rng)) for _ in range(n))
    assert copies[0] / n == pytest.approx(share_lost, abs=0.01)
    assert copies[2] / n == pytest.approx(share_twice, abs=0.01)


def test_a_good_link_changes_nothing(server: socket.socket) -> None:
    assert through(server, Faults(), 0) == list(range(200))


def test_the_same_seed_loses_and_repeats_the_same(server: socket.socket) -> None:
    link = Faults(loss=0.3, duplicates=0.2, reordered=0.3)
    first, again, other = (through(server, link, seed) for seed in (7, 7, 8))
    assert sorted(first) == sorted(again)
    assert sorted(first) != sorted(other)
    assert first != sorted(first)


def test_answers_go_to_the_client_that_asked(server: socket.socket) -> None:
    server.settimeout(PATIENCE_S)
    with LossyProxy(server.getsockname(), Faults()) as proxy:
        clients = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
        for k, client in enumerate(clients):
            client.settimeout(PATIENCE_S)
            client.sendto(str(k).encode(), proxy.address)
            data, sender = server.recvfrom(100)
            server.sendto(b"answer to " + data, sender)
        for k, client in enumerate(clients):
            assert client.recv(100) == f"answer to {k}".encode()
            client.close()
        assert (proxy.up.received, proxy.down.sent) == (3, 3)


def test_a_link_breaks_and_comes_back(server: socket.socket) -> None:
    with (LossyProxy(server.getsockname(), Faults(loss=1.0)) as proxy,
          socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client):
        client.sendto(b"lost", proxy.address)
        assert received(server, proxy, 1) == []
        proxy.faults = Faults()
        client.sendto(b"back", proxy.address)
        assert received(server, proxy, 2) == [b"back"]


def test_nobody_behind_it_is_no_error() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gone:
        gone.bind(("127.0.0.1", 0))
        address = gone.getsockname()
    with (LossyProxy(address, Faults()) as proxy, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client):
        for _ in range(5):
            client.sendto(b"hello", proxy.address)
        client.settimeout(0.2)
        with pytest.raises(TimeoutError):
            client.recv(100)


@pytest.mark.parametrize(("arguments", "told"), [
    (["--to", "nowhere"], "--to nowhere: is no address; give HOST:PORT, such as 127.0.0.1:14550."),
    (["--loss", "20"], "--loss 20.0: is no share; give a number from 0 to 1.")])
def test_bad_options_are_refused(arguments: list[str], told: str) -> None:
    with pytest.raises(UserError, match=told):
        faults._run(faults._parser().parse_args(arguments))
