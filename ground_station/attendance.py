"""Vehicles that vanish from the clock, and come back."""

from __future__ import annotations

import logging

from ground_station.drone import Drone, Stage
from ground_station.ingest import Ingest
from ground_station.recorder import Recorder
from missions.clock import SECOND_NS

log = logging.getLogger(__name__)


class Attendance:
    """Who is missing, who is lost for all we know, and who is back."""

    def __init__(self, grace_s: float, ingest: Ingest, recorder: Recorder) -> None:
        """grace_s: for so long the views of a vehicle that has vanished wait for it."""
        self._grace_s, self._ingest, self._recorder = grace_s, ingest, recorder
        self.returned: list[Drone] = []
        """Who is here again since this turn, and knows nothing but where it is."""

    def miss(self, drone: Drone, t_ns: int) -> None:
        """It is not on the clock: what it was doing is void, but its views wait for it for a while."""
        if drone.stage is Stage.LOST:
            return
        if drone.stage is not Stage.MISSING:
            self._recorder.plan_ends(drone.vehicle_id, t_ns, flown=False)
            drone.stage, drone.goal, drone.missing_since_ns = Stage.MISSING, None, t_ns
            drone.awaited.clear()
            drone.link.cancel()
            self._ingest.forget(drone.vehicle_id)
            self._tell(drone, f"has vanished; its views wait {self._grace_s:g} s for it", t_ns)
        if t_ns - drone.missing_since_ns >= round(self._grace_s * SECOND_NS):
            drone.stage = Stage.LOST
            self._tell(drone, "is lost", t_ns)

    def find(self, drone: Drone, t_ns: int) -> None:
        """It takes part again: what it says of itself counts, and what it was sent before does not."""
        state = drone.state
        if state is None or state.t_ns <= drone.missing_since_ns:
            return
        drone.link.begin_anew()
        if not state.flying:
            drone.stage = Stage.SWAPPING if state.mode == "swap" else Stage.PARKED
        elif drone.link.returning:
            drone.stage = Stage.HOMING
        else:
            drone.stage = Stage.LAUNCHING if state.mode == "takeoff" else Stage.READY
        self.returned.append(drone)
        self._tell(drone, "is back", t_ns)

    def _tell(self, drone: Drone, what: str, t_ns: int) -> None:
        text = f"vehicle {drone.vehicle_id} {what}"
        self._recorder.note(t_ns, text)
        log.warning(text)
