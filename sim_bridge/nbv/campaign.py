"""Many trials: scenes x methods x starts x fleet sizes, several at a time, each in a process of its own."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

import msgspec
import numpy as np

from missions.errors import LinkError, SwarmscanError, UserError
from missions.pose_lattice import Index5
from sim_bridge.nbv.arena import Arena, make_arena
from sim_bridge.nbv.oracles import ORACLES, Oracle
from sim_bridge.nbv.player import Player
from sim_bridge.nbv.rules import Rules
from sim_bridge.nbv.score import Score
from sim_bridge.nbv.trial import Record, Trial
from sim_bridge.render.renderer import make_renderer


@dataclass(frozen=True)
class Run:
    """What one row of the result asks for."""

    scene: str
    method: str
    start: int
    vehicles: int


@dataclass(frozen=True)
class Campaign:
    """What all runs share. threads: that a method, or the renderer, may use. patience_s: wall time that a method may
    take over one picture or decision."""

    rules: Rules
    options: dict[str, str]
    threads: int
    patience_s: float


@dataclass(frozen=True)
class Row:
    """What came out of one run. Shares are 0-1; lists have an entry per key pose, in the order of arrival."""

    scene: str
    method: str
    start: int
    vehicles: int
    auc: float
    """Mean of curve."""
    final: float
    ceiling: float
    collisions: int
    """Legs that came nearer to the scene than the vehicle's radius."""
    unsafe_views: int
    """Key poses within the fleet's clearance of the scene, or shut in by it: they see nothing."""
    metres: float
    seconds: float
    """Simulated, of flight."""
    seconds_to_80: float | None
    """Until 80 % of the ceiling were covered."""
    seconds_to_90: float | None
    seconds_per_decision: float
    """Wall time of the method's process: all pictures since the last decision taken in and the choice made."""
    seconds_per_choice: float
    """The choice alone."""
    seconds_per_round: dict[int, float]
    """By how many vehicles arrived together: their decisions, one after the other; the first round left out."""
    processor_seconds_per_round: dict[int, float]
    """Likewise, of all threads of the method's process together."""
    peak_memory_mib: float
    stopped_at: int | None
    """Key poses after which the method would have ended the exploration."""
    wall_s: float
    curve: list[float]
    curve_metres: list[float]
    curve_seconds: list[float]
    estimates: list[float]
    """The method's own estimate of the covered share, at each decision."""
    visited: list[Index5]
    """Key poses on the lattice."""


Outcome = Row | SwarmscanError


def outcomes(runs: list[Run], campaign: Campaign, jobs: int) -> Iterator[tuple[Run, Outcome]]:
    """Every run with its row, or with why its method failed, as they end. Raises UserError or LinkError.

    One job at a time runs in this process, several in as many others.
    """
    if jobs == 1:
        _limit_threads(campaign.threads)
        yield from ((run, outcome(run, campaign)) for run in runs)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_limit_threads,
                             initargs=(campaign.threads,)) as pool:
        futures = {pool.submit(outcome, run, campaign): run for run in runs}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            raise LinkError("a process that runs trials was killed, perhaps for want of memory; lower --jobs") from None
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def outcome(run: Run, campaign: Campaign) -> Outcome:
    """A run's row, or why its method failed. Raises UserError."""
    try:
        return play(run, campaign)
    except UserError:
        raise
    except SwarmscanError as e:
        return e


def play(run: Run, campaign: Campaign) -> Row:
    """One run, its scene loaded where it is not at hand. Raises UserError or ProtocolError."""
    return play_in(_arena(run.scene, msgspec.json.encode(campaign.rules)), run, campaign)


def play_in(arena: Arena, run: Run, campaign: Campaign) -> Row:
    """One run in a scene that is ready. Raises UserError or ProtocolError."""
    rules = campaign.rules
    begin = time.perf_counter()
    brief = arena.brief(run.method, run.start, run.vehicles, campaign.options)
    before = [arena.step_before(start, run.start) for start in brief.starts]
    score = Score(arena)
    if run.method in ORACLES:
        record = Trial(brief, score, Oracle(arena, score, brief.starts, ORACLES[run.method]), None).run(before)
    else:
        renderer = make_renderer(arena.scene, rules.render, rules.camera, rules.seed)
        with closing(renderer), Player(brief, campaign.threads, campaign.patience_s) as player:
            record = Trial(brief, score, player, renderer).run(before)
    return row_of(run, record, time.perf_counter() - begin)


def row_of(run: Run, record: Record, wall_s: float) -> Row:
    """The numbers of a run, rounded. A trial that ended early keeps its last coverage."""
    score, answers = record.score, record.answers
    curve = score.curve + score.curve[-1:] * (score.arena.rules.poses - len(score.curve))
    choosing = [a.seconds_choosing for a in answers]
    deciding = [a.seconds_seeing + a.seconds_choosing for a in answers]
    return Row(
        scene=short_name(run.scene), method=run.method, start=run.start, vehicles=run.vehicles,
        auc=round(float(np.mean(curve)), 4), final=round(curve[-1], 4), ceiling=round(score.arena.ceiling, 4),
        collisions=score.collisions, unsafe_views=score.unsafe_views, metres=round(score.metres[-1], 1),
        seconds=round(score.seconds[-1], 1), seconds_to_80=score.seconds_to(0.8), seconds_to_90=score.seconds_to(0.9),
        seconds_per_decision=round(_mean(deciding), 4), seconds_per_choice=round(_mean(choosing), 4),
        seconds_per_round=_by_size(record.rounds, deciding),
        processor_seconds_per_round=_by_size(record.rounds, [a.seconds_processor for a in answers]),
        peak_memory_mib=round(max((a.peak_memory_mib for a in answers), default=0.0), 1),
        stopped_at=record.stopped_at, wall_s=round(wall_s, 1), curve=[round(c, 4) for c in curve],
        curve_metres=[round(m, 1) for m in score.metres], curve_seconds=[round(s, 2) for s in score.seconds],
        estimates=[round(a.choice.coverage_estimate, 4) for a in answers], visited=score.visited)


def _by_size(rounds: list[int], seconds: list[float]) -> dict[int, float]:
    """Mean seconds of rounds by their number of answers, the first round left out."""
    found: dict[int, list[float]] = {}
    ends = np.cumsum(rounds)
    for n, end in zip(rounds[1:], ends[1:], strict=True):
        if n:
            found.setdefault(n, []).append(sum(seconds[end - n:end]))
    return {n: round(_mean(s), 4) for n, s in found.items()}


def short_name(scene: str) -> str:
    """A scene's name; of a file the name without folder and ending."""
    return Path(scene).stem


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else 0.0


@lru_cache(maxsize=1)
def _arena(scene: str, rules_json: bytes) -> Arena:
    """The scene at hand: runs come ordered by scene."""
    return make_arena(scene, msgspec.json.decode(rules_json, type=Rules))


def _limit_threads(threads: int) -> None:
    os.environ["LP_NUM_THREADS"] = str(threads)
