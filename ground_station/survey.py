"""The survey's decisions: who flies which views in which order, and what happens to views that somebody cannot fly.

No bus, no clock. Every view ends with exactly one outcome (see `ledger`).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from ground_station.airspace import Airspace
from ground_station.ledger import ENERGY, UNREACHABLE, ViewLedger
from missions.camera import View
from missions.frames import Array
from missions.mavlink import Waypoint
from missions.mission import SurveySpec
from planning.allocate.cost import LegCost
from planning.allocate.thesis import allocate
from planning.allocate.thesis_reassign import Receiver, reassign

log = logging.getLogger(__name__)

CHUNK_VIEWS = 20
"""Views per upload: few enough that a reassigned view is flown soon, many enough that uploads do not count."""
DETOUR = 1.15
"""Legs are taken to be this much longer than straight lines when energy is shared out."""


@dataclass(frozen=True)
class Flyer:
    """A vehicle that can still take views. range_m: what it may fly, the way home included."""

    vehicle_id: int
    position_enu_m: Array
    home_enu_m: Array
    range_m: float


class Survey:
    """Tours, their execution in chunks, and reassignment."""

    def __init__(self, views: list[View], spec: SurveySpec) -> None:
        self.ledger = ViewLedger(views)
        self._spec = spec
        self._cost = LegCost(spec.cost, spec.alpha, spec.beta)
        self._ids = [v.view_id for v in views]
        self._positions = np.array([v.pose.position_enu_m for v in views]).reshape(-1, 3)
        self._between_m = DETOUR * LegCost().between(self._positions, self._positions)
        self._queues: dict[int, list[int]] = {}
        self._active: dict[int, list[int]] = {}
        self._flown: dict[int, int] = {}
        self._chunk: dict[int, int] = {}

    @property
    def over(self) -> bool:
        """Whether every view has its outcome."""
        return self.ledger.open_count == 0

    @property
    def progress(self) -> tuple[int, int]:
        """(views with an outcome, all views)."""
        return len(self._ids) - self.ledger.open_count, len(self._ids)

    def left(self, vehicle_id: int) -> int:
        """Views that a vehicle still has to fly."""
        return len(self.ledger.held_by(vehicle_id))

    def waiting(self, vehicle_id: int) -> bool:
        """Whether a vehicle has views that are not in its plan yet."""
        return bool(self._queues.get(vehicle_id))

    def allocate(self, flyers: list[Flyer], t_s: float) -> None:
        """The first tours (thesis sections 4.4.1 and 4.4.2)."""
        if not flyers or not self._ids:
            return
        starts = np.array([f.position_enu_m for f in flyers])
        tours = allocate(self._positions, starts, self._cost)
        for flyer, tour in zip(flyers, tours, strict=True):
            self._queues[flyer.vehicle_id] = [self._ids[i] for i in tour]
            for i in tour:
                self.ledger.assign(self._ids[i], flyer.vehicle_id, t_s)

    def shut_in(self, flyer: Flyer, airspace: Airspace, teammates_enu_m: list[Array]) -> bool:
        """Whether there is no way from where a vehicle hovers to any view that it still has to plan."""
        poses = [self.ledger.view(i).pose for i in self._queues.get(flyer.vehicle_id, [])]
        goals = np.array([p.position_enu_m for p in poses]).reshape(-1, 3)
        reach = airspace.reach(flyer.position_enu_m, teammates_enu_m)
        return bool(len(goals)) and not np.isfinite(reach.distance_to(goals)).any()

    def next_waypoints(self, flyer: Flyer, airspace: Airspace, teammates_enu_m: list[Array]) -> list[Waypoint]:
        """The vehicle's next chunk, every leg free of collisions; views without a way are handed back. May be empty."""
        queue = self._queues.get(flyer.vehicle_id, [])
        size = self._chunk.get(flyer.vehicle_id, CHUNK_VIEWS)
        waypoints: list[Waypoint] = []
        taken: list[int] = []
        here = flyer.position_enu_m
        while queue and len(taken) < size:
            view = self.ledger.view(queue.pop(0))
            path = airspace.path(here, np.array(view.pose.position_enu_m), teammates_enu_m)
            if path is None:
                log.info("vehicle %d has no way to view %d", flyer.vehicle_id, view.view_id)
                self.ledger.blocked(view.view_id)
                continue
            waypoints.extend(_via(p, view) for p in path[1:-1])
            waypoints.append(_shot(view, self._spec.settle_s))
            here = path[-1]
            taken.append(view.view_id)
        self._active[flyer.vehicle_id] = taken
        return waypoints

    def flown(self, view_id: int, vehicle_id: int) -> None:
        """The picture of a view is on disk."""
        if view_id in self.ledger:
            self.ledger.flown(view_id)
            self._forget(view_id)
            self._flown[vehicle_id] = self._flown.get(vehicle_id, 0) + 1
            self._chunk.pop(vehicle_id, None)

    def not_flown(self, view_id: int, vehicle_id: int, outcome: str) -> None:
        """The vehicle reported that it will not fly a view."""
        if view_id not in self.ledger or view_id not in self.ledger.held_by(vehicle_id):
            return
        self._forget(view_id)
        if outcome == ENERGY:
            self.ledger.release(view_id, ENERGY)
        else:
            self.ledger.blocked(view_id)

    def plan_refused(self, vehicle_id: int) -> None:
        """The vehicle refused a chunk: half as many views next time; a single refused view counts as blocked."""
        chunk = self._active.pop(vehicle_id, [])
        if len(chunk) <= 1:
            for view_id in chunk:
                self.ledger.blocked(view_id)
            return
        self._chunk[vehicle_id] = max(1, len(chunk) // 2)
        self._queues[vehicle_id] = chunk + self._queues.get(vehicle_id, [])

    def plan_over(self, vehicle_id: int) -> None:
        """The vehicle hovers at the end of its plan; what it neither flew nor reported counts as blocked."""
        for view_id in self._active.pop(vehicle_id, []):
            self.ledger.blocked(view_id)

    def gone(self, vehicle_id: int, reason: str) -> None:
        """The vehicle flies nothing more: it returned for energy, or is lost."""
        for view_id in self.ledger.held_by(vehicle_id):
            self.ledger.release(view_id, reason)
        self._queues.pop(vehicle_id, None)
        self._active.pop(vehicle_id, None)

    def redistribute(self, flyers: list[Flyer], t_s: float) -> None:
        """Give every view that nobody holds to a vehicle that has not found it blocked and can afford it, or settle
        its outcome (thesis section 4.4.6)."""
        groups: dict[tuple[int, ...], list[int]] = {}
        for view_id in self.ledger.homeless():
            groups.setdefault(tuple(self.ledger.refused_by(view_id)), []).append(view_id)
        for refused_by, views in sorted(groups.items()):
            able = [f for f in flyers if f.vehicle_id not in refused_by]
            if not able:
                for view_id in views:
                    self.ledger.settle(view_id, UNREACHABLE if refused_by else
                                       self.ledger.why_released(view_id) or UNREACHABLE)
                continue
            self._hand_over(views, able, t_s)

    def _hand_over(self, views: list[int], able: list[Flyer], t_s: float) -> None:
        index = {view_id: i for i, view_id in enumerate(self._ids)}
        receivers = [self._receiver(f, index) for f in able]
        result = reassign([index[v] for v in views], receivers, self._between_m)
        for i, vehicle_id in result.receiver_of_view.items():
            self.ledger.assign(self._ids[i], vehicle_id, t_s)
        for f in able:
            active = set(self._active.get(f.vehicle_id, []))
            tour = [self._ids[i] for i in result.tours[f.vehicle_id]]
            self._queues[f.vehicle_id] = [v for v in tour if v not in active]
        for i in result.left_over:
            self.ledger.settle(self._ids[i], ENERGY)

    def _receiver(self, flyer: Flyer, index: dict[int, int]) -> Receiver:
        active = self._active.get(flyer.vehicle_id, [])
        tour = [index[v] for v in (*active, *self._queues.get(flyer.vehicle_id, []))]
        away = DETOUR * np.linalg.norm(self._positions - flyer.position_enu_m, axis=1)
        home = DETOUR * np.linalg.norm(self._positions - flyer.home_enu_m, axis=1)
        return Receiver(flyer.vehicle_id, tour, self._flown.get(flyer.vehicle_id, 0), away, home, flyer.range_m)

    def _forget(self, view_id: int) -> None:
        for views in (*self._queues.values(), *self._active.values()):
            if view_id in views:
                views.remove(view_id)


def _shot(view: View, settle_s: float) -> Waypoint:
    pose = view.pose
    return Waypoint(position_enu_m=pose.position_enu_m, yaw_enu_rad=pose.yaw_enu_rad,
                    gimbal_elevation_rad=pose.elevation_rad, view_id=view.view_id, settle_s=settle_s)


def _via(position: Array, view: View) -> Waypoint:
    x, y, z = (float(c) for c in position)
    return Waypoint(position_enu_m=(x, y, z), yaw_enu_rad=view.pose.yaw_enu_rad, stop=False)
