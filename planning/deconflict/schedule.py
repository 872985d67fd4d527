"""Space-time conflicts between planned tours, and holds that remove them before anything flies.

Prioritised planning (Cap, Novak, Kleiner and Selecky, "Prioritized Planning Algorithms for Trajectory Coordination of
Multiple Mobile Robots", IEEE T-ASE 12(3), 2015): the longest tour first; every other one is fitted around those before
it by waiting at its own rests. Where to wait and for how long is found by safe intervals (Phillips and Likhachev,
"SIPP", ICRA 2011): a rest is a set of intervals in which nobody comes near, and only the earliest arrival in each
matters.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from planning.deconflict.separation import NEVER, first_approach

STEP_S = 0.2
"""Tracks are sampled so; in between they leave the chords by at most a STEP_S^2 / 8, 1 cm at 2 m/s2."""
SLACK_S = 1.2
"""Tracks stay apart even when either vehicle is that late."""
HOLD_STEP_S = 0.6
LONGEST_HOLD_S = 180.0


@dataclass(frozen=True)
class Track:
    """A vehicle's predicted motion: at position_enu_m[i] (n, 3) at t_s[i] (n,), rising; at rest before and after."""

    t_s: Array
    position_enu_m: Array

    @property
    def duration_s(self) -> float:
        """From the first to the last time."""
        return float(self.t_s[-1] - self.t_s[0])


Tour = Sequence[Track]
"""Runs from rest to rest, each beginning where the one before ends; times count from the beginning of each run."""


@dataclass(frozen=True)
class Conflict:
    """Two vehicles (indices) come nearer than the separation for the first time, seconds from the start."""

    a: int
    b: int
    t_s: float


@dataclass(frozen=True)
class Schedule:
    """When everybody flies what: for each vehicle which of its tours, how long it waits before each run, its end."""

    tour: list[int]
    hold_s: list[list[float]]
    finish_s: list[float]
    unresolved: list[Conflict]
    """What waiting could not resolve, and vehicles on board have to."""


def conflicts(tracks: Sequence[Track], separation_m: float, slack_s: float = 0.0) -> list[Conflict]:
    """Pairs of tracks on one clock that come nearer than separation_m, even when either is slack_s late."""
    end = max((float(t.t_s[-1]) for t in tracks), default=0.0)
    grids = [_sampled(t, math.ceil(end / STEP_S) + 2) for t in tracks]
    found = []
    for b in range(len(tracks)):
        for a in range(b):
            at = first_approach(grids[a], grids[b], math.ceil(slack_s / STEP_S), separation_m)
            if at != NEVER:
                found.append(Conflict(a, b, at * STEP_S))
    return found


def schedule(tours: Sequence[Sequence[Tour]], separation_m: float, slack_s: float = SLACK_S) -> Schedule:
    """Holds for one tour per vehicle. tours[v]: the ways to fly vehicle v's views, the preferred one first (as planned,
    reversed, begun elsewhere); the one that is done first is taken. Vehicles without runs rest out of everybody's way.

    Equal arguments give equal schedules. Times are rounded up to STEP_S.
    """
    chosen, holds = [0] * len(tours), [[0.0] * len(ways[0]) if ways else [] for ways in tours]
    flown: dict[int, Array] = {}
    order = sorted((v for v, ways in enumerate(tours) if ways and ways[0]), key=lambda v: (-_length(tours[v][0]), v))
    for v in order:
        plans = [_fitted(tour, list(flown.values()), separation_m, slack_s) for tour in tours[v]]
        fitted = [(sum(p) + _length(tours[v][n]), n) for n, p in enumerate(plans) if p is not None]
        chosen[v] = min(fitted)[1] if fitted else 0
        holds[v] = plans[chosen[v]] or [0.0] * len(tours[v][chosen[v]])
        flown[v] = _flown(tours[v][chosen[v]], holds[v])
    tracks = [Track(STEP_S * np.arange(len(flown[v]), dtype=np.float64), flown[v]) for v in sorted(flown)]
    left = [Conflict(sorted(flown)[c.a], sorted(flown)[c.b], c.t_s) for c in conflicts(tracks, separation_m)]
    finish = [(len(flown[v]) - 1) * STEP_S if v in flown else 0.0 for v in range(len(tours))]
    return Schedule(chosen, holds, finish, left)


class _Visit(NamedTuple):
    """At rest before run `run` since step `step`, in safe interval `interval` of that rest."""

    step: int
    run: int
    interval: int


def _fitted(tour: Tour, others: list[Array], separation_m: float, slack_s: float) -> list[float] | None:
    """Seconds to wait before each run so that the tour keeps clear of all others; None when waiting does not help."""
    slack = math.ceil(slack_s / STEP_S)
    runs = [_sampled(run, math.ceil(run.duration_s / STEP_S - 1e-9) + 1) for run in tour]
    rests = [_safe_intervals(run[0], others, slack, separation_m) for run in runs]
    rests.append(_safe_intervals(runs[-1][-1], others, slack, separation_m))
    came: dict[tuple[int, int], _Visit] = {}
    start = _interval_of(rests[0], 0)
    queue = [_Visit(0, 0, start)] if start is not None else []
    while queue:
        here = heapq.heappop(queue)
        if here.run == len(runs):
            return _holds(here, came, runs)
        for step in _starts(here, rests[here.run]):
            arrival = step + len(runs[here.run]) - 1
            interval = _interval_of(rests[here.run + 1], arrival)
            if interval is None or (here.run + 1, interval) in came or (
                    here.run + 1 == len(runs) and rests[-1][interval][1] is not None):
                continue
            if _clear(runs[here.run], step, others, slack, separation_m):
                came[here.run + 1, interval] = here
                heapq.heappush(queue, _Visit(arrival, here.run + 1, interval))
    return None


def _starts(here: _Visit, rest: list[tuple[int, int | None]]) -> range:
    last = here.step + round(LONGEST_HOLD_S / STEP_S)
    end = rest[here.interval][1]
    return range(here.step, (last if end is None else min(last, end)) + 1, round(HOLD_STEP_S / STEP_S))


def _holds(end: _Visit, came: dict[tuple[int, int], _Visit], runs: list[Array]) -> list[float]:
    out: list[float] = []
    while end.run > 0:
        before = came[end.run, end.interval]
        out.append((end.step - before.step - (len(runs[before.run]) - 1)) * STEP_S)
        end = before
    return out[::-1]


def _clear(run: Array, step: int, others: list[Array], slack: int, separation_m: float) -> bool:
    """Whether a run that starts at a step stays clear of all the others."""
    mine = np.concatenate([np.repeat(run[:1], slack, axis=0), run, np.repeat(run[-1:], slack, axis=0)])
    index = np.arange(step - slack, step + len(run) + slack)
    return all(first_approach(mine, other[np.clip(index, 0, len(other) - 1)], slack, separation_m) == NEVER
               for other in others)


def _safe_intervals(place: Array, others: list[Array], slack: int, separation_m: float) -> list[tuple[int, int | None]]:
    """(first step, last step or None for ever) of the times at which nobody is near a place, nor slack steps later."""
    length = max((len(o) for o in others), default=1)
    taken: NDArray[np.bool_] = np.zeros(length, dtype=np.bool_)
    for other in others:
        near = np.linalg.norm(other - place, axis=1) < separation_m + STEP_S
        taken[:len(other)] |= near
        taken[len(other):] |= near[-1]
    out: list[tuple[int, int | None]] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[True], taken, [True]]).astype(np.int8)))
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        last = None if after == length else int(after) - 1 - slack
        begin = int(first) + (slack if first else 0)
        if last is None or last >= begin:
            out.append((begin, last))
    return out


def _interval_of(rest: list[tuple[int, int | None]], step: int) -> int | None:
    return next((n for n, (a, b) in enumerate(rest) if a <= step and (b is None or step <= b)), None)


def _sampled(track: Track, count: int) -> Array:
    """(count, 3) positions every STEP_S from the first time of the clock, or of the track when it begins later."""
    t = np.arange(count) * STEP_S
    return np.stack([np.interp(t, track.t_s, track.position_enu_m[:, axis]) for axis in range(3)], axis=1)


def _flown(tour: Tour, holds: list[float]) -> Array:
    parts = []
    for run, hold in zip(tour, holds, strict=True):
        samples = _sampled(run, math.ceil(run.duration_s / STEP_S - 1e-9) + 1)
        parts.append(np.concatenate([np.repeat(samples[:1], round(hold / STEP_S), axis=0), samples[:-1]]))
    return np.concatenate([*parts, samples[-1:]])


def _length(tour: Tour) -> float:
    return sum(run.duration_s for run in tour)
