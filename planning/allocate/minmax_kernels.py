"""Ruin and recreate for min-max tours: slack induction by string removals (SISR), compiled.

Christiaens & Vanden Berghe, Transportation Science 54(2), 2020, doi 10.1287/trsc.2019.0914: strings of neighbouring
views are cut out of neighbouring tours and put back greedily, with blinks; simulated annealing decides. Changed here
for the time of the last vehicle: every other ruin begins in the tour of the vehicle that is home last, and a place that would make a
vehicle later than the best known makespan costs extra.

Sorties are linked rings: nodes 0..n-1 are views, node n + r is home in sortie r. Free tours have no home node.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array

Ints = NDArray[np.int32]
Costs = NDArray[np.float32]

class Tables(NamedTuple):
    """What stays the same in a search: n views, r sorties, m vehicles, k kinds."""

    time: Costs
    """(k, n + r, n + r) from node to node, service at the second included; home to itself: an empty sortie."""
    energy: Costs
    """The same in percent; (1, 1, 1) when energy does not limit."""
    budget: Array
    """(r,) energy of each sortie."""
    near: Ints
    """(n, w) nearest views of each view, nearest first."""
    owner: Ints
    """(r,) vehicle of each sortie; a vehicle's sorties follow each other."""
    kind: Ints
    """(r,) kind of that vehicle."""
    allowed: NDArray[np.bool_]
    """(m, n)"""
    locked: NDArray[np.bool_]
    """(n,) views that stay where they are, with nothing put before them."""
    wanted: Ints
    """(n,) vehicle from which it costs `change` to take a view away; -1: none."""
    remote: Array
    """(n,) how far off a view is."""
    limited: bool
    """Whether energy limits."""
    free: bool
    """Whether tours have no home."""
    weights: Array
    """params"""


class State(NamedTuple):
    """One chain's tours and its best."""

    after: Ints
    """(n + r,) next node in the ring."""
    before: Ints
    sortie: Ints
    """(n,) sortie of each view; -1 when nobody flies it."""
    size: Ints
    """(r,) views in each sortie."""
    time: Array
    """(r,)"""
    used: Array
    """(r,) energy"""
    finish: Array
    """(m,)"""
    moved: Ints
    """(1,) views that are not with the vehicle that wanted them."""
    cost: Array
    """(3,) cost now; least cost; penalty-free makespan of the best."""
    best_after: Ints
    best_sortie: Ints
    random: NDArray[np.uint64]
    """(1,) state of xorshift64*."""


@njit(cache=True, nogil=True, inline="always")
def _uniform(random):
    x = random[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    random[0] = x
    return ((x * np.uint64(0x2545F4914F6CDD1D)) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(cache=True, nogil=True, inline="always")
def _below(random, bound):
    return int(_uniform(random) * bound)


@njit(cache=True, nogil=True)
def _take_out(tables, state, view):
    s = state.sortie[view]
    p, q, k = state.before[view], state.after[view], tables.kind[s]
    if p == view:
        gain = -float(tables.time[k, view, view])
    else:
        gain = float(tables.time[k, p, q]) - float(tables.time[k, p, view]) - float(tables.time[k, view, q])
        state.after[p] = q
        state.before[q] = p
        if tables.limited:
            state.used[s] += (float(tables.energy[k, p, q]) - float(tables.energy[k, p, view])
                              - float(tables.energy[k, view, q]))
    state.time[s] += gain
    state.finish[tables.owner[s]] += gain
    state.size[s] -= 1
    state.sortie[view] = -1
    if tables.wanted[view] >= 0 and tables.wanted[view] != tables.owner[s]:
        state.moved[0] -= 1


@njit(cache=True, nogil=True)
def put_in(tables, state, view, p, s):
    """Behind node p of sortie s; p = -1: alone in an empty free tour."""
    k = tables.kind[s]
    if p < 0:
        state.after[view] = state.before[view] = view
        added = float(tables.time[k, view, view])
    else:
        q = state.after[p]
        added = float(tables.time[k, p, view]) + float(tables.time[k, view, q]) - float(tables.time[k, p, q])
        state.after[p] = view
        state.before[view] = p
        state.after[view] = q
        state.before[q] = view
        if tables.limited:
            state.used[s] += (float(tables.energy[k, p, view]) + float(tables.energy[k, view, q])
                              - float(tables.energy[k, p, q]))
    state.time[s] += added
    state.finish[tables.owner[s]] += added
    state.size[s] += 1
    state.sortie[view] = s
    if tables.wanted[view] >= 0 and tables.wanted[view] != tables.owner[s]:
        state.moved[0] += 1


@njit(cache=True, nogil=True)
def _best_place(tables, state, view, goal):
    """(node to fly it behind, sortie); sortie -1 when there is no place."""
    n = len(tables.locked)
    time, energy, limited, budget, weights = tables.time, tables.energy, tables.limited, tables.budget, tables.weights
    near, owner, kind, allowed, locked = tables.near[view], tables.owner, tables.kind, tables.allowed, tables.locked
    after, before, sortie, used, finish, size = state.after, state.before, state.sortie, state.used, state.finish, state.size
    random = state.random
    least, place, where = np.inf, np.int64(-1), np.int64(-1)
    blink, late = weights[3], weights[1]
    wanted = tables.wanted[view]
    for i in range(len(near)):
        other = near[i]
        s = sortie[other]
        if s < 0 or _uniform(random) < blink:
            continue
        vehicle = owner[s]
        if not allowed[vehicle, view]:
            continue
        k = kind[s]
        penalty = weights[2] if wanted >= 0 and wanted != vehicle else 0.0
        to, back = time[k, other, view], time[k, view, other]
        p, q = before[other], after[other]
        if q >= n or not locked[q]:
            added = to + time[k, view, q] - time[k, other, q]
            if not (limited and used[s] + energy[k, other, view] + energy[k, view, q] - energy[k, other, q] > budget[s]):
                price = added + late * max(0.0, finish[vehicle] + added - goal) + penalty
                if price < least:
                    least, place, where = price, other, s
        if not locked[other]:
            added = time[k, p, view] + back - time[k, p, other]
            if not (limited and used[s] + energy[k, p, view] + energy[k, view, other] - energy[k, p, other] > budget[s]):
                price = added + late * max(0.0, finish[vehicle] + added - goal) + penalty
                if price < least:
                    least, place, where = price, p, s
    last_empty = -1
    for s in range(len(owner)):
        vehicle, k = owner[s], kind[s]
        if size[s] == 0:
            if vehicle == last_empty:
                continue
            last_empty = vehicle
        if not allowed[vehicle, view]:
            continue
        penalty = weights[2] if wanted >= 0 and wanted != vehicle else 0.0
        if tables.free:
            if size[s] > 0:
                continue
            alone = time[k, view, view]
            price = alone + late * max(0.0, alone - goal) + penalty
            if price < least:
                least, place, where = price, -1, s
            continue
        for side in range(2):
            p = np.int32(n + s) if side == 0 else before[n + s]
            q = after[p]
            if q < n and locked[q]:
                continue
            added = time[k, p, view] + time[k, view, q] - time[k, p, q]
            if limited and used[s] + energy[k, p, view] + energy[k, view, q] - energy[k, p, q] > budget[s]:
                continue
            price = added + late * max(0.0, finish[vehicle] + added - goal) + penalty
            if price < least:
                least, place, where = price, p, s
    return place, where


@njit(cache=True, nogil=True)
def _seed_view(tables, state):
    """A view at whose place the ruin begins: every other time one of the vehicle that is home last."""
    n = len(tables.locked)
    view = _below(state.random, n)
    if _uniform(state.random) < tables.weights[4]:
        last = np.argmax(state.finish)
        for _ in range(8 * len(state.finish)):
            if state.sortie[view] >= 0 and tables.owner[state.sortie[view]] == last:
                break
            view = _below(state.random, n)
    return view


@njit(cache=True, nogil=True)
def _cut_string(tables, state, view, length, gone, count, log):
    """Take a string of `length` views that holds `view` out of its sortie; now and then views inside it stay."""
    n = len(tables.locked)
    s = state.sortie[view]
    kept = 0
    if length < state.size[s] and length > 1 and _uniform(state.random) < 0.5:
        kept = 1
        while length + kept < state.size[s] and _uniform(state.random) >= tables.weights[9]:
            kept += 1
    node = view
    for _ in range(_below(state.random, length + kept)):
        if state.before[node] >= n or tables.locked[state.before[node]]:
            break
        node = state.before[node]
    kept_from = 1 + _below(state.random, length - 1) if kept else length + 1
    cut = 0
    passed = 0
    while cut < length and state.size[s] > 0 and node < n and not tables.locked[node]:
        follower = state.after[node]
        if passed >= kept_from and kept > 0:
            kept -= 1
        else:
            log[count, 0], log[count, 1], log[count, 2] = node, state.before[node], s
            if state.before[node] == node:
                log[count, 1] = -1
            gone[count] = node
            count += 1
            cut += 1
            _take_out(tables, state, node)
        passed += 1
        node = follower
    return count


@njit(cache=True, nogil=True)
def _ruin(tables, state, gone, log, ruined):
    """Views taken out, into `gone`; their number."""
    mean = max(1.0, state.size.sum() / max(1, (state.size > 0).sum()))
    longest = min(tables.weights[6], mean)
    strings = 1 + _below(state.random, 4.0 * tables.weights[5] / (1.0 + longest) - 1.0)
    seed = _seed_view(tables, state)
    ruined[:] = False
    count = 0
    for i in range(-1, tables.near.shape[1]):
        view = seed if i < 0 else tables.near[seed, i]
        s = state.sortie[view]
        if s < 0 or ruined[s] or tables.locked[view]:
            continue
        length = 1 + _below(state.random, min(state.size[s], longest))
        count = _cut_string(tables, state, view, length, gone, count, log)
        ruined[s] = True
        strings -= 1
        if strings == 0:
            break
    return count


@njit(cache=True, nogil=True)
def _sort_for_return(tables, state, gone, count):
    dice = _uniform(state.random) * tables.weights[10]
    keys = np.empty(count)
    for i in range(count):
        keys[i] = _uniform(state.random) if dice < 4.0 else -tables.remote[gone[i]] if dice < 6.0 else tables.remote[gone[i]]
    gone[:count] = gone[:count][np.argsort(keys)]


@njit(cache=True, nogil=True)
def _cost(tables, state, absent):
    return (state.finish.max() + tables.weights[0] * state.finish.sum() + tables.weights[2] * state.moved[0]
            + tables.weights[7] * absent)


@njit(cache=True, nogil=True)
def anneal(tables, state, iterations, hot, cold):
    """Ruin and recreate `iterations` times while the temperature falls from hot to cold; the best stays in `state`."""
    n, r = len(tables.locked), len(tables.owner)
    absent = np.flatnonzero(state.sortie < 0).astype(np.int32)
    if len(absent):
        for i in np.argsort(-tables.remote[absent]) if tables.weights[8] > 0 else np.arange(len(absent)):
            p, s = _best_place(tables, state, absent[i], state.cost[1])
            if s >= 0:
                put_in(tables, state, absent[i], p, s)
    waiting = np.empty(n, dtype=np.int32)
    missing = 0
    for v in range(n):
        if state.sortie[v] < 0:
            waiting[missing] = v
            missing += 1
    state.cost[0] = _cost(tables, state, missing)
    if state.cost[0] < state.cost[1]:
        _keep(state, missing)
    gone, log, ruined = np.empty(n + 16, dtype=np.int32), np.empty((n + 16, 3), dtype=np.int32), np.zeros(r, dtype=np.bool_)
    time, used, finish, moved = state.time.copy(), state.used.copy(), state.finish.copy(), 0
    cooling = (cold / hot) ** (1.0 / max(1, iterations))
    heat = hot
    for _ in range(iterations):
        heat *= cooling
        time[:], used[:], finish[:], moved = state.time, state.used, state.finish, state.moved[0]
        removed = _ruin(tables, state, gone, log, ruined)
        pool = removed
        for _ in range(min(missing, 10)):
            view = waiting[_below(state.random, missing)]
            for i in range(removed, pool):
                if gone[i] == view:
                    break
            else:
                gone[pool] = view
                pool += 1
        _sort_for_return(tables, state, gone, pool)
        back = 0
        for i in range(pool):
            p, s = _best_place(tables, state, gone[i], state.cost[2])
            if s >= 0:
                put_in(tables, state, gone[i], p, s)
                back += 1
        cost = _cost(tables, state, missing + removed - back)
        if cost >= state.cost[0] - heat * np.log(1.0 - _uniform(state.random)):
            for i in range(pool - 1, -1, -1):
                if state.sortie[gone[i]] >= 0:
                    _take_out(tables, state, gone[i])
            for i in range(removed - 1, -1, -1):
                put_in(tables, state, log[i, 0], log[i, 1], log[i, 2])
            state.time[:], state.used[:], state.finish[:], state.moved[0] = time, used, finish, moved
            continue
        state.cost[0] = cost
        if missing + removed - back:
            kept = 0
            for i in range(missing):
                if state.sortie[waiting[i]] < 0:
                    waiting[kept] = waiting[i]
                    kept += 1
            for i in range(pool):
                if state.sortie[gone[i]] < 0:
                    known = False
                    for j in range(kept):
                        known = known or waiting[j] == gone[i]
                    if not known:
                        waiting[kept] = gone[i]
                        kept += 1
            missing = kept
        else:
            missing = 0
        if cost < state.cost[1]:
            state.cost[1] = cost
            state.cost[2] = state.finish.max()
            state.best_after[:] = state.after
            state.best_sortie[:] = state.sortie
    return missing


@njit(cache=True, nogil=True)
def _keep(state, missing):
    state.cost[1] = state.cost[0]
    state.cost[2] = state.finish.max()
    state.best_after[:] = state.after
    state.best_sortie[:] = state.sortie
