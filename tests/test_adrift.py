"""Stray depth that hangs in the air closes no way; what hangs on something does, and what nobody looked through."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from ground_station.nbv.explored import Explored
from missions.camera import Pose
from missions.pose_lattice import AXIS_STEPS
from perception.mapping.adrift import adrift
from tests.depth_scene import exact_depth_map, halved, wall_picture
from tests.test_wires import brief

SHAPE = (20, 20, 20)
NORTH = math.pi / 2


def flat(*voxels: tuple[int, int, int]) -> NDArray[np.int64]:
    return np.array([np.ravel_multi_index(v, SHAPE) for v in sorted(voxels)], dtype=np.int64)


WALL = [(2, y, z) for y in range(10) for z in range(10)]


@pytest.mark.parametrize(("at", "free", "expected"), [
    ((12, 5, 5), 1, True),  # far from all else, and somebody looked through
    ((12, 5, 5), 0, False),  # nobody has looked there since
    ((4, 5, 5), 1, False),  # hangs on the wall
])
def test_adrift_is_what_hangs_on_nothing_and_was_looked_through(at: tuple[int, int, int], free: int,
                                                                expected: bool) -> None:
    voxels = flat(*WALL, at)
    free_pictures = np.where(voxels == flat(at)[0], free, 1).astype(np.int32)
    found = adrift(voxels, SHAPE, free_pictures)
    assert found[voxels == flat(at)[0]].all() == expected
    assert not found[voxels != flat(at)[0]].any()


def test_nothing_is_adrift_in_an_empty_map() -> None:
    assert adrift(flat(), SHAPE, np.zeros(0, np.int32)).shape == (0,)


def mapped(stray: tuple[float, float, float] | None) -> Explored:
    """Before a wall in the south, eight pictures; in two of them stray depth at one place."""
    explored = Explored(brief())
    for n, east in enumerate(np.linspace(9.0, 12.0, 8)):
        pose = Pose((east, -4.0, 3.0), NORTH, 0.0)
        depth = halved(wall_picture(pose, wall_north_m=9.5)[1])
        if stray is not None and n < 2:
            ahead = stray[1] - pose.position_enu_m[1]
            column, row = (114 + 114.0 * (stray[0] - east) / ahead, 64 - 114.0 * (stray[2] - 3.0) / ahead)
            depth[int(row) - 1:int(row) + 2, int(column) - 1:int(column) + 2] = ahead
        explored._map.voxels.integrate(exact_depth_map(pose, depth))
    return explored


def test_a_place_beside_stray_depth_can_be_flown_to_and_the_stray_depth_itself_cannot() -> None:
    explored, lattice = mapped(None), brief().lattice
    leg = lattice.flat((2, 1, 0, 0, 0)) // lattice.orientations, AXIS_STEPS.index((-1, 0, 0))
    east, north, up = explored.lattice.positions_enu_m[leg[0]].tolist()
    assert explored.open_edges()[leg]
    for aside, is_open in ((0.0, False), (0.9, True)):
        explored = mapped((east, north, up + aside))
        away = np.linalg.norm(explored._map.surface_points() - (east, north, up), axis=1)
        assert away.min() < explored.clearance
        assert explored.open_edges()[leg] == is_open
