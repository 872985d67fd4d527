"""What vehicles have hit keeps the ground's ways clear, and nothing else does."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ground_station.airspace import Airspace
from ground_station.obstacles import MEMORY_NS, SeenObstacles
from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from missions.messages import RangeHits, SiteBrief
from missions.mission import Mission
from missions.pads import geofence
from missions.sensors import HIT_RADIUS_M
from planning.paths import VoxelField

SITE = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)
MISSION = Mission(title="t")
coordinates = st.floats(0.0, 4.0)
points = st.tuples(coordinates, coordinates, coordinates)


def heard(hits: list[tuple[float, float, float]], t_ns: int = 0) -> SeenObstacles:
    seen = SeenObstacles()
    seen.hear(RangeHits(t_ns=t_ns, points_enu_m=hits))
    return seen


def cable() -> list[tuple[float, float, float]]:
    """Upright, between where vehicles fly and where they want to go."""
    return [(0.0, -8.0, z) for z in np.arange(0.0, 12.0, 0.2).tolist()]


def open_grid() -> VoxelGrid:
    grid = VoxelGrid.unknown(*geofence(MISSION, SITE), 0.5)
    grid.state[:] = FREE
    return grid


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(points, min_size=1, max_size=20, unique=True), points)
def test_ways_keep_as_clear_of_hits_as_vehicles_do(seed: int, hits: list[tuple[float, float, float]],
                                                   place: tuple[float, float, float]) -> None:
    """Whatever was hit, but for the newest of each cell and for what the map knows to be solid."""
    state = np.random.default_rng(seed).choice([UNKNOWN, FREE, OCCUPIED], (8, 8, 8), p=[0.1, 0.8, 0.1])
    grid = VoxelGrid(np.zeros(3), 0.5, state.astype(np.uint8))
    kept = heard(hits).unmapped(grid, 0)
    room = float(VoxelField.from_grid(grid).with_spheres(kept, HIT_RADIUS_M).clearance_m(np.array(place))[0])
    newest = {tuple(np.floor(np.array(h) / 0.25)): np.array(h) for h in hits}
    for hit in newest.values():
        if not any(grid.state_at(hit + d) == OCCUPIED for d in 1e-3 * np.array([[a, b, c] for a in (-1, 1)
                                                                                for b in (-1, 1) for c in (-1, 1)])):
            assert room <= max(0.0, np.linalg.norm(hit - place) - HIT_RADIUS_M) + 1e-6


def test_a_way_leads_around_a_cable_that_no_picture_shows() -> None:
    start, goal, line = np.array([-8.0, -8.0, 5.0]), np.array([8.0, -8.0, 5.0]), np.array(cable())
    plain = Airspace.of(open_grid(), MISSION, SITE)
    space = Airspace.of(open_grid(), MISSION, SITE, hits_enu_m=heard(cable()).unmapped(open_grid(), 0))
    assert len(plain.path(start, goal, [])) == 2
    way = space.path(start, goal, [])
    fine = np.concatenate([a + np.linspace(0.0, 1.0, 200)[:, None] * (b - a) for a, b in itertools.pairwise(way)])
    away = np.linalg.norm(fine[:, None] - line, axis=2).min()
    assert away >= MISSION.fleet.clearance_m + HIT_RADIUS_M
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).sum() < 17.0


def test_what_is_solid_in_the_map_or_long_gone_is_left_out() -> None:
    grid = open_grid()
    grid.state[tuple(grid.index(np.array([0.0, -8.0, 5.1])))] = OCCUPIED
    kept = heard(cable(), t_ns=7).unmapped(grid, 7 + MEMORY_NS)
    assert not np.any(grid.state_at(kept) == OCCUPIED)
    assert 0 < len(kept) < len(heard(cable()).unmapped(open_grid(), 0))
    assert len(heard(cable(), t_ns=7).unmapped(grid, 8 + MEMORY_NS)) == 0


@pytest.mark.parametrize("again_ns", [0, MEMORY_NS])
def test_what_is_hit_again_is_remembered_from_then_on(again_ns: int) -> None:
    seen = heard(cable())
    seen.hear(RangeHits(t_ns=again_ns, points_enu_m=cable()))
    assert (len(seen.unmapped(open_grid(), MEMORY_NS + 1)) > 0) == (again_ns > 0)
