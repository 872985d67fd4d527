"""What both phases of a mission share: the fleet, the map that was sent, energy left, and calling vehicles home."""

from __future__ import annotations

import numpy as np

from ground_station.drone import Drone
from ground_station.energy import EnergyBudget
from ground_station.fleet import Fleet
from ground_station.prior import Prior
from ground_station.recorder import Recorder
from ground_station.regions import Regions
from ground_station.voice import Voice
from missions import topics
from missions.frames import Array
from missions.grid import VoxelGrid
from missions.messages import SiteBrief
from missions.mission import Mission

AWAY_M = 5.0
MAX_RESCUES = 2
"""Times that a vehicle around which the map has closed is called home, on the way that it remembers, to start anew."""


class Control:
    """The mission's means, the same for every phase."""

    def __init__(self, mission: Mission, site: SiteBrief, fleet: Fleet, voice: Voice, recorder: Recorder,
                 prior: Prior | None = None) -> None:
        self.mission, self.site, self.fleet, self.recorder, self.prior = mission, site, fleet, recorder, prior
        self.energy, self.regions = EnergyBudget(mission, site), Regions(mission, site)
        self.grid: VoxelGrid | None = None
        """The newest map, as it is without what operators forbid."""
        self._voice = voice
        self._sent_grid: VoxelGrid | None = None
        self._rescues: dict[int, int] = {}

    def send_map(self, grid: VoxelGrid) -> None:
        """The map that is planned on, to the vehicles, when it has changed: this one, or the prior model's; without
        what operators forbid."""
        self.grid = grid if self.prior is None else self.prior.grid
        grid = self.regions.applied(self.grid)
        if self._sent_grid is None or not np.array_equal(self._sent_grid.state, grid.state):
            self._voice.publish(topics.MAP_SNAPSHOT, grid.to_message(self.fleet.t_ns))
            self._sent_grid = grid

    def send_map_again(self) -> None:
        """To vehicles that may have missed it."""
        if self.grid is not None:
            self._sent_grid = None
            self.send_map(self.grid)

    def unmapped_hits(self, grid: VoxelGrid) -> Array:
        """(n, 3) what the vehicles' range sensors have hit and the map that is planned on does not show."""
        return self.fleet.obstacles.unmapped(grid if self.prior is None else self.prior.grid, self.fleet.t_ns)

    def note(self, text: str) -> None:
        """Something a reader of the report should know, now."""
        self.recorder.note(self.fleet.t_ns, text)

    def usable_percent(self, drone: Drone, exploring: bool) -> float:
        """What a vehicle may still spend in this phase, the way home included."""
        return self.energy.usable_percent(drone.vehicle_id, drone.battery_percent, exploring)

    def may_rescue(self, drone: Drone) -> bool:
        """Whether it helps, and is still allowed, to call a shut-in vehicle home."""
        away = float(np.linalg.norm(drone.position_enu_m - drone.hover_enu_m))
        return away > AWAY_M and self._rescues.get(drone.vehicle_id, 0) < MAX_RESCUES

    def rescue(self, drone: Drone) -> None:
        """Call a shut-in vehicle home, to start anew."""
        self._rescues[drone.vehicle_id] = self._rescues.get(drone.vehicle_id, 0) + 1
        self.note(f"vehicle {drone.vehicle_id} is shut in by the map and is called home")
        self.fleet.home(drone)
