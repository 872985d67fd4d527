"""The simulated short-range obstacle sensor that consumer drones carry. It serves avoidance alone."""

from __future__ import annotations

import numpy as np

from missions.clock import SECOND_NS
from missions.messages import RangeScan, VehicleState
from missions.sensors import RANGE_DIRECTIONS
from sim_bridge.truth import Truth

SCAN_PERIOD_NS = SECOND_NS // 10


class RangeSensor:
    """Scans of one fleet: ten per simulated second and flying vehicle. Other vehicles are not seen; they announce
    themselves."""

    def __init__(self, truth: Truth, reach_m: float) -> None:
        self._truth, self._reach_m = truth, reach_m
        self._next_ns: dict[int, int] = {}

    def scan(self, state: VehicleState) -> RangeScan | None:
        """What the vehicle's sensor reads in this state, or None when it is not due or the vehicle stands."""
        if not self.due(state):
            return None
        origins = np.broadcast_to(np.array(state.position_enu_m), RANGE_DIRECTIONS.shape)
        ranges = self._truth.cast(origins, RANGE_DIRECTIONS, self._reach_m, state.t_ns)
        return RangeScan(vehicle_id=state.vehicle_id, t_ns=state.t_ns, position_enu_m=state.position_enu_m,
                         ranges_m=ranges.tolist())

    def due(self, state: VehicleState) -> bool:
        """Whether it scans in this state; then not again for a while."""
        if not state.flying or state.t_ns < self._next_ns.get(state.vehicle_id, 0):
            return False
        self._next_ns[state.vehicle_id] = (state.t_ns // SCAN_PERIOD_NS + 1) * SCAN_PERIOD_NS
        return True
