"""A problem as the arrays that the search works on, and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from planning.allocate.minmax_kernels import Costs, State, Tables, put_in
from planning.allocate.problem import Problem, Sorties, Ways

NEAR = 40
"""Places beside this many nearest views are tried for each view."""
WEIGHTS = {"sum": 0.01, "late": 4.0, "change": 0.0, "blink": 0.01, "last": 0.5, "mean": 10.0, "string": 10.0,
           "absent": 1e6, "far": 1.0, "split": 0.01, "sort": 7.0}


@dataclass(frozen=True)
class Warm:
    """A plan to begin with."""

    sorties: Sorties
    """What every vehicle would fly from where it is now; views that are in none are given out anew."""
    locked: list[int] | None = None
    """(m,) so many first views of each vehicle's first sortie stay its first views, in this order, as long as its
    battery carries them and no leg is missing. None: 0 each."""
    change_s: float = 0.0
    """Seconds of makespan that it must save to take one view away from the vehicle that has it in this plan."""


def tables_of(problem: Problem, warm: Warm | None = None) -> Tables:
    """The arrays of a problem. Costs are rounded to 32 bits: times to the nearest, energies upwards."""
    limits = _sortie_limits(problem)
    owner = np.repeat(np.arange(problem.vehicles), limits).astype(np.int32)
    number = np.concatenate([np.arange(limit) for limit in limits])
    limited = problem.energy is not None
    energy = np.zeros((1, 1, 1), dtype=np.float32)
    if problem.energy is not None:
        energy = np.nextafter(_expanded(problem, problem.energy, owner, number, 0.0), np.float32(np.inf))
    allowed = np.ones((problem.vehicles, problem.views), dtype=np.bool_)
    if problem.forbidden is not None:
        allowed = ~np.asarray(problem.forbidden, dtype=np.bool_)
    weights = WEIGHTS | ({} if warm is None else {"change": warm.change_s})
    return Tables(
        _expanded(problem, problem.seconds, owner, number, problem.swap_s), energy,
        np.array([problem.budget_percent(int(v), int(i)) for v, i in zip(owner, number, strict=True)]),
        _nearest(problem), owner, problem.kinds[owner].astype(np.int32), allowed,
        np.zeros(problem.views, dtype=np.bool_), _wanted(problem, warm), _remoteness(problem), limited, problem.free,
        np.array(list(weights.values())))


def state_of(tables: Tables, warm: Warm | None, seed: int, chain: int) -> State:
    """A chain's state at the start: the warm plan as far as it may be flown, or empty tours. Locks its views."""
    n, sorties, vehicles = len(tables.locked), len(tables.owner), len(tables.allowed)
    ring = np.arange(n + sorties, dtype=np.int32)
    homes = np.arange(n, n + sorties)
    time = tables.time[tables.kind, homes, homes].astype(np.float64)
    used = tables.energy[tables.kind, homes, homes].astype(np.float64) if tables.limited else np.zeros(sorties)
    random = np.random.SeedSequence([seed, chain]).generate_state(1, np.uint64) | np.uint64(1)
    state = State(ring, ring.copy(), np.full(n, -1, dtype=np.int32), np.zeros(sorties, dtype=np.int32), time, used,
                  np.bincount(tables.owner, time, vehicles), np.zeros(1, dtype=np.int32), np.full(3, np.inf),
                  ring.copy(), np.full(n, -1, dtype=np.int32), random)
    if warm is not None:
        _begin_with(tables, state, warm)
    return state


def sorties_of(tables: Tables, state: State, vehicles: int) -> Sorties:
    """The best tours that a chain has found."""
    n = len(tables.locked)
    found: Sorties = [[] for _ in range(vehicles)]
    for number, vehicle in enumerate(tables.owner):
        held = np.flatnonzero(state.best_sortie == number)
        sortie: list[int] = []
        node = -1 if not len(held) else int(held[0] if tables.free else state.best_after[n + number])
        while 0 <= node < n and len(sortie) < len(held):
            sortie.append(node)
            node = int(state.best_after[node])
        found[vehicle].append(sortie)
    return [own[:1] + [sortie for sortie in own[1:] if sortie] for own in found]


def _begin_with(tables: Tables, state: State, warm: Warm) -> None:
    n = len(tables.locked)
    locked = warm.locked or [0] * len(warm.sorties)
    for vehicle, own in enumerate(warm.sorties):
        slots = np.flatnonzero(tables.owner == vehicle)
        for number, (slot, sortie) in enumerate(zip(slots, own, strict=False)):
            for place, view in enumerate(sortie):
                last = -1 if tables.free and not state.size[slot] else (
                    int(state.before[n + slot]) if not tables.free else int(sortie[place - 1]))
                if not _fits(tables, state, view, last, slot):
                    break
                put_in(tables, state, view, last, slot)
                tables.locked[view] = number == 0 and place < locked[vehicle]


def _fits(tables: Tables, state: State, view: int, last: int, slot: int) -> bool:
    """Whether a view can be flown behind the last node of a sortie."""
    k = tables.kind[slot]
    if not tables.allowed[tables.owner[slot], view] or state.sortie[view] >= 0:
        return False
    if last < 0:
        return True
    follower = state.after[last]
    time = tables.time[k, last, view] + tables.time[k, view, follower]
    if not tables.limited:
        return bool(np.isfinite(time))
    added = tables.energy[k, last, view] + tables.energy[k, view, follower] - tables.energy[k, last, follower]
    return bool(np.isfinite(time) and state.used[slot] + added <= tables.budget[slot])


def _sortie_limits(problem: Problem) -> NDArray[np.int64]:
    """A vehicle that cannot even get home gets no fresh battery there."""
    limits = problem.sortie_limits
    if problem.energy is not None and problem.energy.start_to_home is not None:
        stranded = problem.energy.start_to_home > np.asarray(problem.available_percent)
        limits = np.where(stranded, 1, limits)
    return limits


def _expanded(problem: Problem, ways: Ways, owner: NDArray[np.int32], number: NDArray[np.int64], swap: float) -> Costs:
    n, sorties = problem.views, len(owner)
    table = np.zeros((len(ways.between), n + sorties, n + sorties), dtype=np.float32)
    table[:, :n, :n] = ways.between + ways.service
    if problem.free:
        return table
    later = ways.to_home if ways.from_home is None else ways.from_home
    for slot, vehicle in enumerate(owner):
        first = later[vehicle] + swap if number[slot] else ways.from_start[vehicle]
        table[:, n + slot, :n] = first + ways.service
        table[:, :n, n + slot] = ways.to_home[vehicle]
        if ways.start_to_home is not None and number[slot] == 0:
            table[:, n + slot, n + slot] = ways.start_to_home[vehicle]
    return table


def _nearest(problem: Problem) -> NDArray[np.int32]:
    way = problem.seconds.between.min(axis=0)
    both = way + way.T
    np.fill_diagonal(both, np.inf)
    width = min(NEAR, problem.views - 1)
    order = np.argsort(both, axis=1, kind="stable")[:, :width]
    return np.ascontiguousarray(order, dtype=np.int32)


def _wanted(problem: Problem, warm: Warm | None) -> NDArray[np.int32]:
    wanted = np.full(problem.views, -1, dtype=np.int32)
    for vehicle, own in enumerate([] if warm is None else warm.sorties):
        for sortie in own:
            wanted[sortie] = vehicle
    return wanted


def _remoteness(problem: Problem) -> Array:
    """(n,) mean way there and back."""
    if problem.free:
        return np.zeros(problem.views)
    ways = np.where(np.isfinite(problem.seconds.from_start), problem.seconds.from_start, 0.0) + np.where(
        np.isfinite(problem.seconds.to_home), problem.seconds.to_home, 0.0)
    mean: Array = ways.mean(axis=0)
    return mean

