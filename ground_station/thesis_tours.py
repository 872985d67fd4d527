"""The thesis's method: Ward clusters, networkx tours, and reassignment of what a vehicle leaves behind."""

from __future__ import annotations

import numpy as np

from ground_station.ledger import ENERGY
from ground_station.tours import Flyer, Flying, Outcome, Tours
from missions.camera import View
from missions.mission import Mission
from planning.allocate.cost import LegCost
from planning.allocate.thesis import allocate
from planning.allocate.thesis_reassign import Receiver, reassign


class ThesisTours:
    """Sections 4.4.1, 4.4.2 and 4.4.6. Energy is reckoned by Algorithm 1 over straight legs; the way home is flown with
    what the threshold keeps back. There is one sortie per vehicle."""

    def __init__(self, views: list[View], mission: Mission) -> None:
        spec = mission.survey
        self._percent_per_m = mission.battery.percent_per_m
        self._cost = LegCost(spec.cost, spec.alpha, spec.beta)
        self._ids = [v.view_id for v in views]
        self._index = {view_id: i for i, view_id in enumerate(self._ids)}
        self._positions = np.array([v.pose.position_enu_m for v in views]).reshape(-1, 3)
        self._between_m = LegCost().between(self._positions, self._positions)
        self._place: dict[int, int] = {}

    def begin(self, flyers: list[Flyer]) -> Tours:
        """A Ward cluster and a networkx tour for each vehicle."""
        starts = np.array([f.position_enu_m for f in flyers])
        tours = [[self._ids[i] for i in tour] for tour in allocate(self._positions, starts, self._cost)]
        self._place = {view_id: place for place, view_id in enumerate(v for tour in tours for v in tour)}
        return Tours({f.vehicle_id: [tour] for f, tour in zip(flyers, tours, strict=True)})

    def again(self, flyers: list[Flyer], now: Flying) -> Tours:
        """What nobody has goes to whoever is done or nearly done and can afford it, in the order of the first tours."""
        sorties = {f.vehicle_id: [list(now.sorties[f.vehicle_id][0])] for f in flyers}
        left_over: dict[int, Outcome] = {}
        groups: dict[tuple[int, ...], list[int]] = {}
        for view_id in sorted(now.homeless, key=lambda v: (self._place.get(v, -1), v)):
            groups.setdefault(tuple(now.refused_by.get(view_id, ())), []).append(view_id)
        for refused_by, views in sorted(groups.items()):
            able = [f for f in flyers if f.vehicle_id not in refused_by]
            receivers = [self._receiver(f, sorties[f.vehicle_id][0], now) for f in able]
            found = reassign([self._index[v] for v in views], receivers, self._between_m)
            for vehicle_id, tour in found.tours.items():
                sorties[vehicle_id] = [[self._ids[i] for i in tour]]
            left_over |= {self._ids[i]: Outcome(ENERGY, "beyond what every battery allows") for i in found.left_over}
        return Tours(sorties, left_over)

    def _receiver(self, flyer: Flyer, tour: list[int], now: Flying) -> Receiver:
        away_m = np.linalg.norm(self._positions - flyer.position_enu_m, axis=1)
        range_m = flyer.usable_percent / self._percent_per_m if self._percent_per_m > 0.0 else float("inf")
        return Receiver(flyer.vehicle_id, [self._index[v] for v in tour], now.flown.get(flyer.vehicle_id, 0),
                        away_m, np.zeros_like(away_m), range_m)
