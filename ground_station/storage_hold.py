"""Vehicles hold while the ground station cannot keep pictures: no new views, and what was taken waits on board."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from ground_station.drone import Drone, Stage

if TYPE_CHECKING:
    from ground_station.fleet import Fleet

log = logging.getLogger(__name__)

HOLDING = (Stage.PARKED, Stage.LAUNCHING, Stage.READY, Stage.FLYING)
"""Who comes home anyway comes home."""


class StorageHold:
    """Pauses whoever is at work, as an operator would, and lets them go on when there is space again. Who runs low
    meanwhile comes home by itself."""

    def __init__(self) -> None:
        self.trouble = ""
        """Why, to follow "the disk of the run folder"; "" when nobody is held."""
        self.held: set[int] = set()
        """Vehicles that hold for this, not for a person."""

    def step(self, fleet: Fleet, trouble: str) -> str:
        """Once a turn. trouble: of the disk. Returns what people should know, or ""."""
        before, self.trouble = self.trouble, trouble
        if trouble:
            for drone in fleet.drones.values():
                if drone.stage in HOLDING and not drone.held:
                    fleet.pause(drone)
                    self.held.add(drone.vehicle_id)
            return "" if before == trouble else f"the disk of the run folder {trouble}: vehicles hold, no new views"
        if not before:
            return ""
        for drone in (fleet.drones[k] for k in sorted(self.held)):
            self._release(fleet, drone)
        self.held.clear()
        return "the disk of the run folder takes pictures again"

    @staticmethod
    def _release(fleet: Fleet, drone: Drone) -> None:
        drone.idle_since_ns = -1
        if drone.gone or drone.stage is Stage.HOMING:
            drone.link.held = False
        elif drone.held:
            fleet.resume(drone)
