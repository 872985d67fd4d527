"""The page's part on exploration, and the log that it is drawn from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from ground_station.exploration_log import ExplorationLog
from ground_station.report.charts import coverage_curve
from ground_station.report.exploration import brought, depth_section, exploration_part, explored_map, gains
from ground_station.report.run_data import RunData, read_run
from missions.camera import Camera, Pose
from missions.mission import Mission
from missions.mission_file import write_mission
from missions.run_folder import RunFolder, write_views
from perception.evaluate.true_depth import depths_of_mesh
from planning.nbv.coverage import SurfaceTally
from planning.nbv.stopping import Price

WALL = np.array([[10.0, -20.0, -20.0], [10.0, 20.0, -20.0], [10.0, 20.0, 20.0], [10.0, -20.0, 20.0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
SHAPE = (16, 28)


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """Two legs of two pictures each before a wall, 10 and 6 m away."""
    run = RunFolder(tmp_path)
    write_mission(Mission(title="wall"), run.mission)
    rows = []
    for view_id, x in ((1, 0.0), (2, 0.0), (3, 4.0), (4, 4.0)):
        q = Pose((x, 0.0, 0.0), 0.0, 0.0).quaternion_wxyz
        rows.append([view_id, 1 + view_id // 3, "explore", float(view_id), x, 0.0, 0.0, *q, 0.0, f"{view_id}.jpg"])
    write_views(run.views_csv, rows)
    trimesh.Trimesh(WALL, TRIANGLES, process=False).export(run.truth_mesh)
    run.referee.write_text(json.dumps({"coverage": {
        "final": 0.6, "ceiling": 0.8, "auc": 0.4, "per_view": [0.1, 0.3, 0.4, 0.6], "view_ids": [1, 2, 3, 4]}}))
    run.flight.write_text(json.dumps({"exploration": {
        "views": [{"view_id": 2, "vehicle_id": 1, "pictures": 2, "predicted_m2": 50.0, "achieved_m2": 40.0,
                   "coverage": 0.4},
                  {"view_id": 4, "vehicle_id": 2, "pictures": 2, "predicted_m2": 20.0, "achieved_m2": 30.0,
                   "coverage": 0.7}],
        "coverage": 0.7, "ended": "<nothing> pays", "seen_m2": 70.0, "missing_m2": 30.0}}))
    np.savez(run.map, surface_position_enu_m=np.random.default_rng(0).random((50, 3)))
    depth = np.stack([np.full(SHAPE, d) for d in (10.0, 6.6)])
    depth[:, :4] = np.nan
    np.savez(run.explore_depth, view_id=np.array([2, 4]), depth_m=depth.astype(np.float16))
    return run


def read(run: RunFolder) -> tuple[RunData, dict[str, object]]:
    data = read_run(run)
    return data, data.referee.get("coverage") or {}


def test_gains_stand_in_shares_of_what_can_be_seen_beside_the_true_ones(run: RunFolder) -> None:
    first, second = brought(*read(run))
    assert (first.predicted, first.achieved, first.true) == pytest.approx((0.5, 0.4, 0.3 / 0.8))
    assert (second.predicted, second.achieved, second.true) == pytest.approx((0.2, 0.3, 0.3 / 0.8))
    figure = gains([first, second])
    assert figure is not None
    assert [trace.name for trace in figure.data] == ["brought, by the map", "promised", "truly brought"]


def test_without_truth_the_gains_of_the_map_stay(run: RunFolder) -> None:
    run.referee.unlink()
    views = brought(*read(run))
    assert [v.true for v in views] == [None, None]
    figure = gains(views)
    assert figure is not None
    assert len(figure.data) == 2


def test_the_map_shows_every_chosen_view(run: RunFolder) -> None:
    data, coverage = read(run)
    figure = explored_map(data, brought(data, coverage))
    assert figure is not None
    texts = [text for trace in figure.data for text in trace.text or ()]
    assert [text.split(",")[0] for text in texts] == ["view 2", "view 4"]


def test_depth_stands_beside_what_the_mesh_has(run: RunFolder) -> None:
    text = depth_section(read(run)[0])
    assert text.count("<img") == 6
    assert "75.0 % of the object answered, 100.0 % of that within 5%" in text
    assert "75.0 % of the object answered, 0.0 % of that within 5%" in text
    run.truth_mesh.unlink()
    assert depth_section(read(run)[0]).count("<img") == 4


def test_the_part_tells_how_exploration_ended(run: RunFolder) -> None:
    text = exploration_part(*read(run))
    assert "the ground station believed 70.0 % of it covered; 75.0 % was." in text
    assert "Exploration ended because &lt;nothing&gt; pays." in text


def test_a_run_without_exploration_has_no_such_part(run: RunFolder) -> None:
    for path in (run.flight, run.map, run.explore_depth):
        path.unlink()
    assert exploration_part(*read(run)) == ""


def test_the_estimate_stands_where_its_picture_stands(run: RunFolder) -> None:
    figure = coverage_curve(read(run)[1], {2: 0.4, 4: 0.7, 99: 1.0})
    assert figure is not None
    assert (list(figure.data[1].x), list(figure.data[1].y)) == ([2, 4], [0.4, 0.7])


def test_depth_of_a_wall_is_that_along_the_optical_axis() -> None:
    camera = Camera.from_diagonal_fov(28, 16, 80.0)
    pose, away = Pose((1.0, 2.0, 3.0), 0.0, 0.0), Pose((1.0, 2.0, 3.0), np.pi, 0.0)
    depth, nothing = depths_of_mesh(WALL, TRIANGLES, camera, [np.array(p.position_enu_m) for p in (pose, away)],
                                    [p.enu_from_camera for p in (pose, away)])
    np.testing.assert_allclose(depth, np.full(SHAPE, 9.0), rtol=1e-5)
    assert np.isinf(nothing).all()


@given(st.lists(st.tuples(st.floats(0.0, 50.0), st.integers(1, 3)), min_size=1, max_size=20))
def test_what_views_brought_sums_up_to_what_was_seen(steps: list[tuple[float, int]]) -> None:
    log, seen_m2, view_id = ExplorationLog(), 0.0, 0
    for rise_m2, arrivals in steps:
        for _ in range(arrivals):
            view_id += 4
            log.given(view_id, 1, 4, 2.0, 5.0)
            log.arrived(view_id)
        seen_m2 += rise_m2
        log.settle(SurfaceTally(seen_m2, 1.0))
    document = log.document()
    assert [v["view_id"] for v in document["views"]] == list(range(4, view_id + 1, 4))
    assert sum(v["achieved_m2"] for v in document["views"]) == pytest.approx(seen_m2, abs=0.01 * view_id)
    assert log.returns.flown_m == pytest.approx(5.0 * view_id / 4)


def test_views_under_way_have_brought_nothing_and_unknown_pictures_are_nobody_s() -> None:
    log = ExplorationLog()
    log.given(4, 1, 4, 2.0, 5.0)
    log.arrived(3)
    log.settle(SurfaceTally(10.0, 0.0))
    assert log.document()["views"] == []
    assert log.document()["coverage"] == 1.0


def test_what_is_not_worth_its_flight_is_told_as_the_end() -> None:
    log = ExplorationLog()
    for view_id in range(4, 84, 4):
        log.given(view_id, 1, 4, 10.0, 5.0)
        log.arrived(view_id)
        log.settle(SurfaceTally(2.5 * view_id, 1.0))
    assert log.worth([10.0], [5.0], Price(m2_per_m=1.9))
    assert log.ended == ""
    assert not log.worth([10.0], [5.0], Price(m2_per_m=2.1))
    assert log.ended == "no way was worth its flight: 2.00 m² per metre were expected, after 2.00 on average"
    assert log.worth([10.0], [5.0], Price(m2_per_m=0.0))
    assert log.ended == ""
