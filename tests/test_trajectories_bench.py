"""`swarmscan bench trajectories`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ground_station.bench import trajectories
from missions.errors import UserError
from missions.mission import Mission
from missions.mission_file import write_mission
from missions.run_folder import RunFolder, write_views


def test_passing_views_is_quicker_than_stopping_and_about_as_quick_as_predicted() -> None:
    tour = trajectories.measured(trajectories.task_around_a_box(16, seed=1), seed=1)
    assert tour.views == 16
    assert tour.passing_s < 0.9 * tour.stopping_unsettled_s
    assert tour.stopping_s == pytest.approx(tour.stopping_unsettled_s + 15 * 0.5, abs=1e-6)
    assert abs(tour.error) < 0.1


def test_a_run_is_read_from_its_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, task = RunFolder(tmp_path), trajectories.task_around_a_box(6, seed=2)
    write_mission(Mission(title="test"), run.mission)
    np.savez(run.map, origin_enu_m=task.grid.origin_enu_m, voxel_m=task.grid.voxel_m, state=task.grid.state)
    write_views(run.views_csv, [[n + 1, 1, "survey", 0.0, *p.position_enu_m, *p.quaternion_wxyz, 0.0, ""]
                                for n, p in enumerate(task.poses)])
    assert trajectories.main([str(tmp_path), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["views"] == 6
    assert row["passing_s"] < row["stopping_s"]


def test_what_cannot_be_measured_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="nothing to measure"):
        trajectories.main([])
    write_mission(Mission(title="test"), RunFolder(tmp_path).mission)
    with pytest.raises(UserError, match=r"map\.npz is missing"):
        trajectories.main([str(tmp_path)])
