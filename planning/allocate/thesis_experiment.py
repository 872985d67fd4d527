"""The thesis's planning experiment (its sections 4.4 and 5.3), without flying it: clusters, tours around the mesh, the
battery along them by Algorithm 1, and what a vehicle leaves to the others where it meets the threshold.

An index counts the points of a vehicle's tour from 0, inserted waypoints included. The vehicle stops at the first
index at which the level is at or below the threshold; the views from that index on are handed over. That is how the
thesis's numbers add up: 300 + 109 = 409 points, which are 401 views and 8 inserted ones (409 + 194 = 603).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from planning.allocate.battery import Forecast, consume, range_m, threshold_index
from planning.allocate.cost import LegCost
from planning.allocate.thesis import allocate
from planning.allocate.thesis_reassign import Ownership, Receiver, ownership, reassign
from planning.allocate.tours import closed_tour
from planning.allocate.ward import ward_clusters
from planning.paths.thesis import NO_VIEW, RepairedRoute, repair_route


@dataclass(frozen=True)
class Discharge:
    """What flying takes out of a battery, and when to stop."""

    percent_per_m: float
    threshold_percent: float = 20.0
    start_percent: float = 100.0


@dataclass(frozen=True)
class Obstacle:
    """The structure that legs must not meet: triangles (t, 3, 3), and the scene's bounds (3,), ENU metres."""

    triangles: Array
    lower_enu_m: Array
    upper_enu_m: Array
    margin_m: float = 0.5


@dataclass(frozen=True)
class TourPlan:
    """One vehicle's tour before the reassignment, and what was added to it by that."""

    original_m: float
    """Length of its views in the order in which they came."""
    own: RepairedRoute
    """Its tour; `view` holds indices into all views."""
    forecast: Forecast
    """Over its own points."""
    stop: int | None
    """Index of the point at which the level meets the threshold."""
    added: RepairedRoute
    """What it takes over, behind its own points; may be empty."""

    @property
    def optimised_m(self) -> float:
        """Length of its own tour, waypoints around the structure included."""
        return float(self.forecast.distance_m[-1]) if len(self.forecast.distance_m) else 0.0

    @property
    def flown(self) -> RepairedRoute:
        """What it flies: its own points up to where it stops, then what was added."""
        until = len(self.own.view) if self.stop is None else self.stop
        return RepairedRoute(np.concatenate([self.own.points_enu_m[:until], self.added.points_enu_m]),
                             np.concatenate([self.own.view[:until], self.added.view]))

    @property
    def left(self) -> list[int]:
        """Views that it hands over, in order."""
        return [] if self.stop is None else [int(v) for v in self.own.view[self.stop :] if v != NO_VIEW]


@dataclass(frozen=True)
class Experiment:
    """The whole plan. Vehicles are counted from 1."""

    cost: LegCost
    discharge: Discharge
    tours: dict[int, TourPlan]
    owners: Ownership
    """Of every view: the vehicle whose cluster held it, and the one that flies it."""
    left_over: list[int]
    """Views that no vehicle can afford."""

    def forecast(self, vehicle_id: int) -> Forecast:
        """Algorithm 1 over all that a vehicle flies, and over the point at which it stops."""
        tour = self.tours[vehicle_id]
        points = tour.flown.points_enu_m
        if tour.stop is not None:
            points = np.concatenate([points, tour.own.points_enu_m[tour.stop : tour.stop + 1]])
        return forecast(points, self.discharge)

    def table(self) -> dict[str, NDArray[np.float64] | NDArray[np.int64]]:
        """The thesis's .npz: a row per waypoint in order of vehicle and sequence. view_id: index of the view, -1 for
        inserted waypoints; position_enu_m (n, 3); origin_vehicle, current_vehicle: from 1; sequence: from 0."""
        origin = dict(zip(self.owners.view_id.tolist(), self.owners.origin_vehicle.tolist(), strict=True))
        view = [tour.flown.view for tour in self.tours.values()]
        vehicle = [np.full(len(v), k, dtype=np.int64) for k, v in zip(self.tours, view, strict=True)]
        return {
            "view_id": np.concatenate(view),
            "position_enu_m": np.concatenate([tour.flown.points_enu_m for tour in self.tours.values()]),
            "origin_vehicle": np.array([origin.get(int(v), k) for k, row in zip(self.tours, view, strict=True)
                                        for v in row], dtype=np.int64),
            "current_vehicle": np.concatenate(vehicle),
            "sequence": np.concatenate([np.arange(len(v), dtype=np.int64) for v in view]),
        }


def forecast(points_enu_m: Array, discharge: Discharge) -> Forecast:
    """Algorithm 1 over points (n, 3)."""
    return consume(points_enu_m, discharge.start_percent, discharge.percent_per_m)


def experiment(positions_enu_m: Array, vehicles: int, cost: LegCost, discharge: Discharge,
               starts_enu_m: Array | None = None, obstacle: Obstacle | None = None, seed: int = 1) -> Experiment:
    """Plan all views (n, 3), n > 0. Without starts (m, 3) a tour begins with the first view of its cluster, as in the
    thesis; with them it is cut where the way from there and back is short. Without an obstacle legs are straight.

    The battery is full at the first view of a tour, and ways from and to pads cost nothing: the thesis knows no pads.
    """
    positions = np.asarray(positions_enu_m, dtype=np.float64).reshape(-1, 3)
    orders = _orders(positions, vehicles, cost, starts_enu_m)
    tours = {k: _tour(positions, order, discharge, obstacle, seed) for k, order in enumerate(orders, start=1)}
    owners = ownership(dict(enumerate(orders, start=1)))
    left_over: list[int] = []
    between_m = LegCost().between(positions, positions)
    stopped = sorted((tour.forecast.distance_m[tour.stop], k) for k, tour in tours.items() if tour.stop is not None)
    for after_m, k in stopped:
        free = [j for j in tours if tours[j].stop is None]
        receivers = [_receiver(j, tours[j], positions, float(after_m), discharge) for j in free]
        result = reassign(tours[k].left, receivers, between_m)
        for j in sorted(set(result.receiver_of_view.values())):
            views = [v for v in tours[k].left if result.receiver_of_view.get(v) == j]
            tours[j] = replace(tours[j], added=_behind(tours[j], positions, views, obstacle, seed + k))
        owners, left_over = owners.moved(result.receiver_of_view), left_over + result.left_over
    return Experiment(cost, discharge, tours, owners, left_over)


def percent_per_m_to_stop(distance_m: Array, index: int, level_percent: float, start_percent: float = 100.0) -> float:
    """The consumption at which Algorithm 1 reaches a level at an index of cumulative distances (n,)."""
    return (start_percent - level_percent) / float(distance_m[index])


def _orders(positions: Array, vehicles: int, cost: LegCost, starts: Array | None) -> list[list[int]]:
    if starts is not None:
        return allocate(positions, starts, cost)
    clusters = ward_clusters(positions, vehicles)
    clusters += [np.zeros(0, dtype=np.int64)] * (vehicles - len(clusters))
    return [[int(c[i]) for i in closed_tour(cost.between(positions[c], positions[c]))] for c in clusters]


def _tour(positions: Array, order: list[int], discharge: Discharge, obstacle: Obstacle | None, seed: int) -> TourPlan:
    original = positions[sorted(order)]
    own = _led_around(positions[order], np.array(order, dtype=np.int64), obstacle, seed)
    along = forecast(own.points_enu_m, discharge)
    stop = threshold_index(along, discharge.threshold_percent) if order else None
    return TourPlan(float(np.linalg.norm(np.diff(original, axis=0), axis=1).sum()), own, along, stop, EMPTY)


def _led_around(points: Array, views: NDArray[np.int64], obstacle: Obstacle | None, seed: int) -> RepairedRoute:
    if obstacle is None:
        return RepairedRoute(points, views)
    route = repair_route(obstacle.triangles, points, obstacle.lower_enu_m, obstacle.upper_enu_m, seed,
                         obstacle.margin_m)
    return replace(route, view=np.where(route.view == NO_VIEW, NO_VIEW, views[route.view] if len(views) else NO_VIEW))


def _behind(tour: TourPlan, positions: Array, views: Sequence[int], obstacle: Obstacle | None,
            seed: int) -> RepairedRoute:
    """What the tour has been given already, and these views behind it, the way to them led around the structure."""
    before = np.concatenate([tour.own.points_enu_m, tour.added.points_enu_m])[-1:]
    at = np.concatenate([np.full(len(before), NO_VIEW), np.array(views, dtype=np.int64)])
    way = _led_around(np.concatenate([before, positions[list(views)]]), at, obstacle, seed)
    return RepairedRoute(np.concatenate([tour.added.points_enu_m, way.points_enu_m[len(before) :]]),
                         np.concatenate([tour.added.view, way.view[len(before) :]]),
                         {**tour.added.refused, **way.refused})


def _receiver(vehicle_id: int, tour: TourPlan, positions: Array, after_m: float, discharge: Discharge) -> Receiver:
    """A vehicle after it has flown so far, all vehicles being equally fast."""
    flown = tour.flown
    along = forecast(flown.points_enu_m, discharge)
    passed = int(np.searchsorted(along.distance_m, after_m, side="right"))
    views = [int(v) for v in flown.view[passed:] if v != NO_VIEW]
    here = flown.points_enu_m[max(0, passed - 1) : max(1, passed)]
    away = np.linalg.norm(positions - here[0], axis=1) if len(here) else np.zeros(len(positions))
    level = float(along.level_percent[min(max(0, passed - 1), len(along.level_percent) - 1)])
    return Receiver(vehicle_id, views, int((flown.view[:passed] != NO_VIEW).sum()), away, np.zeros(len(positions)),
                    range_m(level, discharge.percent_per_m, discharge.threshold_percent))


EMPTY = RepairedRoute(np.zeros((0, 3)), np.zeros(0, dtype=np.int64))
