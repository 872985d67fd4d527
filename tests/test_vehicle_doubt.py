"""What a map takes back while a vehicle flies there: swept clear from nearer by, or stopped before."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from missions.grid import OCCUPIED, UNKNOWN, VoxelGrid
from missions.mission import Mission
from tests.vehicle_world import Box, World, box_distance, open_map, route
from vehicle.avoidance import STOPPED_SHORT_M


def doubtful(mission: Mission, block: Box) -> VoxelGrid:
    """The open map, but for a block that it does not know any more."""
    grid = open_map(mission, [block])
    grid.state[grid.state == OCCUPIED] = UNKNOWN
    return grid


def flown_in_doubt(folder: Path, block: Box | None, told_at_m: float, reach_m: float = 8.0) -> World:
    """A leg eastwards, past x = told_at_m with this block taken back."""
    fleet = {"vehicles": 1, "range_sensor_m": reach_m}
    world = World(msgspec.convert({"title": "test", "fleet": fleet}, Mission), folder)
    world.share_map(open_map(world.mission))
    world.upload(route([(-10, -10, 5), (11, -10, 5)]), 1)
    assert world.run(60, lambda: world.views() == [100])
    assert world.run(30, lambda: world.states[1][-1].position_enu_m[0] > told_at_m)
    world.share_map(open_map(world.mission) if block is None else doubtful(world.mission, block))
    assert world.run(60, lambda: world.views() == [100, 101] or world.reports)
    return world


def test_a_doubt_that_the_sensor_clears_in_time_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "certain").mkdir()
    (tmp_path / "doubtful").mkdir()
    certain = flown_in_doubt(tmp_path / "certain", None, -8.0)
    doubtful = flown_in_doubt(tmp_path / "doubtful", ((2.0, -10.5, 4.5), (3.0, -9.5, 5.5)), -8.0)
    assert doubtful.views() == [100, 101]
    assert np.array_equal(certain.path(1), doubtful.path(1))


@pytest.mark.parametrize("told_at_m", [-8.0, -0.5])
def test_a_vehicle_stops_before_what_stays_doubtful(told_at_m: float, tmp_path: Path) -> None:
    """The sensor's reach is too short to sweep anything clear."""
    block = ((5.0, -12.0, 3.0), (6.0, -8.0, 7.0))
    world = flown_in_doubt(tmp_path, block, told_at_m, reach_m=0.3)
    assert world.views() == [100, 101]
    assert box_distance(world.path(1), block).min() >= world.mission.fleet.clearance_m - STOPPED_SHORT_M
    rests = world.path(1)[[max(map(abs, s.velocity_enu_m_s)) == 0.0 for s in world.states[1]]]
    assert any(told_at_m < x < 4.0 and y == pytest.approx(-10.0, abs=0.02) for x, y, _ in rests)
