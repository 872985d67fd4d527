"""A problem as the arrays that the search works on, and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from planning.allocate.minmax_state import NODE, SORTIE, Costs, Ints, Records, put_in
from planning.allocate.problem import Problem, Sorties, Ways

NEAR = 40
"""Places beside this many nearest views are tried for each view."""
NOBODY = 1e3
"""What a view that nobody flies costs, in longest legs: more than any detour."""


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


@dataclass(frozen=True)
class Tables:
    """What the chains of a search share; see `minmax_anneal.anneal`."""

    time: Costs
    energy: Costs
    near: Ints
    allowed: NDArray[np.bool_]
    remote: Array
    prices: Array
    free: bool
    nodes: Records
    """The first state."""
    sorties: Records
    finish: Array


@dataclass(frozen=True)
class Chain:
    """One search's tours, the best of them, its costs and its random numbers."""

    nodes: Records
    sorties: Records
    finish: Array
    best: Records
    cost: Array
    random: NDArray[np.uint64]


def tables_of(problem: Problem, warm: Warm | None = None) -> Tables:
    """The arrays of a problem. Costs are rounded to 32 bits: times to the nearest, energies upwards."""
    limits = _sortie_limits(problem)
    owner = np.repeat(np.arange(problem.vehicles), limits)
    number = np.concatenate([np.arange(limit) for limit in limits])
    energy = np.zeros((0, 1, 1), dtype=np.float32)
    if problem.energy is not None:
        energy = np.nextafter(_expanded(problem, problem.energy, owner, number, 0.0), np.float32(np.inf))
    allowed = np.ones((problem.vehicles, problem.views), dtype=np.bool_)
    if problem.forbidden is not None:
        allowed = ~np.asarray(problem.forbidden, dtype=np.bool_)
    time = _expanded(problem, problem.seconds, owner, number, problem.swap_s)
    longest = float(time[np.isfinite(time)].max())
    prices = np.array([0.0 if warm is None else warm.change_s, NOBODY * max(longest, 1e-9)])
    nodes, sorties, finish = _empty(problem, time, energy, owner, number)
    tables = Tables(time, energy, _nearest(problem), allowed, _remoteness(problem), prices, problem.free,
                    nodes, sorties, finish)
    if warm is not None:
        _begin_with(tables, warm)
    return tables


def chain_of(tables: Tables, seed: int, number: int) -> Chain:
    """A chain at the start of its search."""
    random = np.random.SeedSequence([seed, number]).generate_state(1, np.uint64) | np.uint64(1)
    return Chain(tables.nodes.copy(), tables.sorties.copy(), tables.finish.copy(), tables.nodes.copy(),
                 np.full(3, np.inf), random)


def sorties_of(tables: Tables, chain: Chain) -> Sorties:
    """The best tours that a chain has found."""
    n = len(tables.near)
    found: Sorties = [[] for _ in tables.allowed]
    for number, vehicle in enumerate(tables.sorties["owner"]):
        held = np.flatnonzero(chain.best["sortie"][:n] == number)
        node = -1 if not len(held) else int(held[0] if tables.free else chain.best["after"][n + number])
        sortie: list[int] = []
        while len(sortie) < len(held):
            sortie.append(node)
            node = int(chain.best["after"][node])
        found[vehicle].append(sortie)
    return [own[:1] + [sortie for sortie in own[1:] if sortie] for own in found]


def _empty(problem: Problem, time: Costs, energy: Costs, owner: NDArray[np.int64],
           number: NDArray[np.int64]) -> tuple[Records, Records, Array]:
    n, r = problem.views, len(owner)
    nodes, sorties = np.zeros(n + r, dtype=NODE), np.zeros(r, dtype=SORTIE)
    homes = np.arange(n, n + r)
    sorties["owner"], sorties["kind"] = owner, problem.kinds[owner]
    sorties["budget"] = [problem.budget_percent(int(v), int(i)) for v, i in zip(owner, number, strict=True)]
    if len(energy):
        sorties["used"] = energy[sorties["kind"], homes, homes]
    nodes["after"] = nodes["before"] = np.arange(n + r)
    nodes["sortie"], nodes["wanted"] = -1, -1
    nodes["sortie"][n:] = np.arange(r)
    nodes["leg"][n:] = time[sorties["kind"], homes, homes]
    return nodes, sorties, np.bincount(owner, nodes["leg"][n:], problem.vehicles).astype(np.float64)


def _begin_with(tables: Tables, warm: Warm) -> None:
    """The first state flies a plan, as far as it may be flown, and locks its first views."""
    n = len(tables.near)
    locked = warm.locked or [0] * len(warm.sorties)
    for vehicle, own in enumerate(warm.sorties):
        slots = np.flatnonzero(tables.sorties["owner"] == vehicle)
        for number, (slot, sortie) in enumerate(zip(slots, own, strict=False)):
            last = int(n + slot)
            for place, view in enumerate(sortie):
                if not _fits(tables, view, last):
                    break
                put_in(tables.time, tables.energy, tables.nodes, tables.sorties, tables.finish, tables.free, view, last)
                tables.nodes["locked"][view] = number == 0 and place < locked[vehicle]
                last = view
        for sortie in own:
            tables.nodes["wanted"][sortie] = vehicle


def _fits(tables: Tables, view: int, last: int) -> bool:
    """Whether a view can be flown behind the last node of a sortie."""
    sortie = tables.sorties[tables.nodes["sortie"][last]]
    k, follower = sortie["kind"], tables.nodes["after"][last]
    if not tables.allowed[sortie["owner"], view] or tables.nodes["sortie"][view] >= 0:
        return False
    if not np.isfinite(tables.time[k, last, view] + tables.time[k, view, follower]):
        return False
    if not len(tables.energy):
        return True
    added = (float(tables.energy[k, last, view]) + float(tables.energy[k, view, follower])
             - float(tables.energy[k, last, follower]))
    return bool(sortie["used"] + added <= sortie["budget"])


def _sortie_limits(problem: Problem) -> NDArray[np.int64]:
    """No more sorties than views; and a vehicle that cannot even get home gets no fresh battery there."""
    limits = np.minimum(problem.sortie_limits, problem.views + 1)
    if problem.energy is not None and problem.energy.start_to_home is not None:
        stranded = problem.energy.start_to_home > np.asarray(problem.available_percent)
        limits = np.where(stranded, 1, limits)
    return limits


def _expanded(problem: Problem, ways: Ways, owner: NDArray[np.int64], number: NDArray[np.int64], swap: float) -> Costs:
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


def _nearest(problem: Problem) -> Ints:
    way = problem.seconds.between.min(axis=0)
    both = way + way.T
    np.fill_diagonal(both, np.inf)
    width = min(NEAR, problem.views - 1)
    near = np.argpartition(both, max(0, width - 1), axis=1)[:, :width]
    order = np.argsort(np.take_along_axis(both, near, axis=1), axis=1, kind="stable")
    return np.take_along_axis(near, order, axis=1).astype(np.int32)


def _remoteness(problem: Problem) -> Array:
    """(n,) mean way there and back."""
    if problem.free:
        return np.zeros(problem.views)
    ways = np.where(np.isfinite(problem.seconds.from_start), problem.seconds.from_start, 0.0) + np.where(
        np.isfinite(problem.seconds.to_home), problem.seconds.to_home, 0.0)
    mean: Array = ways.mean(axis=0)
    return mean

