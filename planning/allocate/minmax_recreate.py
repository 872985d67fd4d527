"""Recreate: views are put back one by one, each at its cheapest place, with blinks."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array
from planning.allocate.minmax_state import Costs, Ints, Records, below, uniform

NEVER = math.inf
BLINK = math.log(1.0 - 0.01)
"""This, and how views are ordered for their return, is the paper's (see `minmax_anneal`)."""
LATE = 50.0
"""What a second later than the goal costs, in seconds, when a place is chosen."""


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def draw_pool(random: NDArray[np.uint64], log: Ints, removed: int, waiting: Ints, left: int, tried: int,
              pool: Ints) -> int:
    """The views to put in: those taken out, and some of those that nobody flies; how many."""
    pool[:removed] = log[:removed, 0]
    for i in range(min(left, tried)):
        j = i + below(random, left - i)
        waiting[i], waiting[j] = waiting[j], waiting[i]
        pool[removed + i] = waiting[i]
    return removed + min(left, tried)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def put_in_order(remote: Array, random: NDArray[np.uint64], pool: Ints, keys: Array, count: int) -> None:
    """The order in which views are put back: at random, the remotest first, or the nearest first, as 4 : 2 : 1."""
    dice = 7.0 * uniform(random)
    for i in range(count):
        view = pool[i]
        key = uniform(random) if dice < 4.0 else -remote[view] if dice < 6.0 else remote[view]
        j = i
        while j > 0 and keys[j - 1] > key:
            pool[j], keys[j] = pool[j - 1], keys[j - 1]
            j -= 1
        pool[j], keys[j] = view, key


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def find_places(near: Ints, nodes: Records, sorties: Records, random: NDArray[np.uint64], free: bool,
                view: int, tick: int, places: Ints) -> int:
    """Writes to `places` the nodes that a view may be put behind, beside its nearest views and at both ends of every
    sortie; how many."""
    count = 0
    skip = int(math.log(1.0 - uniform(random)) / BLINK)
    for i in range(near.shape[1]):
        other = near[view, i]
        if nodes[other].sortie < 0:
            continue
        if skip == 0:
            skip = int(math.log(1.0 - uniform(random)) / BLINK)
            continue
        skip -= 1
        p = nodes[other].before
        if nodes[other].tick != tick:
            nodes[other].tick = tick
            places[count] = other
            count += 1
        if nodes[p].tick != tick:
            nodes[p].tick = tick
            places[count] = p
            count += 1
    n = len(nodes) - len(sorties)
    empty = -1
    for s in range(len(sorties)):
        if sorties[s].size == 0:
            if sorties[s].owner == empty:
                continue  # all sorties with a fresh battery are alike
            if s > 0 and sorties[s - 1].owner == sorties[s].owner:
                empty = sorties[s].owner
        elif free:
            continue
        for end in range(2):
            p = n + s if end == 0 else nodes[n + s].before
            if nodes[p].tick != tick:
                nodes[p].tick = tick
                places[count] = p
                count += 1
    return count


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def best_place(time: Costs, energy: Costs, allowed: NDArray[np.bool_], nodes: Records, sorties: Records, finish: Array,
               change: float, view: int, goal: float, places: Ints, count: int) -> int:
    """The node to fly a view behind; -1 when there is none."""
    least, best = NEVER, -1
    wanted = nodes[view].wanted
    for i in range(count):
        p = np.uint64(places[i])  # unsigned: what might be a negative index costs a check, and most time goes here
        s = np.uint64(nodes[p].sortie)
        q, k, vehicle = np.uint64(nodes[p].after), np.uint64(sorties[s].kind), np.uint64(sorties[s].owner)
        if not allowed[vehicle, view] or nodes[q].locked:
            continue
        price = time[k, p, view] + time[k, view, q] - nodes[p].leg
        over = finish[vehicle] + price - goal
        if over > 0.0:
            price += LATE * over
        if wanted >= 0 and wanted != vehicle:
            price += change
        if price >= least:
            continue
        if len(energy):
            added = float(energy[k, p, view]) + float(energy[k, view, q]) - float(energy[k, p, q])
            if not sorties[s].used + added <= sorties[s].budget:
                continue
        least, best = price, int(places[i])
    return best
