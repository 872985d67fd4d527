"""Ruin and recreate for min-max tours: slack induction by string removals (SISR), compiled.

Christiaens & Vanden Berghe, Transportation Science 54(2), 2020, doi 10.1287/trsc.2019.0914: strings of neighbouring
views are cut out of neighbouring sorties and put back greedily, with blinks; simulated annealing decides. Changed here
for the time of the last vehicle: half of the ruins begin in a tour of the vehicle that is home last, and a place that
would make a vehicle later than the best makespan so far costs extra.

Sorties are linked rings of nodes: 0..n-1 are views, n + r is home in sortie r. A free tour's ring leaves its home out.
Kernels take arrays one by one, because every array taken out of a tuple costs two atomic counts.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array

Ints = NDArray[np.int32]
Costs = NDArray[np.float32]
Records = NDArray[Any]

NODE = np.dtype([("after", "i4"), ("before", "i4"), ("sortie", "i4"), ("wanted", "i4"), ("leg", "f8"), ("tick", "i8"),
                 ("locked", "?")], align=True)
"""after, before: in the ring. sortie: -1 when nobody flies it. wanted: the vehicle that it costs to take the view from;
-1: none. leg: seconds to the node after it. tick: of the last search that priced it. locked: stays where it is, with
nothing put before it."""
SORTIE = np.dtype([("owner", "i4"), ("kind", "i4"), ("size", "i4"), ("used", "f8"), ("budget", "f8")], align=True)
"""owner: the vehicle; its sorties follow each other. size: views in it. used, budget: energy in percent."""

NEVER = math.inf
TAKEN_MEAN, STRING_MOST = 10.0, 10.0
SPLIT_SHARE, SPLIT_STOP = 0.5, 0.01
BLINK = math.log(1.0 - 0.01)
"""These, and how views are ordered for their return, are the paper's."""
LAST_SHARE = 0.5
"""Ruins that begin with the vehicle that is home last."""
LATE = 50.0
"""What a second later than the goal costs, in seconds, when a place is chosen."""
SUM_SHARE = 0.001
"""What a second of any vehicle costs, in seconds of makespan."""
LOWER_SHARE, LOWER_MOST = 1.0 / 16.0, 0.1
"""The goal is the best makespan; in some recreations up to this share less, or they would put views back where a slow
vehicle would relieve a fast one at a price."""
TRIED_AGAIN = 10
"""At most this many of the views that nobody flies are tried in one recreation."""


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _uniform(random: NDArray[np.uint64]) -> float:
    """[0, 1) by xorshift64*."""
    x = random[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    random[0] = x
    return float(((x * np.uint64(0x2545F4914F6CDD1D)) >> np.uint64(11)) * (1.0 / 9007199254740992.0))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _below(random: NDArray[np.uint64], bound: float) -> int:
    return int(_uniform(random) * bound)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def take_out(time: Costs, energy: Costs, nodes: Records, sorties: Records, finish: Array, view: int) -> None:
    """Out of the sortie that flies it."""
    s = nodes[view].sortie
    p, q, k = nodes[view].before, nodes[view].after, sorties[s].kind
    nodes[view].sortie = -1
    sorties[s].size -= 1
    vehicle = sorties[s].owner
    if p == view:
        finish[vehicle] -= nodes[view].leg
        return
    leg = float(time[k, p, q])
    finish[vehicle] += leg - nodes[p].leg - nodes[view].leg
    if len(energy):
        sorties[s].used += float(energy[k, p, q]) - float(energy[k, p, view]) - float(energy[k, view, q])
    nodes[p].after, nodes[p].leg = q, leg
    nodes[q].before = p


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def put_in(time: Costs, energy: Costs, nodes: Records, sorties: Records, finish: Array, free: bool, view: int,
           p: int) -> None:
    """Behind node p; behind the home of an empty free tour: alone."""
    s = nodes[p].sortie
    k, vehicle = sorties[s].kind, sorties[s].owner
    nodes[view].sortie = s
    sorties[s].size += 1
    if free and p >= len(nodes) - len(sorties):
        nodes[view].after = nodes[view].before = view
        nodes[view].leg = time[k, view, view]
        finish[vehicle] += nodes[view].leg
        return
    q = nodes[p].after
    to, on = float(time[k, p, view]), float(time[k, view, q])
    finish[vehicle] += to + on - nodes[p].leg
    if len(energy):
        sorties[s].used += float(energy[k, p, view]) + float(energy[k, view, q]) - float(energy[k, p, q])
    nodes[p].after, nodes[p].leg = view, to
    nodes[view].before, nodes[view].after, nodes[view].leg = p, q, on
    nodes[q].before = view


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _places(near: Ints, nodes: Records, sorties: Records, random: NDArray[np.uint64], free: bool,
            view: int, tick: int, places: Ints) -> int:
    """Nodes that a view may be put behind: beside its nearest views, and at both ends of every sortie."""
    count = 0
    skip = int(math.log(1.0 - _uniform(random)) / BLINK)
    for i in range(near.shape[1]):
        other = near[view, i]
        if nodes[other].sortie < 0:
            continue
        if skip == 0:
            skip = int(math.log(1.0 - _uniform(random)) / BLINK)
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
def _best_place(time: Costs, energy: Costs, allowed: NDArray[np.bool_], nodes: Records, sorties: Records, finish: Array,
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


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _cut_string(time: Costs, energy: Costs, nodes: Records, sorties: Records, finish: Array, random: NDArray[np.uint64],
                log: Ints, count: int, view: int, length: int) -> int:
    """Take a string of `length` views that holds `view` out of its sortie; in half of the cases some inside stay."""
    n, s = len(nodes) - len(sorties), nodes[view].sortie
    kept, size = 0, sorties[s].size
    if 1 < length < size and _uniform(random) < SPLIT_SHARE:
        kept = 1
        while length + kept < size and _uniform(random) >= SPLIT_STOP:
            kept += 1
    node = view
    for _ in range(_below(random, length + kept)):
        if nodes[node].before >= n or nodes[nodes[node].before].locked:
            break
        node = nodes[node].before
    until_kept = 1 + _below(random, length - 1)
    for _ in range(length + kept):
        if node >= n or nodes[node].locked or nodes[node].sortie != s:
            break
        follower = nodes[node].after
        if until_kept <= 0 and kept > 0:
            kept -= 1
        else:
            log[count, 0] = node
            log[count, 1] = nodes[node].before if nodes[node].before != node else n + s
            count += 1
            take_out(time, energy, nodes, sorties, finish, node)
        until_kept -= 1
        node = follower
    return count


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _seed_view(nodes: Records, sorties: Records, finish: Array, random: NDArray[np.uint64]) -> int:
    """A view at whose place the ruin begins: in half of the cases one of the vehicle that is home last."""
    n = len(nodes) - len(sorties)
    view = _below(random, n)
    if _uniform(random) < LAST_SHARE:
        last = np.argmax(finish)
        for _ in range(8 * len(finish)):
            if nodes[view].sortie >= 0 and sorties[nodes[view].sortie].owner == last:
                break
            view = _below(random, n)
    return int(view)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _ruin(time: Costs, energy: Costs, near: Ints, nodes: Records, sorties: Records, finish: Array,
          random: NDArray[np.uint64], log: Ints, ruined: NDArray[np.bool_]) -> int:
    """Takes strings of views out of neighbouring sorties; writes (view, node before it) to `log`; how many."""
    flown, flying = 0, 0
    for s in range(len(sorties)):
        flown += sorties[s].size
        flying += sorties[s].size > 0
    longest = min(STRING_MOST, max(1.0, flown / max(1, flying)))
    strings = 1 + _below(random, 4.0 * TAKEN_MEAN / (1.0 + longest) - 1.0)
    seed = _seed_view(nodes, sorties, finish, random)
    ruined[:] = False
    count = 0
    for i in range(-1, near.shape[1]):
        view = seed if i < 0 else near[seed, i]
        s = nodes[view].sortie
        if s < 0 or ruined[s] or nodes[view].locked:
            continue
        length = 1 + _below(random, min(float(sorties[s].size), longest))
        count = _cut_string(time, energy, nodes, sorties, finish, random, log, count, view, length)
        ruined[s] = True
        strings -= 1
        if strings == 0:
            break
    return count


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _order(remote: Array, random: NDArray[np.uint64], pool: Ints, keys: Array, count: int) -> None:
    """The order in which views are put back: at random, the remotest first, or the nearest first, as 4 : 2 : 1."""
    dice = 7.0 * _uniform(random)
    for i in range(count):
        view = pool[i]
        key = _uniform(random) if dice < 4.0 else -remote[view] if dice < 6.0 else remote[view]
        j = i
        while j > 0 and keys[j - 1] > key:
            pool[j], keys[j] = pool[j - 1], keys[j - 1]
            j -= 1
        pool[j], keys[j] = view, key


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


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _draw_pool(random: NDArray[np.uint64], log: Ints, removed: int, waiting: Ints, left: int, tried: int,
               pool: Ints) -> int:
    """The views to put in: those taken out, and some of those that nobody flies; how many."""
    pool[:removed] = log[:removed, 0]
    for i in range(min(left, tried)):
        j = i + _below(random, left - i)
        waiting[i], waiting[j] = waiting[j], waiting[i]
        pool[removed + i] = waiting[i]
    return removed + min(left, tried)


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
            removed = _ruin(time, energy, near, nodes, sorties, finish, random, log, ruined)
            tried = TRIED_AGAIN
        count = _draw_pool(random, log, removed, waiting, left, tried, pool)
        _order(remote, random, pool, keys, count)
        goal = cost[2]
        if _uniform(random) < LOWER_SHARE:
            goal *= 1.0 - LOWER_MOST * _uniform(random)
        back = 0
        for i in range(count):
            tick += 1
            found = _places(near, nodes, sorties, random, free, pool[i], tick, places)
            p = _best_place(time, energy, allowed, nodes, sorties, finish, prices[0], pool[i], goal, places, found)
            if p >= 0:
                put_in(time, energy, nodes, sorties, finish, free, pool[i], p)
                back += 1
        new = _cost(nodes, sorties, finish, prices, left + removed - back)
        threshold = cost[0] - hot * math.log(1.0 - _uniform(random))
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
