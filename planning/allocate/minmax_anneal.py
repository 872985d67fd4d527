"""Ruin and recreate for min-max tours: slack induction by string removals (SISR), compiled.

Christiaens & Vanden Berghe, Transportation Science 54(2), 2020, doi 10.1287/trsc.2019.0914: strings of neighbouring
views are cut out of neighbouring sorties and put back greedily, with blinks; simulated annealing decides. Changed here
for the time of the last vehicle: half of the ruins begin in a tour of the vehicle that is home last, and a place that
would make a vehicle later than the best makespan so far costs extra.

Kernels take arrays one by one, because every array taken out of a tuple costs two atomic counts.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array
from planning.allocate.minmax_recreate import best_place, draw_pool, find_places, put_in_order
from planning.allocate.minmax_ruin import ruin
from planning.allocate.minmax_state import Costs, Ints, Records, put_in, take_out, uniform

SUM_SHARE = 0.001
"""What a second of any vehicle costs, in seconds of makespan."""
LOWER_SHARE, LOWER_MOST = 1.0 / 16.0, 0.1
"""The goal is the best makespan; in some recreations up to this share less, or they would put views back where a slow
vehicle would relieve a fast one at a price."""
TRIED_AGAIN = 10
"""At most this many of the views that nobody flies are tried in one recreation."""


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def anneal(time: Costs, energy: Costs, near: Ints, allowed: NDArray[np.bool_], remote: Array, prices: Array,
           free: bool, nodes: Records, sorties: Records, finish: Array, best: Records, cost: Array,
           random: NDArray[np.uint64], iterations: int, hot: float, cold: float) -> None:
    """Ruin and recreate while the temperature falls from hot to cold.

    time: (k, n + r, n + r) from node to node; energy likewise, or (0, 1, 1) when it does not limit. near: (n, w).
    allowed: (m, n). remote: (n,). prices: (2,) of a view that changes hands, and of one that nobody flies.
    nodes: (n + r,), sorties: (r,), finish: (m,) the tours now, changed in place; best: (n + r,) the nodes of the best.
    cost: (3,) of the tours now and of the best, and the makespan of the best.
    """
    n, r = len(nodes) - len(sorties), len(sorties)
    log, ruined = np.empty((n + 1, 2), dtype=np.int32), np.zeros(r, dtype=np.bool_)
    pool, keys, waiting = np.empty(n + 1, dtype=np.int32), np.empty(n + 1), np.empty(2 * n, dtype=np.int32)
    places = np.empty(2 * near.shape[1] + 2 * r, dtype=np.int32)
    tick = nodes["tick"].max()
    for view in range(n):
        waiting[view] = view
    left = _still_waiting(nodes, waiting, n, log, 0)
    saved_sorties, saved_finish = sorties.copy(), finish.copy()
    cooling = (cold / hot) ** (1.0 / max(1, iterations))
    for iteration in range(-1, iterations):
        saved_sorties[:] = sorties
        saved_finish[:] = finish
        removed, tried = 0, n
        if iteration >= 0:
            removed = ruin(time, energy, near, nodes, sorties, finish, random, log, ruined)
            tried = TRIED_AGAIN
        count = draw_pool(random, log, removed, waiting, left, tried, pool)
        put_in_order(remote, random, pool, keys, count)
        goal = cost[2]
        if uniform(random) < LOWER_SHARE:
            goal *= 1.0 - LOWER_MOST * uniform(random)
        back = 0
        for i in range(count):
            tick += 1
            found = find_places(near, nodes, sorties, random, free, pool[i], tick, places)
            p = best_place(time, energy, allowed, nodes, sorties, finish, prices[0], pool[i], goal, places, found)
            if p >= 0:
                put_in(time, energy, nodes, sorties, finish, free, pool[i], p)
                back += 1
        new = _cost(nodes, sorties, finish, prices, left + removed - back)
        threshold = cost[0] - hot * math.log(1.0 - uniform(random))
        hot *= cooling
        if iteration >= 0 and new >= threshold:
            _undo(time, energy, nodes, sorties, finish, free, pool, count, log, removed)
            sorties[:] = saved_sorties
            finish[:] = saved_finish
            continue
        cost[0] = new
        if left or back < removed:
            left = _still_waiting(nodes, waiting, left, log, removed)
        if new < cost[1]:
            cost[1] = new
            cost[2] = finish.max()
            best[:] = nodes


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _cost(nodes: Records, sorties: Records, finish: Array, prices: Array, waiting: int) -> float:
    moved = 0
    if prices[0] > 0.0:
        for view in range(len(nodes) - len(sorties)):
            wanted, s = nodes[view].wanted, nodes[view].sortie
            moved += wanted >= 0 and s >= 0 and sorties[s].owner != wanted
    return float(finish.max() + SUM_SHARE * finish.sum() + prices[0] * moved + prices[1] * waiting)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _undo(time: Costs, energy: Costs, nodes: Records, sorties: Records, finish: Array, free: bool, pool: Ints,
          count: int, log: Ints, removed: int) -> None:
    """Out with what was put in, and back with what was taken out, the last first."""
    for i in range(count):
        if nodes[pool[i]].sortie >= 0:
            take_out(time, energy, nodes, sorties, finish, pool[i])
    for i in range(removed - 1, -1, -1):
        put_in(time, energy, nodes, sorties, finish, free, log[i, 0], log[i, 1])


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _still_waiting(nodes: Records, waiting: Ints, left: int, log: Ints, removed: int) -> int:
    """Keeps in `waiting` what nobody flies; how many."""
    kept = 0
    for i in range(left + removed):
        view = waiting[i] if i < left else log[i - left, 0]
        if nodes[view].sortie < 0:
            waiting[kept] = view
            kept += 1
    return kept
