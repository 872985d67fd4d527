"""The lock-step clock: the same deliveries whatever the load, nobody waits for the dead, strangers are told why."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from missions import topics
from missions.bus import Bus
from missions.clock import BRIDGE, SimClock
from missions.errors import LinkError, UserError
from missions.messages import PlanHash, PlanVerdict, SiteBrief
from missions.mission import ClockSpec
from sim_bridge.clock_server import ClockServer, Round
from tests.loopback import free_endpoint

HASH = "0123456789abcdef"
SITE = SiteBrief(object_min_enu_m=(0.0, 0.0, 0.0), object_max_enu_m=(1.0, 1.0, 1.0), ground_up_m=0.0)
JOIN_S = 20.0


@dataclass
class Log:
    """What a participant lived through."""

    turns: list[tuple[int, int, bool, tuple[str, ...]]] = field(default_factory=list)
    deliveries: list[tuple[int, str, str, str, int, Any]] = field(default_factory=list)
    error: Exception | None = None


Work = Callable[[SimClock, Bus, Any], bool]


def participant(name: str, endpoint: str, log: Log, work: Work) -> threading.Thread:
    """A process of the mission, as a thread; `work` handles a turn and says whether to go on."""

    def live() -> None:
        try:
            with Bus(name, "test", connect=endpoint) as bus:
                bus.subscribe(topics.PLAN_HASH)
                bus.subscribe(topics.PLAN_VERDICT)
                clock = SimClock(bus, HASH)
                assert clock.join(JOIN_S) == SITE
                while True:
                    turn = clock.next()
                    log.turns.append((turn.tick, turn.t_ns, turn.stop, tuple(sorted(turn.participants))))
                    log.deliveries += [(turn.tick, d.topic.path, d.who, d.sender, d.t_ns, d.message)
                                       for d in turn.deliveries]
                    if not work(clock, bus, turn):
                        return
        except (LinkError, UserError) as e:
            log.error = e

    thread = threading.Thread(target=live, name=name, daemon=True)
    thread.start()
    return thread


def burn(rng: np.random.Generator) -> None:
    """Keep the processor busy for a random while."""
    for _ in range(int(rng.integers(0, 1500))):
        hashlib.sha256(b"x" * 500).digest()


def chatter(name: str, load_seed: int, until_tick: int) -> Work:
    """Sends messages drawn from the participant's own seed, after random pauses drawn from the load's."""
    mine, load = np.random.default_rng(list(name.encode())), np.random.default_rng([load_seed, *name.encode()])

    def work(clock: SimClock, bus: Bus, turn: Any) -> bool:
        for _ in range(int(mine.integers(0, 4))):
            burn(load)
            who = int(mine.integers(1, 4))
            if mine.random() < 0.5:
                bus.publish(topics.PLAN_HASH, PlanHash(plan_id=turn.tick, count=int(mine.integers(99)), sha256=name),
                            f"{name}-{who}")
            else:
                bus.publish(topics.PLAN_VERDICT, PlanVerdict(plan_id=turn.tick, sha256=name, accepted=True),
                            f"{name}-{who}")
        if turn.stop or turn.tick == until_tick:
            clock.leave()
            return False
        clock.done(turn.t_ns + int(mine.integers(1, 200)) * 1_000_000)
        return True

    return work


def serve(endpoint: str, names: set[str], start: Callable[[], list[threading.Thread]], ticks: int) -> list[Round]:
    """Run the bridge's end for some ticks, then stop everybody."""
    with Bus(BRIDGE, "test", listen=endpoint) as bus:
        bus.subscribe(topics.PLAN_HASH)
        server = ClockServer(bus, ClockSpec(), HASH, SITE)
        threads = start()
        server.admit(names, JOIN_S)
        rounds = []
        while len(rounds) < ticks and (not rounds or rounds[-1].participants):
            rounds.append(server.run_tick())
            server.include_own()
        server.run_tick(stop=True)
    for thread in threads:
        thread.join(JOIN_S)
        assert not thread.is_alive()
    return rounds


def mission(load_seed: int, ticks: int = 60) -> tuple[dict[str, Log], list[Any]]:
    endpoint, logs = free_endpoint(), {name: Log() for name in ("ground", "uav1", "uav2")}
    leave_at = {"ground": 999, "uav1": 999, "uav2": 41}

    def start() -> list[threading.Thread]:
        return [participant(k, endpoint, log, chatter(k, load_seed, leave_at[k])) for k, log in logs.items()]

    rounds = serve(endpoint, set(logs), start, ticks)
    heard = [(r.tick, r.t_ns, sorted(r.participants), [(d.who, d.message) for d in r.deliveries]) for r in rounds]
    return logs, heard


def test_load_changes_nothing() -> None:
    first, bridge_first = mission(load_seed=1)
    second, bridge_second = mission(load_seed=2)
    assert bridge_first == bridge_second
    for name in first:
        assert first[name].error is None
        assert first[name].turns == second[name].turns
        assert first[name].deliveries == second[name].deliveries
    assert len(first["ground"].deliveries) > 100


def test_messages_arrive_one_tick_after_they_were_sent_and_time_keeps_its_bounds() -> None:
    logs, _ = mission(load_seed=3)
    for log in logs.values():
        t_of = {tick: t for tick, t, _, _ in log.turns}
        assert all(t_of[tick - 1] == sent for tick, _, _, _, sent, _ in log.deliveries)
        assert all(message.plan_id == tick - 1 for tick, *_, message in log.deliveries)
    times = np.array([t for _, t, stop, _ in logs["ground"].turns if not stop])
    assert times[0] == 0
    assert (np.diff(times) >= 10_000_000)[times[1:] % 100_000_000 != 0].all()
    assert np.diff(times).min() > 0
    assert np.diff(times).max() <= 100_000_000
    assert set(range(0, int(times[-1]), 100_000_000)) <= set(times.tolist())


def test_who_leaves_is_heard_to_the_end_and_gone_in_the_next_tick() -> None:
    logs, bridge = mission(load_seed=4)
    assert logs["uav2"].turns[-1][0] == 41
    assert all(("uav2" in who) == (tick <= 41) for tick, _, _, who in logs["ground"].turns)
    assert all(("uav2" in who) == (tick < 41) for tick, _, who, _ in bridge)
    sent_last = [d for d in logs["uav1"].deliveries if d[3] == "uav2"]
    assert max(d[0] for d in sent_last) <= 42


def test_the_stop_reaches_everybody() -> None:
    logs, _ = mission(load_seed=5, ticks=10)
    assert all(log.turns[-1][2] for log in logs.values())


def steady(clock: SimClock, bus: Bus, turn: Any) -> bool:
    clock.done(turn.t_ns + 1_000_000_000)
    return not turn.stop


VICTIM = """
import os, signal, sys
from missions.bus import Bus
from missions.clock import SimClock
with Bus("uav1", "test", connect=sys.argv[1]) as bus:
    clock = SimClock(bus, sys.argv[2])
    clock.join(20.0)
    while True:
        turn = clock.next()
        if turn.tick == 5:
            os.kill(os.getpid(), signal.SIGKILL)
        clock.done(turn.t_ns + 1)
"""


@pytest.mark.loopback
def test_a_killed_process_is_left_behind() -> None:
    endpoint, log = free_endpoint(), Log()
    victims: list[subprocess.Popen[bytes]] = []

    def start() -> list[threading.Thread]:
        victims.append(subprocess.Popen([sys.executable, "-c", VICTIM, endpoint, HASH], env=dict(os.environ)))
        return [participant("ground", endpoint, log, steady)]

    rounds = serve(endpoint, {"ground", "uav1"}, start, 20)
    assert victims[0].wait() == -signal.SIGKILL
    assert [r.tick for r in rounds if "uav1" in r.participants] == list(range(5))
    assert [r.tick for r in rounds] == list(range(20))
    assert log.turns[-1][2]


def test_another_mission_and_strangers_are_refused() -> None:
    endpoint, log = free_endpoint(), Log()

    def attempt(name: str, mission_hash: str) -> str:
        with Bus(name, "test", connect=endpoint) as bus:
            with pytest.raises(UserError) as e:
                SimClock(bus, mission_hash).join(JOIN_S)
            return str(e.value)

    reasons: list[str] = []

    def intruder() -> None:
        reasons.append(attempt("uav1", "another mission"))
        reasons.append(attempt("uav7", HASH))
        participant("ground", endpoint, log, steady)

    serve(endpoint, {"ground"}, lambda: [_started(intruder)], 3)
    assert len(reasons) == 2
    assert "the mission has no uav1" in reasons[0]
    assert "the mission has no uav7" in reasons[1]


def test_who_comes_late_is_told() -> None:
    endpoint, log = free_endpoint(), Log()
    reasons: list[str] = []

    def late(clock: SimClock, bus: Bus, turn: Any) -> bool:
        if turn.tick == 1:
            with Bus("uav2", "test", connect=endpoint) as other, pytest.raises(UserError) as e:
                SimClock(other, HASH).join(JOIN_S)
            reasons.append(str(e.value))
        return steady(clock, bus, turn)

    serve(endpoint, {"ground"}, lambda: [participant("ground", endpoint, log, late)], 4)
    assert "under way" in reasons[0]


def test_missing_participants_are_named() -> None:
    with Bus(BRIDGE, "test", listen=free_endpoint()) as bus:
        server = ClockServer(bus, ClockSpec(), HASH, SITE)
        with pytest.raises(LinkError, match="ground, uav1"):
            server.admit({"ground", "uav1"}, 0.05)


def test_an_interrupt_ends_the_wait_for_a_hung_participant() -> None:
    endpoint, log = free_endpoint(), Log()
    hung = threading.Event()
    with Bus(BRIDGE, "test", listen=endpoint) as bus:
        server = ClockServer(bus, ClockSpec(), HASH, SITE)

        def hang(clock: SimClock, _: Bus, turn: Any) -> bool:
            server.interrupt()
            hung.wait(JOIN_S)
            return False

        thread = participant("ground", endpoint, log, hang)
        server.admit({"ground"}, JOIN_S)
        assert server.run_tick().deliveries == []
        assert server.interrupted
        hung.set()
        thread.join(JOIN_S)


def test_the_participant_notices_that_the_bridge_is_gone() -> None:
    endpoint, log = free_endpoint(), Log()
    with Bus(BRIDGE, "test", listen=endpoint) as bus:
        server = ClockServer(bus, ClockSpec(), HASH, SITE)
        thread = participant("ground", endpoint, log, steady)
        server.admit({"ground"}, JOIN_S)
        server.run_tick()
    thread.join(JOIN_S)
    assert isinstance(log.error, LinkError)


def test_real_time_pacing_never_runs_ahead() -> None:
    endpoint, log = free_endpoint(), Log()
    with Bus(BRIDGE, "test", listen=endpoint) as bus:
        server = ClockServer(bus, ClockSpec(speed=10.0), HASH, SITE)
        thread = participant("ground", endpoint, log, steady)
        server.admit({"ground"}, JOIN_S)
        begin = server._wall_start
        for _ in range(20):
            round_ = server.run_tick()
            assert time.monotonic() - begin >= round_.t_ns / 1e10 - 1e-6
        server.run_tick(stop=True)
    thread.join(JOIN_S)


def _started(target: Callable[[], None]) -> threading.Thread:
    thread = threading.Thread(target=target, daemon=True)
    thread.start()
    return thread
