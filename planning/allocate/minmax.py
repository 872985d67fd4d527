"""Min-max allocation: ruin and recreate in several independent chains, the best of which is taken.

An effort in iterations gives the same result on every machine; an effort in seconds is for the command line only.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from planning.allocate.minmax_anneal import anneal
from planning.allocate.minmax_tables import Chain, Tables, Warm, chain_of, sorties_of, tables_of
from planning.allocate.problem import Allocation, Problem, appraise

HOT, COLD = 0.02, 1e-4
"""First and last temperature of a cold search, as shares of the makespan."""
WARM_HOT = 0.002
"""First temperature of every other chain that begins with a plan: these stay near it, the rest may leave it."""
ROUNDS = 40


@dataclass(frozen=True)
class Effort:
    """How long to search. The result depends on `iterations` and `chains`, never on the number of processors."""

    iterations: int | None = None
    """Ruins per chain, 5 to 8 microseconds each; None: 100,000, and 200 for each view."""
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
    began_s = time.perf_counter()
    tables = tables_of(problem, warm)
    chains = [chain_of(tables, seed, number) for number in range(effort.chains)]
    hot = [HOT if warm is None or number % 2 else WARM_HOT for number in range(len(chains))]
    _search(tables, chains, effort, hot, began_s)
    best = min(chains, key=lambda chain: float(chain.cost[1]))
    return appraise(problem, sorties_of(tables, best))


def _search(tables: Tables, chains: list[Chain], effort: Effort, hot: list[float], began_s: float) -> None:
    """All chains side by side on threads (the kernels release the interpreter's lock); each touches its own state."""
    with ThreadPoolExecutor(len(chains)) as pool:
        list(pool.map(lambda chain: _anneal(tables, chain, 0, 1.0, 1.0), chains))
        scale = min(float(chain.cost[2]) for chain in chains)
        if not scale > 0.0:
            return
        for iterations, first, last in _rounds(effort, len(tables.near), began_s):
            begin, end = ([scale * h * (COLD / h) ** share for h in hot] for share in (first, last))
            list(pool.map(lambda chain, b, e, n=iterations: _anneal(tables, chain, n, b, e), chains, begin, end))


def _anneal(tables: Tables, chain: Chain, iterations: int, hot: float, cold: float) -> None:
    anneal(tables.time, tables.energy, tables.near, tables.allowed, tables.remote, tables.prices, tables.free,
           chain.nodes, chain.sorties, chain.finish, chain.best, chain.cost, chain.random, iterations, hot, cold)


def _rounds(effort: Effort, views: int, began_s: float) -> Iterator[tuple[int, float, float]]:
    """(iterations, share of the search done before, and after) of each round."""
    if effort.time_limit_s is None:
        whole = 100_000 + 200 * views if effort.iterations is None else effort.iterations
        for i in range(ROUNDS):
            yield whole // ROUNDS, i / ROUNDS, (i + 1) / ROUNDS
        return
    searching_s = max(0.01, began_s + effort.time_limit_s - time.perf_counter())
    began_s, done, iterations = time.perf_counter(), 0.0, 200
    while done < 1.0:
        before = time.perf_counter()
        ahead = min(1.0, done + 1.0 / ROUNDS)
        yield iterations, done, ahead
        now = time.perf_counter()
        done = (now - began_s) / searching_s
        target_s = min(searching_s / ROUNDS, began_s + searching_s - now)
        iterations = max(1, int(iterations * target_s / (now - before)))
