"""Vehicles that share a system id are told from vehicles that restart, roam or have two links."""

from __future__ import annotations

import socket
from contextlib import closing

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from missions.mavlink import Endpoint
from missions.mission import MavlinkSpec
from sim_bridge.doors import Doors
from sim_bridge.duplicates import ALTERNATE_S, CLEAR_S, SOURCES, Duplicates
from sim_bridge.frame_header import boot_ms_of, uid_of

A, B = ("127.0.0.1", 14550), ("127.0.0.1", 14551)


def test_two_addresses_by_turns_are_two_vehicles() -> None:
    watch = Duplicates()
    for n in range(4):
        watch.heard(3, (A, B)[n % 2], 0.5 * n)
    found = watch.conflicts(2.0)
    assert [c.system for c in found] == [3]
    assert "127.0.0.1:14550" in found[0].reason
    assert "127.0.0.1:14551" in found[0].reason
    assert watch.conflict(4, 2.0) is None


def test_a_vehicle_that_changes_its_port_once_is_one_vehicle() -> None:
    watch = Duplicates()
    for n in range(40):
        watch.heard(3, A if n < 20 else B, 0.5 * n)
        assert not watch.conflicts(0.5 * n)


def test_one_vehicle_with_two_links_and_one_uid_is_one_vehicle() -> None:
    watch = Duplicates()
    watch.heard(3, A, 0.0, uid=77)
    watch.heard(3, B, 0.0, uid=77)
    for n in range(40):
        watch.heard(3, (A, B)[n % 2], 0.1 * n, boot_ms=100 * n)
        assert not watch.conflicts(0.1 * n)


def test_two_uids_are_two_vehicles_even_behind_one_address() -> None:
    watch = Duplicates()
    watch.heard(3, A, 0.0, uid=77)
    watch.heard(3, A, 1.0, uid=0)
    assert not watch.conflicts(1.0)
    watch.heard(3, A, 2.0, uid=78)
    assert "uid 77 and uid 78" in watch.conflicts(2.0)[0].reason


def test_a_restart_is_one_step_back_in_time_and_two_vehicles_are_many() -> None:
    watch = Duplicates()
    for n in range(20):
        watch.heard(3, A, 0.2 * n, boot_ms=500_000 + 200 * n if n < 10 else 200 * (n - 10))
        assert not watch.conflicts(0.2 * n)
    for n in range(6):
        watch.heard(3, A, 4.0 + 0.2 * n, boot_ms=(500_000, 10_000)[n % 2] + 200 * n)
    assert "time since boot" in watch.conflicts(5.0)[0].reason


@given(st.lists(st.integers(-200, 200), min_size=5, max_size=60), st.integers(0, (1 << 32) - 1))
def test_frames_that_overtake_each_other_and_a_counter_that_wraps_are_no_conflict(jitter_ms: list[int],
                                                                                 start_ms: int) -> None:
    watch = Duplicates()
    for n, late in enumerate(jitter_ms):
        watch.heard(3, A, 0.1 * n, boot_ms=(start_ms + 100 * n + late) % (1 << 32))
        assert not watch.conflicts(0.1 * n)


@pytest.mark.parametrize("kind", ["address", "boot", "uid"])
@given(st.floats(0.05, 1.0), st.floats(0.0, 1e6))
def test_two_alternating_vehicles_are_found_within_the_window_and_forgotten_when_one_is_gone(
        kind: str, every_s: float, start_s: float) -> None:
    watch, found_s = Duplicates(), None
    for n in range(int(4 * ALTERNATE_S / every_s)):
        now_s, one = start_s + every_s * n, n % 2
        watch.heard(3, (A, B)[one] if kind == "address" else A, now_s,
                    boot_ms=int(1e5 + 9e5 * one + 1000 * every_s * n) if kind == "boot" else None,
                    uid=(71, 72)[one] if kind == "uid" else None)
        if watch.conflicts(now_s):
            found_s = now_s if found_s is None else found_s
    assert found_s is not None
    assert found_s - start_s <= 4.01 * every_s
    alone_s = now_s + CLEAR_S + 0.1
    for n in range(5):
        watch.heard(3, A, now_s + n * CLEAR_S / 4.0, boot_ms=int(2e7 + 1000 * n), uid=72 if kind == "uid" else None)
    assert not watch.conflicts(alone_s)


@given(st.integers(0, (1 << 32) - 1), st.integers(0, (1 << 64) - 1))
def test_boot_time_and_uid_are_read_off_frames_as_pymavlink_packs_them(boot_ms: int, uid: int) -> None:
    endpoint, none = Endpoint(3, 1), [0] * 8
    for message in (mav.MAVLink_global_position_int_message(boot_ms, 1, 2, 3, 4, 5, 6, 7, 8),
                    mav.MAVLink_system_time_message(9, boot_ms),
                    mav.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)):
        frame = endpoint.pack(message)
        assert (boot_ms_of(frame), uid_of(frame)) == (boot_ms, None)
    version = endpoint.pack(mav.MAVLink_autopilot_version_message(0, 0, 0, 0, 0, none, none, none, 0, 0, uid))
    assert (boot_ms_of(version), uid_of(version)) == (None, uid)
    assert boot_ms_of(beat(endpoint)) is None


def test_many_addresses_do_not_fill_the_memory() -> None:
    watch = Duplicates()
    for n in range(1000):
        watch.heard(3, ("10.0.0.1", n), 0.01 * n)
    assert len(watch._systems[3].sources) <= SOURCES


def beat(endpoint: Endpoint, kind: int = mav.MAV_TYPE_QUADROTOR) -> bytes:
    return endpoint.pack(mav.MAVLink_heartbeat_message(kind, mav.MAV_AUTOPILOT_PX4, 0, 0, 0, 3))


def test_commands_for_an_id_that_two_vehicles_have_are_kept_back_and_people_are_told() -> None:
    """Vehicle 1 flies here, and somebody's vehicle with the same id knocks at the door; vehicle 2 is alone."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = free.getsockname()
    arm = [Endpoint(255, 190).pack(mav.MAVLink_command_long_message(k, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)) for k in (1, 2)]
    vehicle, stranger = Endpoint(1, 1), Endpoint(1, 1)
    with closing(Doors(MavlinkSpec(open=[f"udpin://{address[0]}:{address[1]}"]), 2)) as doors, \
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(60.0)

        def through(*frames: bytes) -> dict[int, list[bytes]]:
            for frame in frames:
                client.sendto(frame, address)
            assert doors.wait(60.0)
            return dict(doors.receive(0))

        doors.send(1, [beat(vehicle)], 0)
        assert through(*arm) == {1: [arm[0]], 2: [arm[1]]}
        for _ in range(3):
            echo = beat(vehicle)
            doors.send(1, [echo], 0)
            assert through(echo, *arm) == {1: [echo, arm[0]], 2: [echo, arm[1]]}, "a router that mirrors is nobody else"
        through(beat(stranger, mav.MAV_TYPE_HEXAROTOR))
        doors.send(1, [beat(vehicle)], 0)
        through(beat(stranger, mav.MAV_TYPE_HEXAROTOR))
        assert through(*arm) == {2: [arm[1]]}
        texts = []
        while not texts:
            texts = [m for m in Endpoint(255, 190).parse([client.recv(300)]) if m.get_type() == "STATUSTEXT"]
        assert texts[0].severity == mav.MAV_SEVERITY_CRITICAL
        assert texts[0].text == "system id 1 is used twice: commands refused"
