"""`swarmscan missions export`: what a recorded run flew, as plans that can be flown again."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ground_station.cli import main
from ground_station.flown_plan import LOOP_M, TOLERANCE_M, straightened, without_loops
from ground_station.recorder import Recorder
from ground_station.report.run_data import read_run
from missions.camera import Pose
from missions.clock import SECOND_NS
from missions.frames import Site, wrap_pi
from missions.kml import NAMESPACE
from missions.mavlink import Route, Waypoint, plan_sha256, route_from_items
from missions.messages import SiteBrief, VehicleState
from missions.mission import FleetSpec, Mission, SiteSpec, SurveySpec
from missions.mission_file import write_mission
from missions.pads import geofence, hover_points, takeoff_points
from missions.qgc_plan import read_plan
from missions.run_folder import RunFolder, write_views
from missions.waypoint_file import read_waypoints

pytestmark = pytest.mark.xdist_group("plan_export")

BRIEF = SiteBrief(object_min_enu_m=(-5.0, -5.0, 0.0), object_max_enu_m=(5.0, 5.0, 10.0), ground_up_m=0.0)
MISSION = Mission(title="Tower <1>", fleet=FleetSpec(vehicles=2), survey=SurveySpec(settle_s=0.75, pass_m=0.3),
                  site=SiteSpec(origin_lat_deg=47.4, origin_lon_deg=8.55, origin_alt_m=488.0))
ANCHOR = Site(47.4, 8.55, 488.0)
STEP_M, STEP_S = 0.2, 0.1
AROUND = {1: [(-8.0, -8.0, 6.0), (-8.0, 8.0, 6.0)], 2: [(8.0, -8.0, 6.0), (8.0, 8.0, 6.0)]}
"""Corners that each vehicle flies around the tower; between the pads and the far side nothing is straight."""
FAR = {1: (-2.0, 8.5, 7.0), 2: (2.0, 8.5, 7.0)}
POCKET_M = 6.0
"""An exploration leg outwards and back, which the survey need not fly again."""


def flight(k: int, sorties: int) -> tuple[list[tuple[str, np.ndarray]], list[tuple[int, float]]]:
    """(mode, position) at every tenth of a second, and (sample, speed) of every survey picture."""
    pad, hover = (np.array(p(MISSION, BRIEF)[k - 1]) for p in (takeoff_points, hover_points))
    first, second, far = (np.array(p) for p in (*AROUND[k], FAR[k]))
    pocket = first + np.array([math.copysign(POCKET_M, first[0]), 0.0, 0.0])
    samples: list[tuple[str, np.ndarray]] = []
    pictures: list[tuple[int, float]] = []

    def go(mode: str, *corners: np.ndarray) -> None:
        for corner in corners:
            here = samples[-1][1] if samples else pad
            steps = max(1, round(float(np.linalg.norm(corner - here)) / STEP_M))
            samples.extend((mode, here + (corner - here) * n / steps) for n in range(1, steps + 1))

    for _ in range(sorties):
        go("standby", pad, pad, pad)
        go("takeoff", hover)
        go("mission", first, pocket, first)
        go("hold", *[first] * 5)
        go("mission", second)
        pictures.append((len(samples) - 1, 1.5))
        go("mission", far)
        pictures.append((len(samples) - 1, 0.0))
        go("return", second, first, hover)
        go("land", pad)
    go("standby", pad, pad)
    return samples, pictures


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run as the recorder leaves it: vehicle 1 flies one sortie, vehicle 2 two."""
    run = RunFolder(tmp_path_factory.mktemp("run"))
    write_mission(MISSION, run.mission)
    recorder, rows = Recorder(run, MISSION, BRIEF), []
    for k in (1, 2):
        samples, pictures = flight(k, sorties=k)
        for n, (mode, position) in enumerate(samples):
            recorder.tracks[k].add(VehicleState(
                vehicle_id=k, t_ns=round(n * STEP_S * SECOND_NS), position_enu_m=tuple(position),
                velocity_enu_m_s=(0, 0, 0), acceleration_enu_m_s2=(0, 0, 0), yaw_enu_rad=0.0, gimbal_elevation_rad=0.0,
                battery_percent=90.0, flying=mode != "standby", mode=mode))
        for i, (n, speed) in enumerate(pictures):
            pose = pose_of(10000 * k + i, tuple(samples[n][1]))
            rows.append([10000 * k + i, k, "survey", n * STEP_S, *pose.position_enu_m, *pose.quaternion_wxyz, speed,
                         f"pictures/UAV_{k}_{10000 * k + i}.jpg"])
    write_views(run.views_csv, rows)
    recorder.write(0)
    return run.root


def pose_of(view_id: int, position: tuple[float, float, float]) -> Pose:
    return Pose(position, wrap_pi(0.1 * (view_id % 60)), -0.2 - 0.1 * (view_id % 3))


def export(recorded: Path, capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, object]]:
    assert main(["missions", "export", str(recorded), "--json", *arguments]) == 0
    rows: list[dict[str, object]] = json.loads(capsys.readouterr().out)
    return rows


def views_of(route: Route) -> list[Waypoint]:
    return [w for w in route.waypoints if w.view_id is not None]


def off_the_path_m(point: np.ndarray, path: np.ndarray) -> float:
    """Distance from a point to a polyline."""
    a, way = path[:-1], np.diff(path, axis=0)
    along = np.clip(((point - a) * way).sum(1) / np.maximum((way**2).sum(1), 1e-12), 0, 1)
    return float(np.linalg.norm(a + along[:, None] * way - point, axis=1).min())


def test_every_sortie_becomes_a_plan_with_its_pictures(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = export(recorded, capsys)
    assert [(Path(str(r["file"])).name, r["vehicle"], r["sortie"], r["pictures"]) for r in rows] == [
        ("uav1_survey.plan", 1, 1, 2), ("uav2_survey.plan", 2, 1, 2), ("uav2_survey_sortie2.plan", 2, 2, 2)]
    found = {v.view_id: v for v in read_run(RunFolder(recorded)).views}
    seen = []
    for row in rows:
        route = route_from_items(read_plan(Path(str(row["file"]))).mission, ANCHOR, 1)
        assert (route.phase, route.home_after) == ("survey", True)
        for w in views_of(route):
            view = found[w.view_id or 0]
            pose = pose_of(view.view_id, w.position_enu_m)
            assert math.dist(w.position_enu_m, view.position_enu_m) < 0.012
            assert abs(wrap_pi(w.yaw_enu_rad - pose.yaw_enu_rad)) < 1e-5
            assert w.gimbal_elevation_rad == pytest.approx(pose.elevation_rad, abs=1e-6)
            standing = view.speed_m_s == 0
            assert (w.stop, w.settle_s, w.speed_m_s) == ((True, 0.75, 0.0) if standing else (False, 0.0, 1.5))
            seen.append(w.view_id)
    assert seen == [10000, 10001, 20000, 20001, 20002, 20003]


def test_the_way_is_the_flown_one_from_hover_to_hover_without_its_loops(
        recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for row in export(recorded, capsys):
        k = int(str(row["vehicle"]))
        flown = np.array([p for mode, p in flight(k, 1)[0] if mode in ("mission", "hold", "return")])
        way = np.array([w.position_enu_m for w in route_from_items(
            read_plan(Path(str(row["file"]))).mission, ANCHOR, 1).waypoints])
        hover = hover_points(MISSION, BRIEF)[k - 1]
        assert math.dist(way[0], hover) < STEP_M + 0.012
        assert math.dist(way[-1], hover) < 0.012
        dense = np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(way)])
        assert max(off_the_path_m(p, flown) for p in dense) < 0.5 * LOOP_M + TOLERANCE_M + 0.012
        assert max(off_the_path_m(np.array(c), way) for c in AROUND[k]) < LOOP_M + TOLERANCE_M + 0.012
        assert np.abs(way[:, 0]).max() < 8.0 + LOOP_M + TOLERANCE_M
        assert len(way) < 15


def test_home_is_the_pad_and_the_fence_the_mission_s(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lower, upper = geofence(MISSION, BRIEF)
    for row in export(recorded, capsys, "--vehicle", "2"):
        plan = read_plan(Path(str(row["file"])))
        assert math.dist(ANCHOR.enu_from_geodetic(plan.home.x / 1e7, plan.home.y / 1e7, plan.home.z),
                         takeoff_points(MISSION, BRIEF)[1]) < 0.012
        corners = np.array([ANCHOR.enu_from_geodetic(c.x / 1e7, c.y / 1e7, 0.0)[:2] for c in plan.fence])
        assert corners.min(axis=0) == pytest.approx(lower[:2], abs=0.012)
        assert corners.max(axis=0) == pytest.approx(upper[:2], abs=0.012)
        assert plan.rally == []


def test_waypoint_files_hold_the_same_items(recorded: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    export(recorded, capsys, "--vehicle", "1", "--format", "plan", "--out", str(tmp_path / "a.plan"))
    export(recorded, capsys, "--vehicle", "1", "--format", "waypoints", "--out", str(tmp_path / "a.txt"))
    a, b = read_plan(tmp_path / "a.plan"), read_waypoints(tmp_path / "a.txt")
    assert plan_sha256([a.home, *a.mission]) == plan_sha256([b.home, *b.mission])


def test_kml_shows_way_pictures_home_and_fence(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (row,) = export(recorded, capsys, "--vehicle", "1", "--format", "kml")
    root = ET.parse(str(row["file"])).getroot()
    name = {"k": NAMESPACE}
    assert root.findtext("k:Document/k:name", namespaces=name) == "Tower <1>: vehicle 1"
    marks = {m.findtext("k:name", namespaces=name): m for m in root.iter(f"{{{NAMESPACE}}}Placemark")}
    assert set(marks) == {"home", "way", "geofence", "10000", "10001"}
    lon, lat, alt = map(float, str(marks["10001"].findtext("k:Point/k:coordinates", namespaces=name)).split(","))
    assert math.dist(ANCHOR.enu_from_geodetic(lat, lon, alt), FAR[1]) < 0.012
    pose = pose_of(10001, FAR[1])
    assert f"gimbal pitch {math.degrees(pose.elevation_rad):.1f}°" in str(
        marks["10001"].findtext("k:description", namespaces=name))
    way = str(marks["way"].findtext("k:LineString/k:coordinates", namespaces=name)).split()
    plan = read_plan(Path(str(export(recorded, capsys, "--vehicle", "1")[0]["file"])))
    assert len(way) == sum(i.command == 16 for i in plan.mission)
    ring = str(marks["geofence"].findtext("k:Polygon/k:outerBoundaryIs/k:LinearRing/k:coordinates", namespaces=name))
    assert len(ring.split()) == 5
    assert ring.split()[0] == ring.split()[-1]


@pytest.mark.parametrize(("arguments", "told"), [
    (["--vehicle", "3"], "--vehicle 3: the run's vehicles are 1 to 2"),
    (["--phase", "explore"], "views.csv: holds no picture in phase 'explore'"),
    (["--out", "a.plan"], "--out a.plan: there are 3 plans"),
    (["--vehicle", "2", "--out", "a.plan"], "--out a.plan: there are 2 plans"),
    (["--vehicle", "1", "--out", "nowhere/a.plan"], "nowhere/a.plan: cannot be written"),
    (["--vehicle", "1", "--format", "kml", "--out", "nowhere/a.kml"], "nowhere/a.kml: cannot be written"),
])
def test_what_cannot_be_exported_is_refused_in_one_sentence(
        recorded: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], told: str) -> None:
    assert main(["missions", "export", str(recorded), *arguments]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("missing", ["mission.toml", "flight.json", "trajectories.npz", "views.csv"])
def test_a_folder_that_holds_no_flight_is_refused(
        recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], missing: str) -> None:
    for name in {"mission.toml", "flight.json", "trajectories.npz", "views.csv"} - {missing}:
        (tmp_path / name).write_bytes((recorded / name).read_bytes())
    assert main(["missions", "export", str(tmp_path)]) == 2
    assert missing in capsys.readouterr().err


paths = st.integers(2, 40).flatmap(lambda n: arrays(np.float64, (n, 3), elements=st.floats(-5, 5)))


@given(path=paths)
def test_straightened_ways_leave_no_point_by_more_than_the_tolerance(path: np.ndarray) -> None:
    way = straightened(path)
    assert np.array_equal(way[[0, -1]], path[[0, -1]])
    assert max(off_the_path_m(p, way) for p in path) <= TOLERANCE_M + 1e-9


@given(path=paths)
def test_without_loops_no_place_is_passed_twice_and_no_jump_is_new(path: np.ndarray) -> None:
    way = without_loops(path)
    assert np.array_equal(way[[0, -1]], path[[0, -1]])
    legs = {tuple(np.concatenate(leg)) for leg in pairwise(path)}
    for leg in pairwise(way):
        assert tuple(np.concatenate(leg)) in legs or np.linalg.norm(leg[1] - leg[0]) <= LOOP_M + 1e-9
    for i in range(len(way) - 2):
        assert np.linalg.norm(way[i + 2:] - way[i], axis=1).min() > LOOP_M - 1e-9
