"""The stages after a flight on a small run folder: cloud, numbers and page, complete or with parts missing."""

from __future__ import annotations

import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import trimesh
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from ground_station import stages
from ground_station.after_flight import run_stages
from ground_station.bench import reconstruct_growth
from ground_station.reconstruction import reconstruct_run
from ground_station.report import tiles, time_charts
from ground_station.report.activity import spans
from ground_station.report.measure import measure
from ground_station.report.metrics import assemble
from ground_station.report.page import draw, page
from ground_station.report.run_data import Track, read_run, read_views
from ground_station.report.separation import nearest_pairs
from ground_station.report.splat import ramp, splat
from missions.errors import UserError
from missions.frames import quaternion_from_matrix
from missions.mission import CameraSpec, Mission, ReconstructSpec, SiteSpec, SurveySpec
from missions.mission_file import load_mission, write_mission
from missions.run_folder import RunFolder, write_views
from perception.reconstruct.cloud import Cloud, write_cloud
from tests.reconstruct_scene import survey, wall_and_box

pytestmark = pytest.mark.xdist_group("report")

MISSION = Mission(title="Wall & box", camera=CameraSpec(survey_px=(640, 360)),
                  site=SiteSpec(object_min_enu_m=(-4.9, -1.2, 0.1), object_max_enu_m=(4.9, 0.2, 5.9), ground_up_m=-1.0),
                  survey=SurveySpec(distance_m=5.0), reconstruct=ReconstructSpec(depth_width_px=640))


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder as a flight over the wall leaves it, with its truth; nothing reconstructed yet."""
    run = RunFolder(tmp_path_factory.mktemp("run"))
    write_mission(MISSION, run.mission)
    rows = []
    for k, p in enumerate(survey(run.pictures)):
        q = p.pose.quaternion_wxyz
        rows.append([k, 1 + k % 2, "survey", float(k), *p.position_enu_m, *q, 0.0, f"pictures/{p.path.name}"])
    write_views(run.views_csv, rows)
    parts = [trimesh.Trimesh([r.corner, r.corner + r.a, r.corner + r.a + r.b, r.corner + r.b], [[0, 1, 2], [0, 2, 3]])
             for r in wall_and_box()]
    trimesh.util.concatenate(parts).export(run.truth_mesh)
    x, z = np.meshgrid(np.arange(-2, 2, 0.05), np.arange(1, 5, 0.05))
    wall = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    wall = wall[(np.abs(wall[:, 0]) > 1.6) | (np.abs(wall[:, 2] - 3) > 1.6)]
    np.savez(run.truth_samples, points=wall, normals=np.tile([0.0, -1.0, 0.0], (len(wall), 1)))
    run.referee.write_text(json.dumps({"collisions": 0, "min_clearance_m": 1.4, "min_separation_m": 3.3,
                                       "notes": ["dropped 3 faces without area"],
                                       "coverage": {"final": 0.8, "ceiling": 0.9, "auc": 0.5, "per_view": [0.3, 0.8]}}))
    t = np.arange(0, 10, 0.1)
    arrays = {f"uav{k}_{name}": value for k in (1, 2) for name, value in
              (("t_s", t), ("position_enu_m", np.stack([t, k + (0.5 * t) ** k, t], 1)), ("battery_percent", 100 - t),
               ("mode", np.where(t < 2, "standby" if k == 1 else "swap", np.where(t < 8 + k, "mission", "return"))))}
    np.savez(run.trajectories, **arrays)
    run.flight.write_text(json.dumps({
        "site": {"object_min_enu_m": MISSION.site.object_min_enu_m, "ground_up_m": MISSION.site.ground_up_m,
                 "object_max_enu_m": MISSION.site.object_max_enu_m},
        "mission_hash": "cafe", "phases": {"survey": {"start_s": 0, "end_s": 10, "wall_s": 2.5}},
        "fleet": {"makespan_s": 10.0, "path_m": {"1": 9.0, "2": 8.0}, "battery_end_percent": {"1": 90.0, "2": 91.0},
                  "views_flown": 9, "views_reassigned": 1, "views_unreachable": 0},
        "plans": [{"vehicle_id": k, "phase": "survey", "views": 4, "start_s": 2.0, "end_s": 8.0, "start_percent": 98.0,
                   "end_percent": 92.0, "flown": k < 3, "predicted_percent": 6.3} for k in (1, 2, 3)],
        "reassignments": [{"view_id": 3, "from": 1, "to": 2, "t_s": 4.0, "reason": "energy"}],
        "outcomes": {str(i): "flown" if i else "unreachable" for i in range(9)},
        "outcome_details": {"0": "no way <through>"},
        "allocations": [{"t_s": 2.0, "why": "start", "open_views": 9, "wall_s": 0.25}], "notes": ["a <b>note</b>"],
        "battery_at_view": [{"view_id": 0, "vehicle_id": 1, "t_s": 1.0, "battery_percent": 99.0}]}))
    return run.root


@pytest.fixture(scope="session")
def done(flown: Path) -> RunFolder:
    """The same folder after the three stages."""
    for stage in ("reconstruct", "evaluate", "report"):
        assert stages.main([stage, str(flown)]) == 0
    return RunFolder(flown)


def copied(flown: Path, to: Path, *without: str) -> RunFolder:
    shutil.copytree(flown, to / "run")
    for name in without:
        path = to / "run" / name
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    return RunFolder(to / "run")


def test_metrics_have_every_number(done: RunFolder) -> None:
    m = json.loads(done.metrics.read_text())
    assert m["collisions"] == 0
    assert (m["min_clearance_m"], m["min_separation_m"]) == (1.4, 3.3)
    assert m["coverage"] == {"final": 0.8, "ceiling": 0.9, "auc": 0.5, "per_view": [0.3, 0.8]}
    assert m["c2c"]["completeness"]["0.10"] > 0.97
    assert m["reachable"]["share"] == 1.0
    assert m["reachable"]["completeness"] == m["reachable"]["relative"] == m["c2c"]["completeness"]["0.25"]
    assert m["c2m"]["mean_m"] < 0.01
    assert m["c2m"]["within_2cm"] > 0.97
    assert m["fleet"]["path_m"] == {"1": 9.0, "2": 8.0}
    assert m["service"] == {"swaps": 1, "service_s": 2.0, "vehicles": {
        "1": {"swaps": 0, "service_s": 0.0}, "2": {"swaps": 1, "service_s": 2.0}}}
    assert m["energy"]["1"] == pytest.approx({"plans": 1, "predicted_percent": 6.3, "used_percent": 6.0, "error": 0.05})
    assert set(m["energy"]) == {"1", "2"}
    assert set(m["timing_s"]) == {"survey", "reconstruct", "evaluate", "report"}
    assert set(m["peak_memory_mib"]) == {"reconstruct", "evaluate", "report"}
    assert (m["seed"], m["mission_hash"]) == (1, load_mission(done.mission).mission_hash)


def test_depth_maps_go_and_cloud_and_mesh_stay(done: RunFolder) -> None:
    assert not (done.root / "depth").exists()
    assert done.cloud.stat().st_size > 100_000
    assert len(trimesh.load_mesh(done.mesh).faces) > 1000
    assert {path.name for path in done.model.iterdir()} == {"model.obj", "model.mtl", "model.png", "model.glb"}


def test_what_was_made_from_the_same_is_kept(done: RunFolder, tmp_path: Path) -> None:
    run = copied(done.root, tmp_path)
    (run.model / "model.glb").unlink()
    before = {path: path.stat().st_mtime_ns for path in (run.cloud, run.mesh)}
    told: list[bool] = []
    again = reconstruct_run(run, cloud_there=lambda: told.append((run.model / "model.glb").is_file()))
    assert told == [False], "the cloud can be measured before there is a model"
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert set(again["stages"]) == {"align", "model"}, "only what was missing was made"
    (run.model / "model.glb").unlink()
    mission = load_mission(run.mission)
    write_mission(replace(mission, reconstruct=replace(mission.reconstruct, min_confidence=4)), run.mission)
    assert set(reconstruct_run(run)["stages"]) == {"align", "cloud", "mesh", "model"}


def test_growth_is_measured_beside_the_run(flown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(path.name for path in flown.iterdir())
    assert reconstruct_growth.main([str(flown), "--pictures", "6", "--depth-width-px", "320", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(r["pictures"], r["stage"]) for r in rows] == [(6, s) for s in ("align", "cloud", "mesh", "model", "all")]
    assert all(r["peak MiB"] > 50 for r in rows)
    assert sorted(path.name for path in flown.iterdir()) == before
    with pytest.raises(UserError, match=r"--pictures 10: .* has 9 survey pictures"):
        reconstruct_growth.main([str(flown), "--pictures", "10"])


class Outside(HTMLParser):
    """Collects addresses that a page would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.images = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.images += tag == "img"
        self.fetched += [v for k, v in attrs if k in ("src", "href") and v and not v.startswith("data:")]


def test_page_is_self_contained_and_complete(done: RunFolder) -> None:
    text = done.report.read_text()
    parser = Outside()
    parser.feed(text)
    assert parser.fetched == []
    assert parser.images == 1 + 15 + 6
    assert len(text) < 15e6
    assert text.count("Plotly.newPlot(") == 8
    assert "Wall &amp; box" in text
    assert "a &lt;b&gt;note&lt;/b&gt;" in text
    assert "<td>unreachable</td><td>no way &lt;through&gt;</td><td class=n>1</td><td class=n>0</td>" in text
    assert "<td>2 s</td><td>start</td><td class=n>9</td><td class=n>0.25 s</td>" in text
    assert "scene: dropped 3 faces without area" in text
    titles = re.findall(r"<h2>(.*?)</h2>", text)
    assert titles == ["The reconstruction", "Exploration coverage", "Battery", "Tours", "Vehicles over time",
                      "Distances between vehicles", "Energy predicted and used", "Vehicles and views",
                      "Completeness (C2C)", "Accuracy (C2M)", "By part", "Confidence and error",
                      "Where it is good, and what is missing", "Survey pictures",
                      "Time and memory on this machine", "Notes"]


def test_noisy_poses_are_aligned_and_judged_by_the_truth(done: RunFolder, tmp_path: Path) -> None:
    run = copied(done.root, tmp_path / "run", "alignment", "cloud.ply", "mesh.ply")
    write_mission(replace(load_mission(run.mission), camera=CameraSpec(
        survey_px=(640, 360), position_sigma_m=0.02, attitude_sigma_deg=0.3)), run.mission)
    shutil.copy(run.views_csv, run.truth_views)
    rng, rows = np.random.default_rng(3), []
    for v in read_views(run.views_csv):
        turn = Rotation.from_rotvec(np.radians(0.3) * rng.standard_normal(3)).as_matrix()
        q, p = quaternion_from_matrix(v.enu_from_camera @ turn), v.position_enu_m + 0.02 * rng.standard_normal(3)
        rows.append([v.view_id, v.vehicle_id, v.phase, v.t_capture_s, *p, *q, v.speed_m_s, v.path])
    write_views(run.views_csv, rows)
    reconstruct_run(run)
    metrics = stages.evaluate_run(run)
    found = metrics["alignment"]
    assert found["registered"] == found["pictures"] == 9
    assert found["error_aligned"]["position_mean_m"] < 0.6 * found["error_measured"]["position_mean_m"]
    assert found["error_aligned"]["attitude_mean_deg"] < 0.5 * found["error_measured"]["attitude_mean_deg"]
    exact = json.loads(done.metrics.read_text())
    assert exact["alignment"] is None
    assert metrics["c2c"]["completeness"]["0.25"] > exact["c2c"]["completeness"]["0.25"] - 0.02
    data = read_run(run)
    measured = measure(data)
    assert "9 of 9" in page(data, measured, metrics, draw(data, measured))


def test_a_report_that_waits_measures_before_and_shows_what_came_meanwhile(done: RunFolder, tmp_path: Path) -> None:
    run = copied(done.root, tmp_path, "model", "metrics.json", "processes")
    measured: list[bool] = []

    def ready() -> None:
        measured.append(run.has_process_record("evaluate"))
        shutil.copytree(done.model, run.model, dirs_exist_ok=True)

    stages.report_run(run, ready)
    assert measured == [True]
    assert "Textured model" in run.report.read_text()


def test_the_stages_of_a_flight_give_what_they_give_one_by_one(done: RunFolder, tmp_path: Path) -> None:
    made = ("cloud.ply", "mesh.ply", "model", "products.json", "metrics.json", "report.html", "processes")
    run = copied(done.root, tmp_path, *made)
    assert run_stages(run, load_mission(run.mission), keep_depth=False)
    assert run.cloud.read_bytes() == done.cloud.read_bytes()
    assert "Textured model" in run.report.read_text()
    told, alone = (json.loads(path.read_text()) for path in (run.metrics, done.metrics))
    assert {key: told[key] for key in ("c2c", "c2m", "parts", "inspection")} == {
        key: alone[key] for key in ("c2c", "c2m", "parts", "inspection")}
    run.views_csv.unlink()
    assert not run_stages(run, load_mission(run.mission), keep_depth=False), "a stage that fails is told"


def test_json_is_the_only_thing_on_stdout(done: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    assert stages.main(["evaluate", str(done.root), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["c2c"]["completeness"]["0.25"] > 0.97


@pytest.mark.parametrize("missing", [
    ("truth",), ("flight.json", "trajectories.npz"), ("cloud.ply", "mesh.ply"),
    ("truth", "flight.json", "trajectories.npz", "cloud.ply", "views.csv", "processes")])
def test_missing_parts_are_null_and_noted(done: RunFolder, tmp_path: Path, missing: tuple[str, ...]) -> None:
    run = copied(done.root, tmp_path, *missing)
    metrics = stages.evaluate_run(run)
    stages.report_run(run)
    assert run.report.read_text().startswith("<!doctype html>")
    assert any(name.split("/")[0] in note for name in missing for note in metrics["notes"])
    if "truth" in missing:
        assert metrics["collisions"] is None
        assert metrics["coverage"] == {"final": None, "ceiling": None, "auc": None, "per_view": None}
    if {"truth", "cloud.ply"} & set(missing):
        assert metrics["c2c"]["completeness"]["0.25"] is None
        assert metrics["c2m"]["mean_m"] is None
    if "flight.json" in missing:
        assert metrics["fleet"]["makespan_s"] is None


def test_without_a_box_the_cameras_enclose_the_region(done: RunFolder, tmp_path: Path) -> None:
    run = copied(done.root, tmp_path, "truth", "flight.json")
    write_mission(Mission(title="No box", camera=MISSION.camera), run.mission)
    region = read_run(run).region()
    stands = np.array([v.position_enu_m for v in read_views(run.views_csv)])
    np.testing.assert_allclose([region.lower_enu_m, region.upper_enu_m], [stands.min(axis=0), stands.max(axis=0)])


def test_ground_is_left_out(done: RunFolder, tmp_path: Path) -> None:
    run = copied(done.root, tmp_path)
    write_mission(Mission(title="Low", site=SiteSpec(object_min_enu_m=(0, 0, 0), object_max_enu_m=(1, 1, 1),
                                                     ground_up_m=0.0)), run.mission)
    region = read_run(run).region()
    assert region.contains(np.array([[0.5, 0.5, 0.05], [0.5, 0.5, 0.15], [-0.2, 0.5, 0.5], [-0.3, 0.5, 0.5]],
                                    np.float32)).tolist() == [False, True, True, False]


@pytest.mark.parametrize(("arguments", "words"), [
    (["evaluate", "nowhere"], "no such run folder"), (["fly"], "use one of: reconstruct, evaluate, report")])
def test_bad_calls_end_with_two_and_a_sentence(arguments: list[str], words: str,
                                               capsys: pytest.CaptureFixture[str]) -> None:
    assert stages.main(arguments) == 2
    assert words in capsys.readouterr().err


def test_bad_views_name_their_line(done: RunFolder, tmp_path: Path) -> None:
    run = copied(done.root, tmp_path)
    lines = run.views_csv.read_text().splitlines()
    lines[2] = lines[2].replace("survey,", "survey,soon", 1)
    run.views_csv.write_text("\n".join(lines))
    with pytest.raises(UserError, match=r"views\.csv: line 3"):
        read_views(run.views_csv)


def test_tiles_judge(done: RunFolder) -> None:
    data = read_run(done)
    metrics = assemble(data, measure(data))
    states = {t.name: t.state for t in tiles.key_numbers(data, metrics)}
    assert states["Collisions"] == states["Exploration coverage"] == states["C2C completeness, 0.25 m"] == tiles.PASS
    worse = {t.name: t.state for t in tiles.key_numbers(data, {**metrics, "collisions": 2})}
    assert worse["Collisions"] == tiles.ATTENTION
    unknown = {t.name: (t.value, t.state) for t in tiles.key_numbers(data, {**metrics, "collisions": None})}
    assert unknown["Collisions"] == ("–", tiles.NEUTRAL)


def test_memory_of_later_stages_is_not_added_to_the_flight(done: RunFolder) -> None:
    data = read_run(done)
    peaks = {"bridge": 900.0, "ground": 1500.0, "uav1": 300.0, "reconstruct": 2000.0, "report": 800.0}
    shown = {t.name: t.value for t in tiles.key_numbers(data, {**assemble(data, None), "peak_memory_mib": peaks})}
    assert shown["Memory"] == "2,700 MiB"


def test_hand_overs_are_marked_on_the_battery_curve(done: RunFolder) -> None:
    figure = time_charts.battery_curves(read_run(done))
    assert figure is not None
    marks = next(trace for trace in figure.data if trace.name == "views handed over")
    assert list(marks.text) == ["1 views from UAV 1 to UAV 2"]
    np.testing.assert_allclose([marks.x[0], marks.y[0]], [4.0 / 60, 96.0])


def test_the_gantt_shows_every_moment_of_every_vehicle_once(done: RunFolder) -> None:
    data = read_run(done)
    for track in data.tracks:
        found = spans(track, {"explore": {"end_s": 5.0}})
        first = "on the ground" if track.vehicle_id == 1 else "battery swap"
        assert [s.activity for s in found] == [first, "exploring", "surveying", "returning"][:3 + (
            track.vehicle_id == 1)]
        assert [s.start_s for s in found] == pytest.approx([0.0, 2.0, 5.0, 9.0][: len(found)])
        assert [a.end_s for a in found] == [b.start_s for b in found[1:]] + [track.t_s[-1]]
    figure = time_charts.gantt(data)
    assert figure is not None
    assert {bar.name: sum(bar.x) * 60 for bar in figure.data} == pytest.approx(
        {"on the ground": 2.0, "battery swap": 2.0, "surveying": 14.9, "returning": 0.9})


def test_the_nearest_pair_is_that_of_all_pairs_of_which_one_flies() -> None:
    rng, t = np.random.default_rng(4), np.arange(50) / 10
    tracks = [Track(k, t[k:], rng.uniform(0, 9, (50 - k, 3)), 0 * t, np.where(t[k:] < 2, "standby", "mission"))
              for k in (1, 2, 3)]
    near = nearest_pairs(tracks)
    assert near.t_s.tolist() == t[20:].tolist()
    for n, (moment, (a, b)) in enumerate(zip(near.t_s, near.pair, strict=True)):
        at = {k.vehicle_id: k.position_enu_m[np.searchsorted(k.t_s, moment)] for k in tracks}
        gaps = {(i, j): np.linalg.norm(at[i] - at[j]) for i in at for j in at if i < j}
        assert min(gaps, key=lambda pair: gaps[pair]) == (a, b)
        assert near.distance_m[n] == pytest.approx(gaps[a, b])
    assert len(nearest_pairs(tracks[:1]).t_s) == 0


def test_the_drawn_separation_keeps_the_least_distance(done: RunFolder) -> None:
    data = read_run(done)
    figure = time_charts.separation(data)
    assert figure is not None
    assert min(figure.data[0].y) == nearest_pairs(data.tracks).distance_m.min()


def test_energy_is_summed_over_flown_plans(done: RunFolder) -> None:
    figure = time_charts.energy(read_run(done))
    assert figure is not None
    assert {line.name: line.y[-1] for line in figure.data} == pytest.approx(
        {f"UAV {k} {what}": v for k in (1, 2) for what, v in (("used", 6.0), ("predicted", 6.3))})


def test_nearer_points_hide_farther_ones() -> None:
    plane = np.stack(np.meshgrid(np.arange(40), [0.0], np.arange(20)), -1).reshape(-1, 3).astype(np.float32)
    points = np.concatenate([plane, plane + np.float32([0, -5, 0])])
    colours = np.repeat(np.array([[255, 0, 0], [0, 0, 255]], np.uint8), len(plane), axis=0)
    seen = splat(points[::-1], colours[::-1], np.pi / 2, 0.0, 100, 1.2)
    middle = seen[10:-10, 10:-10].reshape(-1, 3)
    assert seen.shape[1] == 100
    assert np.all(middle[:, 0] == 0), "looking north, the southern blue plane is in front"
    assert np.mean(middle[:, 2]) > 200


def test_ramp_hits_its_stops() -> None:
    stops = ((0, 0, 0), (10, 20, 30), (100, 100, 100))
    np.testing.assert_array_equal(ramp(np.array([-1.0, 0.0, 1.0, 2.0, 9.0]), 0.0, 2.0, stops)[[0, 1, 2, 3, 4]],
                                  [stops[0], stops[0], stops[1], stops[2], stops[2]])


def test_a_page_of_a_bare_folder(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    write_mission(MISSION, run.mission)
    data = read_run(run)
    text = page(data, None, assemble(data, None), draw(data, None))
    assert "truth/referee.json is missing" in text
    assert "<h2>Tours</h2>" not in text


def test_empty_cloud_counts_as_nothing_reconstructed(flown: Path, tmp_path: Path) -> None:
    run = copied(flown, tmp_path, "cloud.ply")
    one = np.full((1, 3), 99.0, np.float32)
    write_cloud(Cloud(one, np.zeros((1, 3), np.uint8), one, np.full(1, 3, np.uint8)), run.cloud)
    metrics = stages.evaluate_run(run)
    assert metrics["c2c"]["completeness"]["0.50"] == 0.0
    assert metrics["c2m"]["points"] == 0
