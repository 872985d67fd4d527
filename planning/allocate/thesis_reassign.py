"""Handing a vehicle's remaining views to the others (thesis section 4.4.6), ids of origin kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array


@dataclass(frozen=True)
class Receiver:
    """A vehicle that can take views over, with its own remaining tour."""

    vehicle_id: int
    tour: Sequence[int]
    """View indices still to fly, in order."""
    flown_views: int
    from_here_m: Array
    """(n,) way from where it is to every view."""
    to_home_m: Array
    """(n,) way home from every view."""
    range_m: float
    """What its battery allows to fly, the way home included."""

    @property
    def covered(self) -> float:
        """Share of its own task that is done."""
        whole = self.flown_views + len(self.tour)
        return self.flown_views / whole if whole else 1.0


@dataclass(frozen=True)
class Reassignment:
    """New tours by vehicle id, who got which view, and the views that no receiver can afford."""

    tours: dict[int, list[int]]
    receiver_of_view: dict[int, int]
    left_over: list[int]


@dataclass(frozen=True)
class Ownership:
    """The thesis's identifier columns: one row per view, as written to trajectories.npz."""

    view_id: NDArray[np.int64]
    origin_vehicle: NDArray[np.int64]
    current_vehicle: NDArray[np.int64]

    def moved(self, receiver_of_view: Mapping[int, int]) -> Ownership:
        """The table after a reassignment; origins stay."""
        rows = zip(self.view_id, self.current_vehicle, strict=True)
        current = [receiver_of_view.get(int(view), int(vehicle)) for view, vehicle in rows]
        return Ownership(self.view_id, self.origin_vehicle, np.array(current, dtype=np.int64))


def ownership(tours: Mapping[int, Sequence[int]]) -> Ownership:
    """Every view owned by the vehicle whose tour holds it, in order of view id."""
    rows = sorted((view, vehicle) for vehicle, tour in tours.items() for view in tour)
    table = np.array(rows, dtype=np.int64).reshape(-1, 2)
    return Ownership(table[:, 0], table[:, 1], table[:, 1].copy())


def reassign(remaining: Sequence[int], receivers: Sequence[Receiver], between_m: Array,
             nearly_done: float = 0.8) -> Reassignment:
    """Share the remaining views of a vehicle that turned home or died out among the others.

    between_m: (n, n) ways between views. Vehicles that have covered `nearly_done` of their own task take them all where
    their range allows; views beyond it go to the others. A view goes behind the tour that is shortest with it, so that
    the order is kept. No tour exceeds its range. Every view is in exactly one tour or left over.
    """
    tours = {r.vehicle_id: list(r.tour) for r in receivers}
    taken: dict[int, int] = {}
    free = [r for r in receivers if r.covered >= nearly_done]
    pending = list(remaining)
    for group in (free, [r for r in receivers if r not in free]):
        pending = _append(pending, group, tours, taken, between_m)
    return Reassignment(tours, taken, pending)


def tour_length_m(receiver: Receiver, tour: Sequence[int], between_m: Array) -> float:
    """Way from where the vehicle is over the whole tour and home; 0 for an empty tour."""
    if not tour:
        return 0.0
    inner = between_m[list(tour[:-1]), list(tour[1:])].sum()
    return float(receiver.from_here_m[tour[0]] + inner + receiver.to_home_m[tour[-1]])


def _append(pending: list[int], group: list[Receiver], tours: dict[int, list[int]], taken: dict[int, int],
            between_m: Array) -> list[int]:
    left = []
    for view in pending:
        able = [r for r in group if tour_length_m(r, [*tours[r.vehicle_id], view], between_m) <= r.range_m]
        if not able:
            left.append(view)
            continue
        best = min(able, key=lambda r: (tour_length_m(r, [*tours[r.vehicle_id], view], between_m), r.vehicle_id))
        tours[best.vehicle_id].append(view)
        taken[view] = best.vehicle_id
    return left
