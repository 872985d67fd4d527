"""What the vehicle knows of space: map, swept voxels, hits."""

from __future__ import annotations

import numpy as np
import pytest

from missions.grid import FREE, OCCUPIED, VoxelGrid
from missions.messages import RangeScan
from missions.sensors import RANGE_DIRECTIONS
from tests.vehicle_world import box_ranges
from vehicle.sensor_memory import HIT_MEMORY_NS, SensorMemory

LOWER, UPPER = np.array([-10.0, -10.0, 0.0]), np.array([10.0, 10.0, 10.0])
HERE = np.array([0.0, 0.0, 5.0])
NOBODY = np.zeros((0, 3))
WALL = ((3.0, -8.0, 0.0), (3.5, 8.0, 10.0))


@pytest.fixture
def memory() -> SensorMemory:
    return SensorMemory(LOWER, UPPER, 0.5, 8.0, [(np.array([-8.0, -8.0, 0.0]), np.array([-4.0, -4.0, 6.0]))])


def scan(t_ns: int = 0, boxes: tuple[object, ...] = (WALL,)) -> RangeScan:
    ranges = box_ranges(HERE, boxes, 8.0).tolist()  # type: ignore[arg-type]
    return RangeScan(vehicle_id=1, t_ns=t_ns, position_enu_m=(0.0, 0.0, 5.0), ranges_m=ranges)


def clearance(memory: SensorMemory, point: np.ndarray) -> float:
    return float(memory.field(point, point, 2.0).clearance_m(point)[0])


def test_at_first_only_the_columns_are_free(memory: SensorMemory) -> None:
    assert clearance(memory, np.array([-6.0, -6.0, 3.0])) > 1.2
    assert clearance(memory, HERE) == 0.0


def test_what_the_sensor_sweeps_is_free_and_what_it_hits_is_not(memory: SensorMemory) -> None:
    memory.put_scan(scan(), NOBODY, 1.5)
    assert clearance(memory, HERE) > 0.5
    assert not memory.hits_clear(np.array([HERE, [6.0, 0.0, 5.0]]), 1.0)
    assert memory.hits_clear(np.array([HERE, [-6.0, 0.0, 5.0]]), 2.9)
    assert memory.hits_clear(np.array([HERE, [0.0, 0.0, 1.0]]), 0.9), "the ground is no obstacle"


def test_nothing_behind_a_hit_is_swept(memory: SensorMemory) -> None:
    memory.put_scan(scan(), NOBODY, 1.5)
    behind = np.stack(np.meshgrid(np.arange(3.75, 9.0, 0.5), np.arange(-6.0, 6.0, 0.5), [5.25]), axis=-1).reshape(-1, 3)
    assert max(clearance(memory, p) for p in behind) == 0.0


def test_the_map_is_taken_over_where_it_lies_and_solid_stays_solid(memory: SensorMemory) -> None:
    grid = VoxelGrid.unknown(np.array([-4.25, -4.25, 2.0]), np.array([5.75, 5.75, 8.0]), 0.5)
    grid.state[:] = FREE
    grid.state[10, 10, 8] = OCCUPIED
    solid = grid.centers(np.array([10, 10, 8]))
    memory.put_map(grid)
    memory.put_scan(scan(boxes=()), NOBODY, 1.5)
    assert clearance(memory, solid) == 0.0
    assert clearance(memory, np.array([-1.5, -1.5, 5.0])) > 1.7
    assert clearance(memory, np.array([-6.0, -6.0, 3.0])) > 1.0, "columns stay free"


def test_echoes_from_teammates_are_left_out(memory: SensorMemory) -> None:
    body = ((2.7, -0.3, 4.7), (3.3, 0.3, 5.3))
    memory.put_scan(scan(boxes=(body,)), np.array([[3.0, 0.0, 5.0]]), 1.5)
    assert memory.hits_clear(np.array([HERE, [6.0, 0.0, 5.0]]), 1.0)


def test_hits_are_kept_once_and_forgotten_when_not_seen_again(memory: SensorMemory) -> None:
    memory.put_scan(scan(), NOBODY, 1.5)
    version = memory.hit_version
    memory.put_scan(scan(10), NOBODY, 1.5)
    assert memory.hit_version == version
    memory.put_scan(scan(HIT_MEMORY_NS, boxes=()), NOBODY, 1.5)
    assert not memory.hits_clear(np.array([HERE, [6.0, 0.0, 5.0]]), 1.0)
    memory.put_scan(scan(3 * HIT_MEMORY_NS, boxes=()), NOBODY, 1.5)
    assert memory.hits_clear(np.array([HERE, [6.0, 0.0, 5.0]]), 1.0)


def test_what_is_hit_for_the_first_time_is_told_once(memory: SensorMemory) -> None:
    memory.put_scan(scan(), NOBODY, 1.5)
    told = memory.take_untold()
    assert len(told) > 100
    assert np.abs(told[:, 0] - 3.0).max() < 1e-9
    memory.put_scan(scan(10), NOBODY, 1.5)
    assert len(memory.take_untold()) == 0
    post = ((-3.0, -0.5, 0.0), (-2.5, 0.5, 10.0))
    memory.put_scan(scan(20, boxes=(WALL, post)), NOBODY, 1.5)
    assert np.abs(memory.take_untold()[:, 0] + 2.75).max() < 0.25 + 1e-9


def test_directions_cover_the_sphere_evenly() -> None:
    nearest = np.sort(RANGE_DIRECTIONS @ RANGE_DIRECTIONS.T, axis=1)[:, -2]
    assert np.degrees(np.arccos(nearest)).max() < 6.0
