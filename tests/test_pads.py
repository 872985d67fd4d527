"""Limits that everybody derives from mission and site."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ground_station.survey_views import survey_views
from missions.errors import UserError
from missions.grid import FREE, MOST_VOXELS, OCCUPIED, VoxelGrid
from missions.messages import SiteBrief
from missions.mission import ExploreSpec, Mission
from missions.pads import geofence, surface_box

SITE = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)


@given(st.floats(-5, 5), st.floats(0.01, 60), st.floats(-3, 3), st.floats(0.2, 1.0))
def test_surface_begins_above_the_ground_and_is_never_empty(low: float, tall: float, ground: float,
                                                            voxel: float) -> None:
    site = SiteBrief(object_min_enu_m=(-1.0, -1.0, low), object_max_enu_m=(1.0, 1.0, low + tall), ground_up_m=ground)
    lower, upper = surface_box(Mission(title="t", explore=ExploreSpec(voxel_m=voxel)), site)
    assert lower[2] < upper[2] == low + tall
    assert lower[:2].tolist() == [-1.0, -1.0]
    assert lower[2] - 0.5 * voxel >= ground + voxel - 1e-9 or lower[2] == upper[2] - voxel


def test_a_grid_that_does_not_fit_is_refused_and_the_remedy_fits() -> None:
    lower, upper = np.zeros(3), np.array([1500.0, 900.0, 200.0])
    with pytest.raises(UserError, match=r"explore\.voxel_m = 0\.5 .* 1500 x 900 x 200 m") as refused:
        VoxelGrid.unknown(lower, upper, 0.5)
    voxel_m = float(str(refused.value).rsplit("raise it to ", 1)[1].split()[0])
    assert VoxelGrid.unknown(lower, upper, voxel_m).state.size <= MOST_VOXELS


def test_the_survey_takes_no_pictures_of_bare_ground() -> None:
    mission = Mission(title="t")
    grid = VoxelGrid.unknown(*geofence(mission, SITE), 0.5)
    grid.state[:] = FREE
    grid.state[:, :, 0] = OCCUPIED
    start = [np.array([0.0, -12.0, 4.0])]
    assert survey_views(mission, SITE, grid, [], start) == []
    wall = grid.index(np.array([-3.0, 0.0, 0.6]))
    grid.state[wall[0]:wall[0] + 12, wall[1], 1:9] = OCCUPIED
    assert len(survey_views(mission, SITE, grid, [], start)) > 4
