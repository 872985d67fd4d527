"""Min-max allocation: ruin and recreate in several independent chains, the best of which is taken.

An effort in iterations gives the same result on every machine; an effort in seconds is for the command line only.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from planning.allocate.minmax_kernels import State, Tables, anneal
from planning.allocate.minmax_tables import Warm, sorties_of, state_of, tables_of
from planning.allocate.problem import Allocation, Problem, appraise

HOT, COLD = 0.02, 1e-4
"""First and last temperature of a cold search, as shares of the makespan."""
WARM_HOT = 0.002
"""First temperature of a search that begins with a plan."""
ROUNDS = 40


@dataclass(frozen=True)
class Effort:
    """How long to search. The result depends on `iterations` and `chains`, never on the number of processors."""

    iterations: int = 100_000
    """Ruins per chain; about 10 microseconds each."""
    chains: int = 4
    """Independent searches with seeds of their own, run on threads; the best is taken."""
    time_limit_s: float | None = None
    """Wall time instead of iterations: not reproducible, so never in flight."""


def solve(problem: Problem, effort: Effort | None = None, seed: int = 0, warm: Warm | None = None) -> Allocation:
    """Tours that end as early as possible for the vehicle that ends last, with the least sum among such.

    As many views as possible are served; the others come back in `left_over`. `warm`: begin with a plan, keep locked
    views where they are, and change few assignments (see `Warm`). The same arguments give the same allocation.
    """
    effort = effort or Effort()
    if not problem.views or not problem.vehicles:
        return appraise(problem, [[[]] for _ in range(problem.vehicles)])
    tables = tables_of(problem, warm)
    states = [state_of(tables, warm, seed, chain) for chain in range(effort.chains)]
    _search(tables, states, effort, HOT if warm is None else WARM_HOT)
    best = min(states, key=lambda state: float(state.cost[1]))
    return appraise(problem, sorties_of(tables, best, problem.vehicles))


def _search(tables: Tables, states: list[State], effort: Effort, hot: float) -> None:
    """All chains side by side on threads (the kernels release the interpreter's lock); each touches its own state."""
    with ThreadPoolExecutor(len(states)) as pool:
        list(pool.map(lambda state: anneal(tables, state, 0, 1.0, 1.0), states))
        scale = min(float(state.cost[2]) for state in states)
        if not scale > 0.0:
            return
        for iterations, first, last in _rounds(effort):
            heat = [scale * hot * (COLD / hot) ** share for share in (first, last)]
            list(pool.map(lambda state, n=iterations, h=heat: anneal(tables, state, n, h[0], h[1]), states))


def _rounds(effort: Effort) -> Iterator[tuple[int, float, float]]:
    """(iterations, share of the search done before, and after) of each round."""
    if effort.time_limit_s is None:
        for i in range(ROUNDS):
            yield effort.iterations // ROUNDS, i / ROUNDS, (i + 1) / ROUNDS
        return
    began, done, iterations = time.perf_counter(), 0.0, 200
    while done < 1.0:
        before = time.perf_counter()
        ahead = min(1.0, done + 1.0 / ROUNDS)
        yield iterations, done, ahead
        now = time.perf_counter()
        done = (now - began) / effort.time_limit_s
        target_s = min(effort.time_limit_s / ROUNDS, began + effort.time_limit_s - now)
        iterations = max(1, int(iterations * target_s / (now - before)))
