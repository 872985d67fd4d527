"""The lock-step clock: the same deliveries whatever the load, nobody waits for the dead, strangers are told why."""

from __future__ import annotations

import hashlib
import itertools
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
from missions.clock import BRIDGE, SimClock, Turn
from missions.errors import LinkError, UserError
from missions.messages import Join, PlanHash, PlanVerdict, SiteBrief, TickDone
from missions.simulation import ClockSpec
from sim_bridge.clock_server import ClockServer, ClockState, Round
from tests.loopback import free_endpoint

HASH = "0123456789abcdef"
SITE = SiteBrief(object_min_enu_m=(0.0, 0.0, 0.0), object_max_enu_m=(1.0, 1.0, 1.0), ground_up_m=0.0)
JOIN_S = 120.0


@dataclass
class Log:
    """What a participant lived through."""

    turns: list[tuple[int, int, bool, tuple[str, ...]]] = field(default_factory=list)
    deliveries: list[tuple[int, str, str, str, int, Any]] = field(default_factory=list)
    error: Exception | None = None


Work = Callable[[SimClock, Bus, Any], bool]


def participant(name: str, endpoint: str, log: Log, work: Work, patience_s: float = 0.0) -> threading.Thread:
    """A process of the mission, as a thread; `work` handles a turn and says whether to go on."""

    def live() -> None:
        try:
            with Bus(name, "test", connect=endpoint) as bus:
                bus.subscribe(topics.PLAN_HASH)
                bus.subscribe(topics.PLAN_VERDICT)
                clock = SimClock(bus, HASH, patience_s)
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
from missions.messages import PlanVerdict
from missions.topics import PLAN_VERDICT
with Bus("uav1", "test", connect=sys.argv[1]) as bus:
    clock = SimClock(bus, sys.argv[2])
    clock.join(20.0)
    while True:
        turn = clock.next()
        bus.publish(PLAN_VERDICT, PlanVerdict(plan_id=turn.tick, sha256="", accepted=True), "uav1")
        if turn.tick == int(sys.argv[3]):
            os.kill(os.getpid(), signal.SIGKILL)
        clock.done(turn.t_ns + 1)
"""


def victim(endpoint: str, dies_at: int = 5) -> subprocess.Popen[bytes]:
    """A vehicle that is killed at work in this tick."""
    return subprocess.Popen([sys.executable, "-c", VICTIM, endpoint, HASH, str(dies_at)], env=dict(os.environ))


@pytest.mark.loopback
def test_a_killed_process_is_left_behind() -> None:
    endpoint, log = free_endpoint(), Log()
    victims: list[subprocess.Popen[bytes]] = []

    def start() -> list[threading.Thread]:
        victims.append(victim(endpoint))
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


@pytest.mark.loopback
def test_who_takes_the_place_of_a_killed_process_hears_and_is_heard_from_there_on() -> None:
    """Its predecessor had said more than anybody counted; the numbers begin anew."""
    endpoint, log, heir = free_endpoint(), Log(), Log()
    victims: list[subprocess.Popen[bytes]] = []
    heirs: list[threading.Thread] = []

    def start() -> list[threading.Thread]:
        victims.append(victim(endpoint))
        return [participant("ground", endpoint, log, talks_and_calls_the_heir)]

    def talks_and_calls_the_heir(clock: SimClock, bus: Bus, turn: Any) -> bool:
        if turn.tick == 7:
            heirs.append(participant("uav1", endpoint, heir, talks))
        return talks(clock, bus, turn)

    def talks(clock: SimClock, bus: Bus, turn: Any) -> bool:
        bus.publish(topics.PLAN_VERDICT, PlanVerdict(plan_id=turn.tick, sha256=bus.name, accepted=True), bus.name)
        time.sleep(0.01)
        return steady(clock, bus, turn)

    rounds = serve(endpoint, {"ground", "uav1"}, start, 150)
    heirs[0].join(JOIN_S)
    assert victims[0].wait() == -signal.SIGKILL
    assert heir.error is None
    back = heir.turns[0][0]
    assert back > 8
    assert [t[0] for t in heir.turns] == list(range(back, 151))
    assert [r.tick for r in rounds if "uav1" in r.participants] == [*range(5), *range(back, 150)]
    assert [d[0] for d in log.deliveries if d[3] == "uav1"] == [*range(1, 6), *range(back + 1, 151)]
    assert all(d[5].plan_id == d[0] - 1 for d in log.deliveries + heir.deliveries)
    assert [d[0] for d in heir.deliveries if d[3] == "ground"] == list(range(back + 1, 151))


def await_message(clock: SimClock, turn: Turn, what: Callable[[Any], bool]) -> None:
    """Hold everybody's clock until this has come."""
    heard = turn.beside
    while not any(what(d.message) for d in heard):
        heard = clock.hear(JOIN_S)


@pytest.mark.loopback
def test_what_was_said_in_a_turn_that_was_finished_is_heard_also_when_the_heir_joins_in_it() -> None:
    """Somebody computes while a vehicle dies and is started again: one tick brings the last words of the dead and
    announces the heir."""
    endpoint, log, heir = free_endpoint(), Log(), Log()
    victims: list[subprocess.Popen[bytes]] = []
    heirs: list[threading.Thread] = []

    def start() -> list[threading.Thread]:
        victims.append(victim(endpoint, dies_at=999))
        return [participant("ground", endpoint, log, computes_for_long)]

    def computes_for_long(clock: SimClock, bus: Bus, turn: Any) -> bool:
        if turn.tick == 0:
            bus.subscribe(topics.TICK_DONE, "uav1")
            bus.subscribe(topics.JOIN)
        if turn.tick == 5:
            await_message(clock, turn, lambda m: isinstance(m, TickDone) and m.tick == 5)
            victims[0].kill()
            victims[0].wait()
            heirs.append(participant("uav1", endpoint, heir, steady))
            await_message(clock, turn, lambda m: isinstance(m, Join))
        return steady(clock, bus, turn)

    rounds = serve(endpoint, {"ground", "uav1"}, start, 20)
    heirs[0].join(JOIN_S)
    assert heir.error is None
    assert [r.tick for r in rounds if "uav1" in r.participants] == [*range(5), *range(7, 20)]
    assert [(d[0], d[5].plan_id) for d in log.deliveries if d[3] == "uav1"] == [(n + 1, n) for n in range(6)]


def test_who_asks_a_bridge_that_dies_asks_the_next_one() -> None:
    endpoint, log = free_endpoint(), Log()
    with Bus(BRIDGE, "test", listen=endpoint) as bus:
        bus.subscribe(topics.JOIN)
        bus.announce_alive()
        thread = participant("ground", endpoint, log, steady)
        assert [d.message.name for d in bus.poll(timeout_s=JOIN_S)] == ["ground"]
    rounds = serve(endpoint, {"ground"}, lambda: [thread], 3)
    assert log.error is None
    assert [r.tick for r in rounds if "ground" in r.participants] == [0, 1, 2]


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


@pytest.mark.parametrize("kept", [5, 3])
def test_a_bridge_whose_journal_was_not_on_disk_ends_the_mission_instead_of_hanging(kept: int) -> None:
    """Killed while its last steps waited in memory, it has a successor that knows less than those who took part."""
    endpoint, log, past = free_endpoint(), Log(), list[ClockState]()
    with Bus(BRIDGE, "test", listen=endpoint) as bus:
        boot, server = bus.boot, ClockServer(bus, ClockSpec(), HASH, SITE)
        thread = participant("ground", endpoint, log, steady, JOIN_S)
        server.admit({"ground"}, JOIN_S)
        for _ in range(5):
            server.run_tick(record=past.append)
    with Bus(BRIDGE, "test", listen=endpoint) as bus:
        bus.boot, server = boot, ClockServer(bus, ClockSpec(), HASH, SITE)
        server.readmit({"ground"}, past[:kept], JOIN_S)
        went_on = [server.run_tick().participants for _ in range(2)]
        server.run_tick(stop=True)
    thread.join(JOIN_S)
    assert not thread.is_alive()
    assert went_on == [frozenset({"ground"} if kept == 5 else ())] * 2
    assert (log.error is None) == (kept == 5)
    if kept < 5:
        assert "without the last 2 ticks" in str(log.error)


def test_real_time_pacing_never_runs_ahead() -> None:
    endpoint, log = free_endpoint(), Log()
    with Bus(BRIDGE, "test", listen=endpoint) as bus:
        server = ClockServer(bus, ClockSpec(speed=10.0), HASH, SITE)
        thread = participant("ground", endpoint, log, steady)
        server.admit({"ground"}, JOIN_S)
        begin = server._wall_start
        for _ in range(20):
            server.pace()
            round_ = server.run_tick()
            assert time.monotonic() - begin >= round_.t_ns / 1e10 - 1e-6
        server.run_tick(stop=True)
    thread.join(JOIN_S)


def test_time_that_a_computation_has_cost_is_not_made_up_for() -> None:
    endpoint, log = free_endpoint(), Log()
    with Bus(BRIDGE, "test", listen=endpoint) as bus:
        server = ClockServer(bus, ClockSpec(speed=10.0), HASH, SITE)
        thread = participant("ground", endpoint, log, steady)
        server.admit({"ground"}, JOIN_S)
        server._wall_start -= 3600.0
        for _ in range(3):
            server.pace()
            server.run_tick()
            assert server._wall_start + server.t_ns / 1e10 > time.monotonic() - 600.0
        server.run_tick(stop=True)
    thread.join(JOIN_S)


def test_a_visitor_makes_the_next_tick_come_at_once_but_never_backwards() -> None:
    endpoint, log = free_endpoint(), Log()
    with Bus(BRIDGE, "test", listen=endpoint) as bus:
        server = ClockServer(bus, ClockSpec(tick_s=1.0, speed=1.0), HASH, SITE)
        thread = participant("ground", endpoint, log, steady)
        server.admit({"ground"}, JOIN_S)
        times = []
        for _ in range(20):
            server.pace(lambda seconds: True)
            times.append(server.run_tick().t_ns)
        server.run_tick(stop=True)
    thread.join(JOIN_S)
    assert all(b - a >= 10_000_000 for a, b in itertools.pairwise(times))
    assert times[-1] < 19e9, "a second of simulated time was waited for between ticks"


def _started(target: Callable[[], None]) -> threading.Thread:
    thread = threading.Thread(target=target, daemon=True)
    thread.start()
    return thread
