"""What is known of one side of a thing tells of the other side, if the thing has been alike so far."""

from __future__ import annotations

import numpy as np
import pytest

from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from perception.imagination.symmetry import evidence

LOW, HIGH = np.array([-10.0, -6.0, 0.0]), np.array([10.0, 6.0, 8.0])


def columns(east_m: list[float], known_until_north_m: float) -> VoxelGrid:
    """Free space with columns across from end to end, each at a distance east, in pairs at both sides of the middle
    plane or not; the northern rest is unknown."""
    grid = VoxelGrid.unknown(LOW, HIGH, 0.5)
    index = np.stack(np.meshgrid(*map(np.arange, grid.state.shape), indexing="ij"), axis=-1)
    east, north, _ = np.moveaxis(grid.centers(index), -1, 0)
    grid.state[...] = np.where(np.min([np.abs(east - at) for at in east_m], axis=0) <= 0.75, OCCUPIED, FREE)
    grid.state[(north > known_until_north_m) & (east > 0.0)] = UNKNOWN
    return grid


def told(grid: VoxelGrid) -> tuple[np.ndarray, np.ndarray]:
    """Evidence for unknown voxels whose mirror image in the plane between east and west is solid, or free."""
    index = np.stack(np.nonzero(grid.state == UNKNOWN))
    far = index[:, np.abs(grid.centers(index.T)[:, 0]) > 2.0]
    image = grid.state[::-1][tuple(far)]
    odds = evidence(grid, far, LOW, HIGH)
    return odds[image == OCCUPIED], odds[image == FREE]


def test_what_is_seen_on_one_side_is_expected_on_the_other() -> None:
    solid, free = told(columns([-7.0, -3.0, 3.0, 7.0], 0.0))
    assert len(solid)
    assert len(free)
    assert solid.min() > 1.0
    assert np.median(free) < -0.1


def test_what_has_not_been_alike_so_far_tells_next_to_nothing() -> None:
    grid, rng = columns([-30.0], 3.0), np.random.default_rng(1)
    blocks = np.repeat(np.repeat(rng.random((10, 6, 16)) < 0.2, 4, axis=0), 4, axis=1)
    grid.state[:40, :24, :16] = np.where(grid.state[:40, :24, :16] == UNKNOWN, UNKNOWN,
                                         np.where(blocks, OCCUPIED, FREE))
    assert np.abs(np.concatenate(told(grid))).max() < 0.2


@pytest.mark.parametrize("state", [UNKNOWN, FREE])
def test_a_map_without_pairs_tells_nothing(state: int) -> None:
    grid = VoxelGrid.unknown(LOW, HIGH, 0.5)
    grid.state[...] = state
    index = np.array([[2], [2], [2]])
    assert evidence(grid, index, LOW, HIGH).tolist() == pytest.approx([0.0], abs=1e-3)
