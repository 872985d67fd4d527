"""What a watcher knows of a mission: every `LiveUpdate` so far, put together. The live page and programs share it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ground_station.live.trail import Trail
from missions.frames import Array
from missions.live import LivePicture, LivePlan, LiveSite, LiveState, LiveUpdate
from missions.messages import Vector

Voxel = tuple[int, int, int]


@dataclass
class LiveModel:
    """Apply updates in order. `site` and `state` are there once the first whole one has come."""

    site: LiveSite | None = None
    state: LiveState | None = None
    plans: dict[int, LivePlan] = field(default_factory=dict)
    trails: dict[int, Trail] = field(default_factory=dict)
    pictures: list[LivePicture] = field(default_factory=list)
    curve: list[tuple[float, float, float]] = field(default_factory=list)
    solid: set[Voxel] = field(default_factory=set)
    """Voxels that the map holds to be solid."""
    origin_enu_m: Vector = (0.0, 0.0, 0.0)
    voxel_m: float = 1.0
    map_version: int = 0
    """Counts changes of `solid`."""
    seq: int = 0

    def apply(self, update: LiveUpdate) -> bool:
        """Take an update in; False when one before it is missing, and a whole one has to be asked for."""
        if not update.whole and (self.state is None or update.seq != self.seq + 1):
            return False
        if update.whole:
            self._forget()
        self.seq, self.site, self.state = update.seq, update.site, update.state
        self.plans |= {p.vehicle_id: p for p in update.plans}
        self.pictures += update.pictures
        self.curve += update.curve
        for vehicle in update.state.vehicles:
            self.trails.setdefault(vehicle.vehicle_id, Trail()).extend(vehicle.trail_enu_m)
        if update.map is not None:
            self.origin_enu_m, self.voxel_m = update.map.origin_enu_m, update.map.voxel_m
            self.solid.difference_update(update.map.gone)
            self.solid.update(update.map.solid)
            self.map_version += 1
        return True

    def solid_centers_enu_m(self) -> Array:
        """(n, 3) centres of the solid voxels, sorted by index."""
        index = np.array(sorted(self.solid), dtype=np.float64).reshape(-1, 3)
        return np.array(self.origin_enu_m) + (index + 0.5) * self.voxel_m

    def latest_pictures(self) -> Iterator[LivePicture]:
        """The newest of each vehicle."""
        newest: dict[int, LivePicture] = {}
        for picture in self.pictures:
            if picture.vehicle_id not in newest or picture.t_s >= newest[picture.vehicle_id].t_s:
                newest[picture.vehicle_id] = picture
        yield from newest.values()

    def _forget(self) -> None:
        self.plans, self.trails, self.pictures, self.curve = {}, {}, [], []
        self.solid = set()
        self.map_version += 1
