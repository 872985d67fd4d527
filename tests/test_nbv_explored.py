"""What a method knows of the space around the lattice: which voxels are the object's, and where it may fly."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ground_station.nbv.explored import Explored
from missions.nbv_trial import Frame
from missions.pose_lattice import AXIS_STEPS
from tests.test_wires import brief, grass


def test_a_leg_that_was_flown_is_open_both_ways() -> None:
    explored, lattice = Explored(brief()), brief().lattice
    a, b = (lattice.flat((1, 1, k, 0, 0)) // lattice.orientations for k in (0, 1))
    up, down = AXIS_STEPS.index((0, 0, 1)), AXIS_STEPS.index((0, 0, -1))
    from_, to = (1, 1, 0, 0, 0), (1, 1, 1, 0, 0)
    explored.see(Frame(vehicle=1, pose=lattice.pose(from_), index=None, rgb=grass(0)))
    assert not explored.known_free_edges()[a, up]
    explored.see(Frame(vehicle=1, pose=lattice.pose(to), index=to, rgb=grass(0)))
    for edges in (explored.open_edges(), explored.known_free_edges()):
        assert edges[a, up]
        assert edges[b, down]


@pytest.mark.parametrize("beyond_m", [0.0, 0.04, 0.06, 0.3, 0.46, 0.49])
def test_a_voxel_belongs_to_the_box_unless_it_hardly_reaches_into_it(beyond_m: float) -> None:
    low, high = np.array([7.0 - beyond_m, -9.0, 0.0]), np.array([18.0 + beyond_m, 9.0, 12.0])
    explored = Explored(msgspec.structs.replace(brief(), object_min_enu_m=tuple(low), object_max_enu_m=tuple(high)))
    grid, inside = explored.grid, np.zeros(explored.grid.state.shape, dtype=np.bool_)
    inside[explored.inside_object_box()] = True
    voxels = np.argwhere(np.ones_like(inside))
    lower = grid.origin_enu_m + voxels * grid.voxel_m
    reaches_m = np.minimum(lower + grid.voxel_m, high) - np.maximum(lower, low)
    belongs = (reaches_m > 0.1 * grid.voxel_m + 1e-9).all(axis=1)
    np.testing.assert_array_equal(inside.ravel(), belongs)
