"""Compiles this room's kernels into numba's cache on disk, by taking one range scan in and judging one chord:
python -m vehicle.warm_up."""

from __future__ import annotations

import numpy as np

from missions.messages import RangeScan
from missions.sensors import RANGE_DIRECTIONS
from vehicle.campaign_referee import chord_clearances
from vehicle.sensor_memory import SensorMemory


def warm_up() -> None:
    """Sweep a small room free, and fly through it."""
    memory = SensorMemory(np.zeros(3), np.full(3, 4.0), 0.5, 8.0, [])
    scan = RangeScan(vehicle_id=1, t_ns=0, position_enu_m=(2.0, 2.0, 2.0), ranges_m=[2.0] * len(RANGE_DIRECTIONS))
    memory.put_scan(scan, np.zeros((0, 3)), 1.0)
    solid = np.zeros((8, 8, 8), dtype=np.bool_)
    chord_clearances(np.full((1, 3), 1.0), np.full((1, 3), 3.0), solid, np.zeros(3), 0.5, 1.0)


if __name__ == "__main__":
    warm_up()
