"""The bus delivers everything once, in order; refuses what it cannot decode; listens on loopback alone."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator

import msgspec
import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missions import topics
from missions.bus import DELIVERY_TIMEOUT_S, MALFORMED, Bus
from missions.errors import LinkError
from missions.inbox import Envelope
from missions.messages import MavlinkFrames, PlanHash, PlanVerdict, Status
from tests.loopback import free_endpoint

WAIT_S = 60.0


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def buses(endpoint: str) -> Iterator[tuple[Bus, Bus, Bus]]:
    """A router and two clients."""
    with (Bus("bridge", "test", listen=endpoint) as router, Bus("a", "test", connect=endpoint) as a,
          Bus("b", "test", connect=endpoint) as b):
        yield router, a, b


def plan(number: int) -> PlanHash:
    return PlanHash(plan_id=number, count=0, sha256="")


def hear(listener: Bus, speaker: Bus) -> None:
    listener.announce_alive()
    speaker.wait_alive({listener.name}, WAIT_S)


def test_every_message_is_delivered_once_in_order(buses: tuple[Bus, Bus, Bus]) -> None:
    _, a, b = buses
    b.subscribe(topics.PLAN_HASH)
    b.subscribe(topics.PLAN_VERDICT, 7)
    hear(b, a)
    for number in range(200):
        a.t_ns = number
        a.publish(topics.PLAN_HASH, plan(number), number % 3)
        a.publish(topics.PLAN_VERDICT, PlanVerdict(plan_id=number, sha256="", accepted=True), 7)
        a.publish(topics.PLAN_VERDICT, PlanVerdict(plan_id=number, sha256="", accepted=True), 8)
    got = b.collect(a.take_counts())
    for who in ("0", "1", "2"):
        hashes = [d for d in got if d.topic is topics.PLAN_HASH and d.who == who]
        assert [d.message.plan_id for d in hashes] == list(range(int(who), 200, 3))
        assert [d.t_ns for d in hashes] == list(range(int(who), 200, 3))
    assert [d.message.plan_id for d in got if d.topic is topics.PLAN_VERDICT] == list(range(200))
    assert {d.sender for d in got} == {"a"}
    assert b.collect({}) == []


def test_what_went_down_with_the_router_is_waited_for_only_from_who_sends_it_again(
        buses: tuple[Bus, Bus, Bus], caplog: pytest.LogCaptureFixture) -> None:
    router, a, b = buses
    b.subscribe(topics.PLAN_HASH)
    hear(b, a)
    hear(b, router)
    dead, living = (topics.PLAN_HASH.key("test", who) for who in (1, 2))
    a.publish(topics.PLAN_HASH, plan(1), 1)
    router.publish(topics.PLAN_HASH, plan(2), 2)
    b.collect({dead: 1, living: 1})
    router.publish(topics.PLAN_HASH, plan(3), 2)
    begin = time.monotonic()
    assert [d.message.plan_id for d in b.collect({dead: 2, living: 2}, again=["bridge"])] == [3]
    assert time.monotonic() - begin < DELIVERY_TIMEOUT_S
    assert "messages lost: ['swarmscan/test/g/1/plan/hash']" in caplog.text


def test_the_first_message_on_a_fresh_key_is_not_lost(buses: tuple[Bus, Bus, Bus]) -> None:
    _, a, b = buses
    b.subscribe(topics.PLAN_HASH)
    hear(b, a)
    for number in range(50):
        a.publish(topics.PLAN_HASH, plan(number), number)
        assert [d.message.plan_id for d in b.collect(a.take_counts())] == [number]


def test_a_message_that_never_comes_is_waited_for_once(buses: tuple[Bus, Bus, Bus], monkeypatch: pytest.MonkeyPatch,
                                                       caplog: pytest.LogCaptureFixture) -> None:
    _, a, b = buses
    b.subscribe(topics.PLAN_HASH)
    hear(b, a)
    key = topics.PLAN_HASH.key("test", 1)
    a.publish(topics.PLAN_HASH, plan(1), 1)
    assert [d.message.plan_id for d in b.collect({key: 1})] == [1]
    monkeypatch.setattr("missions.bus.DELIVERY_TIMEOUT_S", 0.2)
    assert b.collect({key: 2}) == []
    a.published[key] = 2
    monkeypatch.setattr("missions.bus.DELIVERY_TIMEOUT_S", WAIT_S)
    for number in (3, 4):
        a.publish(topics.PLAN_HASH, plan(number), 1)
        assert [d.message.plan_id for d in b.collect({key: number})] == [number]
    assert caplog.text.count("messages lost") == 1


def test_messages_beyond_the_counted_total_wait(buses: tuple[Bus, Bus, Bus]) -> None:
    _, a, b = buses
    b.subscribe(topics.PLAN_HASH)
    hear(b, a)
    key = topics.PLAN_HASH.key("test", 1)
    for number in range(5):
        a.publish(topics.PLAN_HASH, plan(number), 1)
    assert [d.message.plan_id for d in b.collect({key: 2})] == [0, 1]
    assert b.collect({key: 2}) == []
    assert [d.message.plan_id for d in b.collect({key: 5})] == [2, 3, 4]


def test_what_is_sent_again_is_delivered_once_and_in_order_even_after_what_came_later(
        buses: tuple[Bus, Bus, Bus]) -> None:
    _, a, b = buses
    a.publish(topics.PLAN_HASH, plan(1), 1)
    a.turn_page()
    a.publish(topics.PLAN_HASH, plan(2), 1)
    b.subscribe(topics.PLAN_HASH)  # what came before is lost, as with a router that has ended
    hear(b, a)
    a.publish(topics.PLAN_HASH, plan(3), 1)
    with pytest.raises(LinkError, match="went away"):
        b.collect(a.take_counts(), broken=lambda: True)
    a.publish_again()
    assert [d.message.plan_id for d in b.collect({})] == [1, 2, 3]
    a.turn_page()
    a.turn_page()
    a.publish_again()
    assert b.collect({}) == []


def test_malformed_payloads_are_refused_and_the_rest_arrives(buses: tuple[Bus, Bus, Bus]) -> None:
    _, a, b = buses
    b.subscribe(topics.PLAN_HASH)
    hear(b, a)
    key = topics.PLAN_HASH.key("test", 1)
    a.publish(topics.PLAN_HASH, plan(1), 1)
    a._publishers[key].put(b"\x94\xa1\xff")
    a._publishers[key].put(b"\x91" * 5000)
    stranger = Envelope("a", "another boot", 2, 0, msgspec.Raw(msgspec.msgpack.encode(plan(666))))
    a._publishers[key].put(msgspec.msgpack.encode(stranger))
    wrong_body = Envelope("a", a.boot, 2, 0, msgspec.Raw(msgspec.msgpack.encode({"plan_id": "x"})))
    a._publishers[key].put(msgspec.msgpack.encode(wrong_body))
    a.published[key] = 2
    a.publish(topics.PLAN_HASH, plan(2), 1)
    assert [d.message.plan_id for d in b.collect({key: 3})] == [1, 2]
    assert b.rejected == 4


@given(st.binary(max_size=80), st.integers(0, 70), st.integers(0, 255))
def test_hostile_bytes_raise_nothing_that_the_bus_does_not_catch(junk: bytes, at: int, value: int) -> None:
    valid = bytearray(msgspec.msgpack.encode(Envelope("a", "b", 1, 1, msgspec.Raw(msgspec.msgpack.encode(plan(1))))))
    valid[at % len(valid)] = value
    for payload in (junk, bytes(valid), bytes(valid) + junk):
        for kind in (Envelope, PlanHash, MavlinkFrames):
            try:
                msgspec.msgpack.decode(payload, type=kind)
            except MALFORMED:
                continue


def test_free_topics_need_no_counts(buses: tuple[Bus, Bus, Bus]) -> None:
    _, a, b = buses
    b.subscribe(topics.STATUS)
    hear(b, a)
    a.publish(topics.STATUS, Status(phase="explore", t_ns=5, coverage=0.5, pictures=3, seconds_left=1.0, vehicles=[]))
    got = b.poll(timeout_s=WAIT_S)
    assert [d.message.pictures for d in got] == [3]
    assert a.take_counts() == {}


def test_presence_ends_with_the_session(buses: tuple[Bus, Bus, Bus]) -> None:
    _, a, b = buses
    hear(b, a)
    b.close()
    assert a.poll(until=lambda: not a.is_alive("b"), timeout_s=WAIT_S) == []
    assert "b" not in a.alive()


def test_who_is_missing_is_named(buses: tuple[Bus, Bus, Bus]) -> None:
    with pytest.raises(LinkError, match="uav9"):
        buses[1].wait_alive({"uav9"}, 0.05)


def test_a_poll_can_be_woken(buses: tuple[Bus, Bus, Bus]) -> None:
    _, a, _ = buses
    begin = time.monotonic()
    asked: list[float] = []

    def asked_twice() -> bool:
        asked.append(time.monotonic())
        if len(asked) == 1:
            a.wake()
        return len(asked) > 1

    a.poll(until=asked_twice, timeout_s=WAIT_S)
    assert time.monotonic() - begin < WAIT_S


def test_a_taken_endpoint_is_named(buses: tuple[Bus, Bus, Bus], endpoint: str) -> None:
    with pytest.raises(LinkError, match=f"cannot listen on {endpoint}"):
        Bus("bridge", "test", listen=endpoint)


BUSY = """
import ctypes, sys
from missions.bus import Bus
from missions.topics import MAVLINK_DOWN
with Bus("busy", "test", connect=sys.argv[1]) as bus:
    bus.subscribe(MAVLINK_DOWN)
    bus.announce_alive()
    ctypes.PyDLL(None).usleep(6_000_000)  # keeps the interpreter's lock
    got = bus.collect({MAVLINK_DOWN.key("test", 1): 300})
    print(len(got), flush=True)
"""


@pytest.mark.loopback
def test_a_process_that_computes_for_seconds_loses_nothing(buses: tuple[Bus, Bus, Bus], endpoint: str) -> None:
    _, a, _ = buses
    process = subprocess.Popen([sys.executable, "-c", BUSY, endpoint], stdout=subprocess.PIPE)
    a.wait_alive({"busy"}, 20.0)
    for _ in range(300):
        a.publish(topics.MAVLINK_DOWN, MavlinkFrames(frames=[b"x" * 400_000]), 1)
    assert "busy" in a.alive()
    assert process.communicate(timeout=300)[0].strip() == b"300"


def test_only_the_given_loopback_endpoint_is_open() -> None:
    before = {c.laddr for c in psutil.Process().net_connections("inet") if c.status == psutil.CONN_LISTEN}
    endpoint = free_endpoint()
    with Bus("bridge", "test", listen=endpoint), Bus("a", "test", connect=endpoint):
        now = {c.laddr for c in psutil.Process().net_connections("inet") if c.status == psutil.CONN_LISTEN}
        udp = psutil.Process().net_connections("udp")
    assert {(a.ip, a.port) for a in now - before} == {("127.0.0.1", int(endpoint.rpartition(":")[2]))}
    assert udp == []
