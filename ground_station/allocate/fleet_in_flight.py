"""A fleet that has flown a third of its tours, and what may happen to it then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from planning.allocate.minmax import Effort, solve
from planning.allocate.problem import Problem, Sorties, Ways, appraise

SIDE_M = np.array([60.0, 40.0, 25.0])
PERCENT_PER_M = 0.05
FULL_PERCENT = 80.0
"""What every vehicle may use of its battery until something happens."""


@dataclass(frozen=True)
class FleetInFlight:
    """Views that are not flown yet (n, 3), where its m vehicles are, their pads, plans and batteries."""

    views: Array
    here: Array
    pads: Array
    flying: Sorties
    percent: Array
    forbidden: NDArray[np.bool_]

    @property
    def problem(self) -> Problem:
        """What is left to do."""
        ways = Ways.of_positions(self.views, self.here, self.pads, service=1.0)
        energy = Ways.of_positions(self.views, self.here, self.pads, (PERCENT_PER_M,))
        return Problem(ways, energy=energy, available_percent=self.percent, forbidden=self.forbidden)

    @property
    def owner(self) -> dict[int, int]:
        """Which vehicle's plan each view is in."""
        return {view: k for k, own in enumerate(self.flying) for sortie in own for view in sortie}


def random_places(views: int, seed: int) -> Array:
    """(views, 3) in a box of SIDE_M."""
    return np.asarray(np.random.default_rng(seed).uniform(0.0, 1.0, (views, 3)) * SIDE_M)


def in_flight(places: Array, vehicles: int, effort: Effort, seed: int) -> FleetInFlight:
    """A third of every tour over the places (n, 3) is flown; views are numbered anew."""
    pads = np.random.default_rng(seed).uniform(0.0, 1.0, (vehicles, 3)) * np.ptp(places, axis=0) * [1.0, 1.0, 0.0]
    pads += places.min(axis=0)
    tours = solve(Problem(Ways.of_positions(places, pads, service=1.0)), effort, seed).tours
    left = sorted(view for tour in tours for view in tour[len(tour) // 3:])
    number = {view: n for n, view in enumerate(left)}
    here = np.array([places[tour[len(tour) // 3 - 1]] if len(tour) >= 3 else pad
                     for tour, pad in zip(tours, pads, strict=True)])
    flying = [[[number[view] for view in tour[len(tour) // 3:]]] for tour in tours]
    return FleetInFlight(places[left], here, pads, flying, np.full(vehicles, FULL_PERCENT),
                         np.zeros((vehicles, len(left)), np.bool_))


def without_vehicle(fleet: FleetInFlight, k: int) -> FleetInFlight:
    """Vehicle k is lost, with all that it would have flown."""
    return replace(fleet, here=np.delete(fleet.here, k, axis=0), pads=np.delete(fleet.pads, k, axis=0),
                   flying=fleet.flying[:k] + fleet.flying[k + 1:], percent=np.delete(fleet.percent, k),
                   forbidden=np.delete(fleet.forbidden, k, axis=0))


def with_vehicle(fleet: FleetInFlight) -> FleetInFlight:
    """One more joins, from amid the pads."""
    pad = fleet.pads.mean(axis=0, keepdims=True)
    return replace(fleet, here=np.vstack([fleet.here, pad]), pads=np.vstack([fleet.pads, pad]),
                   flying=[*fleet.flying, [[]]], percent=np.append(fleet.percent, FULL_PERCENT),
                   forbidden=np.vstack([fleet.forbidden, np.zeros((1, len(fleet.views)), np.bool_)]))


def with_views(fleet: FleetInFlight, count: int, seed: int) -> FleetInFlight:
    """So many views more, anywhere among the others."""
    new = np.random.default_rng(seed).uniform(fleet.views.min(axis=0), fleet.views.max(axis=0), (count, 3))
    return replace(fleet, views=np.vstack([fleet.views, new]),
                   forbidden=np.hstack([fleet.forbidden, np.zeros((len(fleet.here), count), np.bool_)]))


def with_blocked_views(fleet: FleetInFlight, k: int) -> FleetInFlight:
    """Vehicle k finds no way to the third and fourth of its next views."""
    forbidden = fleet.forbidden.copy()
    forbidden[k, fleet.flying[k][0][2:4]] = True
    return replace(fleet, forbidden=forbidden)


def with_low_battery(fleet: FleetInFlight, k: int) -> FleetInFlight:
    """The battery of vehicle k lasts for 60 % of what it still has to fly."""
    percent = fleet.percent.copy()
    percent[k] = 0.6 * appraise(fleet.problem, fleet.flying).energy_percent[k][0]
    return replace(fleet, percent=percent)


EVENTS: dict[str, Callable[[FleetInFlight, int], FleetInFlight]] = {
    "nothing": lambda fleet, seed: fleet,
    "low battery": lambda fleet, seed: with_low_battery(fleet, 0),
    "vehicle lost": lambda fleet, seed: without_vehicle(fleet, len(fleet.here) - 1),
    "vehicle joined": lambda fleet, seed: with_vehicle(fleet),
    "new views": lambda fleet, seed: with_views(fleet, max(1, len(fleet.views) // 20), seed),
    "blocked view": lambda fleet, seed: with_blocked_views(fleet, 0)}
"""What happens to a fleet, with a seed for what is random about it."""
