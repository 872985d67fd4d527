"""Pilots that know the truth: what choosing views well can reach. They never collide."""

from __future__ import annotations

import time
from typing import Protocol

import numpy as np

from missions.nbv_trial import Answer, Ask, Choice, Frame
from missions.pose_lattice import UNREACHED, Index5, Indices, fewest_steps, way_back
from sim_bridge.nbv.arena import Arena
from sim_bridge.nbv.score import Score
from sim_bridge.nbv.visibility import Bits, count

BEAM_WIDTH, BEAM_DEPTH = 10, 10
"""As in MAGICIAN (CVPR 2026)."""


class Planner(Protocol):
    """Picks one of the allowed next poses (k,) from the set that is covered so far; None where none of its plans shows
    anything new."""

    def __call__(self, arena: Arena, allowed: Indices, covered: Bits) -> int | None: ...


class Oracle:
    """Takes the collision-free step that its planner picks. Where no plan shows anything new it goes the shortest way
    towards the nearest view that does, of equally near ones the one that shows most. What other vehicles are on their
    way to see counts as seen."""

    wants_pictures = False

    def __init__(self, arena: Arena, score: Score, starts: list[Index5], planner: Planner) -> None:
        self._arena, self._score, self._planner = arena, score, planner
        self._at = {vehicle: arena.lattice.flat(start) for vehicle, start in enumerate(starts, 1)}

    def see(self, frame: Frame) -> None:
        """Needs no pictures."""

    def choose(self, ask: Ask) -> Answer:
        """The next step; the vehicle waits where others block every free one."""
        begin = time.perf_counter()
        arena, here = self._arena, self._at[ask.vehicle]
        candidates = {arena.lattice.flat(index) for index in ask.candidates}
        allowed = np.array([n for n in arena.steps[here] if n != UNREACHED and int(n) in candidates], dtype=np.int64)
        covered = self._score.covered.copy()
        for goal in self._at.values():
            covered |= arena.seen[goal]
        chosen = here
        if len(allowed):
            found = self._planner(arena, allowed, covered)
            chosen = self._towards_gain(here, allowed, covered) if found is None else found
        self._at[ask.vehicle] = chosen
        choice = Choice(vehicle=ask.vehicle, index=arena.lattice.index(chosen), coverage_estimate=arena.share(covered))
        return Answer(choice=choice, seconds_seeing=0.0, seconds_choosing=time.perf_counter() - begin,
                      peak_memory_mib=0.0)

    def _towards_gain(self, here: int, allowed: Indices, covered: Bits) -> int:
        steps = self._arena.steps
        distance = fewest_steps(steps, here)
        gain = count(self._arena.seen & ~covered)
        worth = np.flatnonzero((distance > 0) & (gain > 0))
        if not len(worth):
            return int(allowed[0])
        nearest = worth[distance[worth] == distance[worth].min()]
        first = way_back(steps, distance, int(nearest[gain[nearest].argmax()]))[0]
        return first if first in allowed else int(allowed[0])


def greedy(arena: Arena, allowed: Indices, covered: Bits) -> int | None:
    """The step that truly adds most; of equals the first."""
    gain = count(arena.seen[allowed] & ~covered)
    return int(allowed[gain.argmax()]) if gain.any() else None


def beam(arena: Arena, allowed: Indices, covered: Bits) -> int | None:
    """The first step of the plan that adds most in BEAM_DEPTH steps, the best BEAM_WIDTH plans being kept on the way.

    Of plans that come to the same pose with the same gain one is kept. Of equals the first wins.
    """
    pose, root, gained = allowed, np.arange(len(allowed)), np.zeros(len(allowed), dtype=np.int64)
    before = np.broadcast_to(covered, (len(allowed), len(covered)))
    for depth in range(BEAM_DEPTH):
        if depth:
            ahead = arena.steps[pose]
            plan, step = np.nonzero(ahead != UNREACHED)
            pose, root, gained, before = ahead[plan, step], root[plan], gained[plan], before[plan]
        total = gained + count(arena.seen[pose] & ~before)
        _, unique = np.unique(np.stack([-total, pose]), axis=1, return_index=True)
        best = unique[:BEAM_WIDTH]
        pose, root, gained = pose[best], root[best], total[best]
        before = before[best] | arena.seen[pose]
    return int(allowed[root[0]]) if gained[0] > 0 else None


ORACLES: dict[str, Planner] = {"greedy_oracle": greedy, "beam_oracle": beam}
