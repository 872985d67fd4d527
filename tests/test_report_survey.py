"""The page's part on the survey: what its pictures show of the explored surface."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from ground_station.report.run_data import read_run
from ground_station.report.survey import COLOURS, by_pictures, shown, survey_part
from missions.camera import Pose
from missions.grid import FREE, OCCUPIED, VoxelGrid
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.mission_file import write_mission
from missions.run_folder import RunFolder, write_views

SITE = SiteBrief(object_min_enu_m=(8.0, -2.0, 0.0), object_max_enu_m=(10.0, 2.0, 6.0), ground_up_m=0.0)


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """A wall that faces west, four pictures of it from there and one that looks away."""
    run = RunFolder(tmp_path)
    write_mission(Mission(title="wall"), run.mission)
    grid = VoxelGrid.unknown(np.array([-2.0, -8.0, 0.0]), np.array([14.0, 8.0, 10.0]), 0.5)
    grid.state[:] = FREE
    low, high = (grid.index(np.array(p)) for p in ((8.6, -1.9, 0.0), (8.9, 1.9, 5.9)))
    grid.state[low[0]:high[0] + 1, low[1]:high[1] + 1, low[2]:high[2] + 1] = OCCUPIED
    np.savez(run.map, origin_enu_m=grid.origin_enu_m, voxel_m=grid.voxel_m, state=grid.state)
    rows = []
    for n, (y, yaw) in enumerate([(-3.0, 0.3), (-1.0, 0.0), (1.0, 0.0), (3.0, -0.3), (0.0, np.pi)]):
        q = Pose((1.0, y, 3.0), float(yaw), 0.0).quaternion_wxyz
        rows.append([10001 + n, 1, "survey", float(n), 1.0, y, 3.0, *q, 0.0, f"{n}.jpg"])
    write_views(run.views_csv, rows)
    run.flight.write_text(json.dumps({"site": msgspec.to_builtins(SITE)}))
    return run


def test_pictures_are_counted_where_they_show_the_surface(run: RunFolder) -> None:
    found = shown(read_run(run))
    assert found is not None
    west, east = (found.patches.normal_enu[:, 0] == side for side in (-1.0, 1.0))
    assert west.sum() > 10
    assert (found.pictures[west] == 4).all()
    assert (found.pictures[east] == 0).all()


def test_the_page_shows_it_from_every_side_in_the_colours_of_the_key(run: RunFolder) -> None:
    found = shown(read_run(run))
    assert found is not None
    pictures = by_pictures(found)
    assert len(pictures) == 3
    assert all((picture == np.array(COLOURS[n], dtype=np.uint8)).all(axis=2).any()
               for n, picture in ((4, pictures[0][1]), (0, pictures[1][1])))
    part = survey_part(read_run(run))
    assert "in 3 or more" in part
    assert part.count("<img") == 3


@pytest.mark.parametrize("missing", ["map", "views_csv", "flight"])
def test_without_map_pictures_or_site_there_is_no_such_part(run: RunFolder, missing: str) -> None:
    getattr(run, missing).unlink()
    assert survey_part(read_run(run)) == ""
