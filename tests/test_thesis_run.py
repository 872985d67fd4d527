"""The thesis's experiment on a run folder: the command, the waypoints file, the page; and its legs in flight."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ground_station.airspace import Airspace
from ground_station.explore import Explorer
from ground_station.ingest import Picture
from ground_station.prior import Prior
from ground_station.report.run_data import read_run
from ground_station.report.thesis_page import thesis_part
from ground_station.report.thesis_run import plan_run
from ground_station.thesis_airspace import ThesisAirspace
from ground_station.thesis_command import main
from ground_station.thesis_tours import ThesisTours
from ground_station.tours import Flyer, Flying
from missions.camera import Pose, View
from missions.errors import UserError
from missions.messages import PictureMeta, SiteBrief
from missions.mission import BatterySpec, ExploreSpec, Mission, SurveySpec
from missions.mission_file import write_mission
from missions.run_folder import VIEW_COLUMNS, RunFolder
from missions.simulation import SceneSpec
from planning.paths import NoPath
from planning.paths.thesis_boxes import hit_triangles

BOX = trimesh.creation.box(extents=(8.0, 6.0, 7.0)).apply_translation((0.0, 0.0, 3.5))
SITE = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)
MISSION = Mission(title="t", scene=SceneSpec(name="bridge"), battery=BatterySpec(model="distance", percent_per_m=1.0),
                  survey=SurveySpec(method="thesis", views="frames", max_views=60))


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """Exploration pictures of two vehicles around a box, 45 on one side and 15 on the other."""
    folder = RunFolder(tmp_path / "run")
    folder.root.mkdir()
    write_mission(MISSION, folder.mission)
    BOX.export(folder.truth_mesh)
    rng = np.random.default_rng(1)
    places = np.concatenate([rng.uniform([-12, -9, 2], [-5, 9, 9], (45, 3)),
                             rng.uniform([5, -9, 2], [9, 9, 9], (15, 3))])
    rows = [f"{i + 1},{1 + i % 2},explore,{i},{x},{y},{z},1,0,0,0,0,p.jpg" for i, (x, y, z) in enumerate(places)]
    folder.views_csv.write_text("\n".join([",".join(VIEW_COLUMNS), *rows]) + "\n", encoding="utf-8")
    return folder


def test_the_command_stops_where_it_is_told_and_keeps_every_view(run: RunFolder, tmp_path: Path,
                                                                 capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(run.root), "--stop-at", "40", "--npz", str(tmp_path / "w.npz"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told) == {"distance", "distance_elevation"}
    vehicles = told["distance"]["vehicles"]
    assert sorted(v["views"] for v in vehicles.values()) == [15, 45]
    busy, free = sorted(vehicles.values(), key=lambda v: -v["views"])
    assert busy["stop_index"] == 40
    assert busy["stop_percent"] == pytest.approx(19.88)
    assert sorted(free["taken_over"] + told["distance"]["left_over"]) == sorted(busy["handed_over"])
    assert busy["optimised_m"] < busy["original_m"]
    with np.load(tmp_path / "w.npz") as stored:
        seen = stored["view_id"][stored["view_id"] >= 0]
        assert sorted([*seen, *told["distance"]["left_over"]]) == list(range(60))
        assert stored["position_enu_m"].shape == (len(stored["view_id"]), 3)
        moved = stored["origin_vehicle"] != stored["current_vehicle"]
        assert sorted(stored["view_id"][moved & (stored["view_id"] >= 0)]) == sorted(free["taken_over"])
        for k in (1, 2):
            assert list(stored["sequence"][stored["current_vehicle"] == k]) == list(range(
                int((stored["current_vehicle"] == k).sum())))


def test_the_table_holds_the_thesis_beside_the_run(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(run.root), "--stop-at", "40"]) == 0
    lines = {line.split("│")[1].strip(): line for line in capsys.readouterr().out.splitlines() if line.startswith("│")}
    assert re.findall(r"\d+\.\d\d", lines["level there (%)"])[:2] == ["19.88", "19.88"]
    assert [c.strip() for c in lines["stops at waypoint"].split("│")[2:4]] == ["40", "210"]


@pytest.mark.parametrize(("arguments", "words"), [(["--stop-at", "99"], "stop index 99"), (["--stop-at", "0"], "1 to")])
def test_an_index_beyond_the_tour_is_refused(run: RunFolder, arguments: list[str], words: str) -> None:
    with pytest.raises(UserError, match=words):
        main([str(run.root), *arguments])


def test_a_file_of_views_is_planned_as_it_stands(run: RunFolder, tmp_path: Path,
                                                 capsys: pytest.CaptureFixture[str]) -> None:
    heaps = np.concatenate([np.random.default_rng(2).uniform(0.0, 9.0, (30, 3)), np.full((4, 3), 40.0)])
    np.savez(tmp_path / "v.npz", a=np.concatenate([np.zeros((5, 3)), heaps]), b=heaps)
    asked = [str(tmp_path / "v.npz"), "--key", "a", "--skip", "5", "--stop-at", "25", "--json"]
    assert main(asked) == 0
    told = json.loads(capsys.readouterr().out)["distance"]
    assert told["views"] == 34
    busy = max(told["vehicles"].values(), key=lambda v: v["views"])
    assert (busy["views"], busy["stop_index"], len(busy["handed_over"])) == (30, 25, 5)


@pytest.mark.parametrize(("arguments", "words"), [
    (["x", "--stop-at", "3"], "no such run folder or file"), (["v.npz"], "knows no battery"),
    (["v.npz", "--stop-at", "3", "--skip", "9"], "leave views"),
    (["v.npz", "--stop-at", "3", "--vehicles", "0"], "at least 1")])
def test_bad_calls_say_what_to_give(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str],
                                    words: str) -> None:
    monkeypatch.chdir(tmp_path)
    np.savez("v.npz", a=np.arange(27.0).reshape(9, 3))
    with pytest.raises(UserError, match=words):
        main(arguments)


def test_a_run_without_pictures_says_what_to_fly(run: RunFolder) -> None:
    run.views_csv.unlink()
    with pytest.raises(UserError, match="fly the mission's explore phase"):
        plan_run(read_run(run))


def test_the_page_shows_every_figure_and_writes_the_waypoints(run: RunFolder) -> None:
    part = thesis_part(read_run(run))
    for figure in ("5.7", "5.8", "4.10", "5.9", "5.10 top", "5.10 bottom", "5.11"):
        assert f"(Figure {figure})" in part
    assert part.count("plotly-graph-div") == 7
    assert run.thesis_waypoints.is_file()


def test_other_missions_have_no_such_part(run: RunFolder) -> None:
    write_mission(Mission(title="t"), run.mission)
    assert thesis_part(read_run(run)) == ""
    assert not run.thesis_waypoints.exists()


def test_tours_of_the_plan_do_not_meet_the_structure(run: RunFolder) -> None:
    triangles = np.asarray(BOX.triangles)
    for plan in plan_run(read_run(run)).plans.values():
        for tour in plan.tours.values():
            assert tour.own.refused == {}
            assert not any(len(hit_triangles(a, b, triangles)) for a, b in pairwise(tour.own.points_enu_m))


def test_legs_in_flight_lead_around_the_model_with_the_vehicles_clearance() -> None:
    mission = Mission(title="t", knowledge="mesh", explore=ExploreSpec(enabled=False),
                      survey=SurveySpec(method="thesis"))
    prior = Prior.of(BOX, mission, SITE)
    plain = Airspace.of(prior.grid, mission, SITE, prior)
    space = ThesisAirspace.with_prior(plain, prior, mission)
    left, right, mate = np.array([-6.5, 0.0, 4.0]), np.array([6.5, 1.0, 4.0]), np.array([-6.5, 4.0, 4.0])
    for mates in ([], [mate]):
        path = space.path(left, right, mates)
        assert path is not None
        again = space.path(left, right, mates)
        assert again is not None
        assert np.array_equal(path, again)
        assert plain.around(left, mates).segments_clear(path[:-1], path[1:], mission.fleet.clearance_m).all()
    with pytest.raises(NoPath, match="goal occupied"):
        space.path(left, np.array([0.0, 0.0, 3.0]), [])


def test_every_exploration_picture_can_be_a_view() -> None:
    mission = Mission(title="t")
    explorer = Explorer(mission, SITE)
    camera = mission.camera.explore_camera()
    black = np.zeros((camera.height_px, camera.width_px, 3), dtype=np.uint8)
    for view_id, vehicle_id in ((1, 2), (2, 1), (3, 2), (4, 1)):
        meta = PictureMeta(vehicle_id=vehicle_id, view_id=view_id, phase="explore", t_capture_ns=0,
                           pose=Pose((float(view_id), 9.0, 3.0), 0.0, 0.0), position_sigma_m=0.0, speed_m_s=0.0,
                           camera=camera, sha256="", size_bytes=0)
        explorer.add(Picture(meta, black))
    assert [p.position_enu_m[0] for p in explorer.poses(every_picture=True)] == [2.0, 4.0, 1.0, 3.0]
    assert explorer.poses(every_picture=False) == []


def test_views_are_handed_over_in_the_order_of_the_tour_and_down_to_the_threshold() -> None:
    mission = Mission(title="t", battery=BatterySpec(model="distance", percent_per_m=1.0))
    places = [(float(x), 0.0, 5.0) for x in (9, 3, 6, 0, 12, 40, 43)]
    method = ThesisTours([View(100 + i, Pose(p, 0.0, 0.0)) for i, p in enumerate(places)], mission)
    pads = [np.array([0.0, 0.0, 5.0]), np.array([45.0, 0.0, 5.0])]
    tour = method.begin([Flyer(k, pad, pad, 80.0) for k, pad in enumerate(pads, start=1)]).sorties[1][0]
    assert tour == [103, 104, 100, 102, 101]
    for usable_percent, taken in ((28.0 + 9.0, 4), (28.0 + 6.0, 3), (27.0, 0)):
        receiver = Flyer(2, np.array([40.0, 0.0, 5.0]), pads[1], usable_percent)
        then = method.again([receiver], Flying({2: [[]]}, {}, sorted(tour[1:]), {}, {1: 1, 2: 2}))
        assert then.sorties[2][0] == tour[1 : 1 + taken]
        assert set(then.left_over) == set(tour[1 + taken :])
