"""What is to be allocated, and what an allocation is worth.

Every vehicle flies sorties: from where it is over some views and home; from home again with a fresh battery, if it may.
All are done when the last vehicle is home for good: that time is what counts first (min-max), the sum of all second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array

Sorties = list[list[list[int]]]
"""Per vehicle its sorties, per sortie its views (indices 0..n-1) in the order of flight."""


@dataclass(frozen=True)
class Ways:
    """What legs cost in one currency (seconds, or percent of a battery); inf where there is no way.

    n views, m vehicles, k kinds of vehicle. Costs need not be symmetric (climb, wind).
    """

    between: Array
    """(k, n, n) from view to view, by kind of vehicle."""
    from_start: Array
    """(m, n) from where each vehicle is now to each view."""
    to_home: Array
    """(m, n) from each view to each vehicle's home."""
    service: Array
    """(n,) at each view: slow-down, settle, shutter."""
    from_home: Array | None = None
    """(m, n) from each vehicle's home to each view, for later sorties; None: as the way to home."""
    start_to_home: Array | None = None
    """(m,) from where each vehicle is straight home, when it flies nothing; None: 0, it is at home."""

    @staticmethod
    def of_positions(positions_enu_m: Array, starts_enu_m: Array, homes_enu_m: Array | None = None,
                     per_metre: Sequence[float] = (1.0,), kind: Sequence[int] | None = None,
                     service: float = 0.0) -> Ways:
        """Straight legs between positions (n, 3), from starts (m, 3) to homes (m, 3; None: the starts), at a price
        per metre for each kind of vehicle; kind: (m,) which kind each vehicle is of, None: all of kind 0."""
        views = np.asarray(positions_enu_m, dtype=np.float64)
        starts = np.asarray(starts_enu_m, dtype=np.float64)
        homes = starts if homes_enu_m is None else np.asarray(homes_enu_m, dtype=np.float64)
        price = np.asarray(per_metre, dtype=np.float64)
        own = price[np.zeros(len(starts), dtype=np.int64) if kind is None else np.asarray(kind)]
        home = own[:, None] * _lengths(homes, views)
        return Ways(price[:, None, None] * _lengths(views, views), own[:, None] * _lengths(starts, views), home,
                    np.full(len(views), service), home, own * np.linalg.norm(starts - homes, axis=1))


@dataclass(frozen=True)
class Problem:
    """n views for m vehicles. Raises ValueError when the shapes do not fit."""

    seconds: Ways
    kind: NDArray[np.int64] | None = None
    """(m,) which of the k matrices holds for each vehicle; None: kind 0 for all."""
    energy: Ways | None = None
    """The same legs in percent of a battery; None: energy does not limit anybody."""
    available_percent: Array | None = None
    """(m,) what each vehicle may use of its present battery, the reserve left out."""
    swapped_percent: Array | None = None
    """(m,) what it may use of a fresh one."""
    swap_s: float = 0.0
    """A change of battery at home."""
    max_sorties: NDArray[np.int64] | None = None
    """(m,) sorties that each vehicle may fly, the present one included; None: one each."""
    forbidden: NDArray[np.bool_] | None = None
    """(m, n) views that a vehicle must not be given."""
    free: bool = False
    """Tours without start and home: every vehicle's is a closed loop through its own views (start and home ways are
    not looked at). One sortie each, no energy."""

    def __post_init__(self) -> None:
        m, n = self.vehicles, self.views
        wanted = {"seconds.between": (self.seconds.between, (len(self.seconds.between), n, n)),
                  "seconds.to_home": (self.seconds.to_home, (m, n)), "seconds.service": (self.seconds.service, (n,)),
                  "seconds.from_home": (self.seconds.from_home, (m, n)), "forbidden": (self.forbidden, (m, n)),
                  "kind": (self.kind, (m,)), "max_sorties": (self.max_sorties, (m,)),
                  "available_percent": (self.available_percent, (m,)),
                  "swapped_percent": (self.swapped_percent, (m,))}
        for name, (array, shape) in wanted.items():
            if array is not None and np.shape(array) != shape:
                raise ValueError(f"{name} has shape {np.shape(array)}, not {shape}")
        if self.energy is not None and (self.available_percent is None or self.free):
            raise ValueError("energy needs available_percent, and tours with start and home")

    @property
    def views(self) -> int:
        """n"""
        return int(self.seconds.from_start.shape[1])

    @property
    def vehicles(self) -> int:
        """m"""
        return int(self.seconds.from_start.shape[0])

    @cached_property
    def kinds(self) -> NDArray[np.int64]:
        """(m,) kind of each vehicle."""
        return np.zeros(self.vehicles, dtype=np.int64) if self.kind is None else np.asarray(self.kind, dtype=np.int64)

    @cached_property
    def sortie_limits(self) -> NDArray[np.int64]:
        """(m,) sorties that each vehicle may fly."""
        if self.max_sorties is None or self.free:
            return np.ones(self.vehicles, dtype=np.int64)
        return np.asarray(self.max_sorties, dtype=np.int64)

    def budget_percent(self, vehicle: int, sortie: int) -> float:
        """What a vehicle may use on its sortie number `sortie`, counted from 0 for the present battery."""
        if self.energy is None or self.available_percent is None:
            return float("inf")
        fresh = self.available_percent if self.swapped_percent is None else self.swapped_percent
        return float((fresh if sortie else self.available_percent)[vehicle])


@dataclass(frozen=True)
class Allocation:
    """Who flies which views in which order. Every view is in exactly one sortie or left over."""

    sorties: Sorties
    """Per vehicle, sortie 0 with the present battery and the others after a change of battery each. When sortie 0 is
    empty and others are not, the vehicle first goes home for a fresh battery."""
    left_over: list[int]
    """Views that nobody can fly: forbidden, without a way, or beyond every battery. Rising."""
    finish_s: Array
    """(m,) when each vehicle is home for good."""
    energy_percent: list[list[float]]
    """What each sortie uses; zeros when the problem has no energy."""

    @property
    def makespan_s(self) -> float:
        """When the last vehicle is home."""
        return float(self.finish_s.max(initial=0.0))

    @property
    def tours(self) -> list[list[int]]:
        """Per vehicle all its views in the order of flight."""
        return [[view for sortie in sorties for view in sortie] for sorties in self.sorties]


def appraise(problem: Problem, sorties: Sorties) -> Allocation:
    """The allocation that flies these sorties, with its times and energies in full precision; what no sortie holds is
    left over. Checks nothing: see `violations`."""
    finish = np.zeros(problem.vehicles)
    energy: list[list[float]] = []
    for vehicle, own in enumerate(sorties):
        finish[vehicle] = _vehicle_cost(problem, problem.seconds, vehicle, own, problem.swap_s)
        energy.append([0.0 if problem.energy is None else
                       sortie_cost(problem, problem.energy, vehicle, number, sortie)
                       for number, sortie in enumerate(own)])
    held = {view for own in sorties for sortie in own for view in sortie}
    return Allocation(sorties, [view for view in range(problem.views) if view not in held], finish, energy)


def sortie_cost(problem: Problem, ways: Ways, vehicle: int, number: int, sortie: Sequence[int]) -> float:
    """What one sortie costs in the currency of `ways`, from where it begins until home."""
    if not sortie:
        return 0.0 if number or ways.start_to_home is None or problem.free else float(ways.start_to_home[vehicle])
    views = list(sortie)
    between = ways.between[problem.kinds[vehicle]]
    inner = float(between[views[:-1], views[1:]].sum() + ways.service[views].sum())
    if problem.free:
        return inner + (float(between[views[-1], views[0]]) if len(views) > 1 else 0.0)
    later = ways.to_home if ways.from_home is None else ways.from_home
    return inner + float((later if number else ways.from_start)[vehicle, views[0]] + ways.to_home[vehicle, views[-1]])


def violations(problem: Problem, allocation: Allocation, tolerance: float = 1e-6) -> list[str]:
    """What is wrong with an allocation, in words; empty when it may be flown."""
    flat = sorted([view for tour in allocation.tours for view in tour] + allocation.left_over)
    found = [] if flat == list(range(problem.views)) else ["a view is lost or held twice"]
    for vehicle, own in enumerate(allocation.sorties):
        if len(own) > problem.sortie_limits[vehicle]:
            found.append(f"vehicle {vehicle} flies {len(own)} sorties")
        if problem.forbidden is not None and any(problem.forbidden[vehicle, view] for s in own for view in s):
            found.append(f"vehicle {vehicle} flies a view that it must not")
        for number, used in enumerate(allocation.energy_percent[vehicle]):
            if own[number] and used > problem.budget_percent(vehicle, number) + tolerance:
                found.append(f"sortie {number} of vehicle {vehicle} uses {used:.3f} %")
    if not np.isfinite(allocation.finish_s).all():
        found.append("a leg has no way")
    return found


def _vehicle_cost(problem: Problem, ways: Ways, vehicle: int, own: list[list[int]], swap: float) -> float:
    legs = sum(sortie_cost(problem, ways, vehicle, number, sortie) for number, sortie in enumerate(own))
    return float(legs + swap * sum(1 for sortie in own[1:] if sortie))


def _lengths(a: Array, b: Array) -> Array:
    if a.shape[-1] > 3:
        raise ValueError("positions have at most three coordinates")
    gap = np.zeros((len(a), len(b)))
    for axis in range(a.shape[-1]):
        gap += np.square(a[:, None, axis] - b[None, :, axis])
    length: Array = np.sqrt(gap)
    return length
