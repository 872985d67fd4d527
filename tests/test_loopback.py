"""Real processes on loopback: a small mission from take-off to landing, and one that loses a vehicle."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from ground_station import launcher, processes
from ground_station.mcap_export import write_recording
from ground_station.mission_setup import prepare
from ground_station.report.run_data import read_run
from missions import topics
from missions.bus import Bus
from missions.messages import Status
from missions.mission_file import load_mission
from missions.run_folder import RunFolder
from missions.tlog import read_tlog
from tests.killed_vehicle import KILL_AT_S
from vehicle.teammates import LOST_TEAMMATE

HERE = Path(__file__).parent
MISSION = HERE / "missions" / "house.toml"
SCENE_NAME = "very_secret_house"
REFINED = ["survey.refine=4"]
pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("loopback")]


def small_mission(tmp_path: Path, settings: list[str]) -> list[str]:
    """The small mission over a box, as arguments of `swarmscan fly`."""
    scene = tmp_path / f"{SCENE_NAME}.ply"
    if not scene.exists():
        box = trimesh.creation.box(extents=(8.0, 6.0, 7.0))
        box.apply_translation((0.0, 0.0, 3.5))
        box.export(scene)
    run_name = str(tmp_path / f"run{len(list(tmp_path.glob('run*')))}")
    sets = [part for s in settings for part in ("--set", s)]
    return [str(MISSION), "--scene", str(scene), "--run", run_name, *sets]


def fly(tmp_path: Path, settings: list[str], watch: Callable[[processes.Flight, Status], None] | None = None,
        environment: dict[str, str] | None = None,
        modules: dict[str, str] | None = None) -> tuple[RunFolder, list[str]]:
    """Fly the small mission; `watch` sees every status and may interfere. modules: other modules for these
    processes."""
    options = launcher._parse(small_mission(tmp_path, settings))
    mission, run = prepare(options)
    endpoint = processes.free_endpoint()
    run.endpoint.write_text(endpoint, encoding="ascii")
    table = [replace(p, module=(modules or {}).get(p.name, p.module))
             for p in processes.process_table(mission, run, endpoint, "test", quiet=True)]
    flight = processes.Flight(table, run, keep=environment or {})
    over = threading.Event()
    watcher = threading.Thread(target=_observe, args=(endpoint, flight, watch, over)) if watch else None
    try:
        if watcher:
            watcher.start()
        return run, flight.wait()
    finally:
        over.set()
        if watcher:
            watcher.join()
        flight.stop()


def _observe(endpoint: str, flight: processes.Flight, watch: Callable[[processes.Flight, Status], None],
             over: threading.Event) -> None:
    with Bus("observer", "test", connect=endpoint) as bus:
        bus.subscribe(topics.STATUS)
        while not over.is_set():
            for delivery in bus.poll(timeout_s=0.2):
                watch(flight, delivery.message)


def flight_of(run: RunFolder) -> dict[str, Any]:
    return dict(json.loads(run.flight.read_text(encoding="utf-8")))


def audited(tmp_path: Path) -> dict[str, str]:
    return {"PYTHONPATH": str(HERE / "audit"), "SWARMSCAN_AUDIT_LOG": str(tmp_path / "audit")}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunFolder, list[str], Path]:
    for room in ("planning", "perception", "vehicle"):
        subprocess.run([sys.executable, "-m", f"{room}.warm_up"], check=True)
    folder = tmp_path_factory.mktemp("loopback")
    run, complaints = fly(folder, REFINED, environment=audited(folder))
    return run, complaints, folder


def test_the_mission_flies_from_take_off_to_landing(flown: tuple[RunFolder, list[str], Path]) -> None:
    run, complaints, _ = flown
    assert complaints == []
    record, referee = flight_of(run), json.loads(run.referee.read_text())
    assert referee["collisions"] == 0
    assert set(record["phases"]) == {"explore", "survey", "return"}
    assert record["fleet"]["views_flown"] == len(record["outcomes"]) == 16
    assert [a["why"] for a in record["allocations"]][:2] == ["start", "refine"]
    assert any(note.endswith("4 more views for what fewer than 3 pictures show") for note in record["notes"])
    assert referee["coverage"]["final"] >= 0.5 * referee["coverage"]["ceiling"]


def test_no_process_compiles_while_it_flies(flown: tuple[RunFolder, list[str], Path]) -> None:
    _, _, folder = flown
    opened = [line for log in folder.glob("audit.*") for line in log.read_text().splitlines() if "open " in line]
    assert any(line.endswith(".nbc") for line in opened)
    assert [line for line in opened if ".nbc.tmp" in line or ".nbi.tmp" in line] == []


def test_every_picture_is_on_disk_and_in_the_table(flown: tuple[RunFolder, list[str], Path]) -> None:
    run, _, _ = flown
    with run.views_csv.open() as f:
        rows = list(csv.DictReader(f))
    record, referee = flight_of(run), json.loads(run.referee.read_text())
    assert len(rows) == referee["pictures"] == sum(map(len, record["tours"].values()))
    assert len({r["view_id"] for r in rows}) == len(rows)
    for row in rows:
        size = (480, 270) if row["phase"] == "survey" else (228, 128)
        with Image.open(run.root / row["path"]) as picture:
            assert picture.size == size
        assert (int(row["view_id"]) > 10000) == (row["phase"] == "survey")
    assert sorted(v for tour in record["tours"].values() for v in tour) == sorted(int(r["view_id"]) for r in rows)


def test_trajectories_are_at_ten_hertz_and_battery_follows_the_path(flown: tuple[RunFolder, list[str], Path]) -> None:
    run, _, _ = flown
    spec = load_mission(run.mission)
    with np.load(run.trajectories) as tracks:
        for k in (1, 2):
            t, path = tracks[f"uav{k}_t_s"], tracks[f"uav{k}_position_enu_m"]
            assert np.allclose(np.diff(t), 0.1, atol=1e-9)
            assert t[0] == 0.0
            speed = np.linalg.norm(tracks[f"uav{k}_velocity_enu_m_s"], axis=1)
            assert speed.max() <= spec.fleet.speed_m_s * (1 + 1e-6)
            spent = tracks[f"uav{k}_battery_percent"][0] - tracks[f"uav{k}_battery_percent"][-1]
            length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
            assert spent == pytest.approx(length * spec.battery.percent_per_m, rel=0.02)
            assert np.allclose(path[0], path[-1], atol=1e-2)


def test_the_telemetry_log_and_the_recording_hold_the_whole_flight(flown: tuple[RunFolder, list[str], Path]) -> None:
    run, _, _ = flown
    log = list(read_tlog(run.tlog, load_mission(run.mission).clock.epoch_utc))
    captured = [m for _, m in log if m.get_type() == "CAMERA_IMAGE_CAPTURED"]
    pictures = sum(map(len, flight_of(run)["tours"].values()))
    assert len({(m.get_srcSystem(), m.image_index) for m in captured}) == pictures
    with np.load(run.trajectories) as tracks:
        for k in (1, 2):
            flown_by_k = [(t, (m.y, m.x, -m.z)) for t, m in log
                          if (m.get_type(), m.get_srcSystem()) == ("LOCAL_POSITION_NED", k)]
            t_s, places = (np.array(column) for column in zip(*flown_by_k, strict=True))
            path = [np.interp(t_s, tracks[f"uav{k}_t_s"], column) for column in tracks[f"uav{k}_position_enu_m"].T]
            assert np.abs(np.array(path).T - places).max() < 0.5
    shown = write_recording(read_run(run), run.recording)
    assert sum(n for topic, n in shown.items() if topic.endswith("camera/picture")) == pictures
    assert shown["/uav1/plan"] >= 1


def test_the_same_mission_flies_the_same_trajectories_again(
        flown: tuple[RunFolder, list[str], Path], tmp_path: Path) -> None:
    first, _, folder = flown
    (tmp_path / f"{SCENE_NAME}.ply").write_bytes((folder / f"{SCENE_NAME}.ply").read_bytes())
    second, _ = fly(tmp_path, REFINED)
    with np.load(first.trajectories) as a, np.load(second.trajectories) as b:
        assert sorted(a.files) == sorted(b.files)
        assert [name for name in a.files if not np.array_equal(a[name], b[name])] == []
    assert flight_of(first)["outcomes"] == flight_of(second)["outcomes"]
    assert first.views_csv.read_bytes() == second.views_csv.read_bytes()
    assert first.tlog.read_bytes() == second.tlog.read_bytes()


def test_the_ground_station_never_opens_the_scene(flown: tuple[RunFolder, list[str], Path]) -> None:
    _, _, folder = flown
    logs = [p.read_text() for p in folder.glob("audit.*")]
    ground = [text for text in logs if "-m ground_station " in text.splitlines()[0]]
    bridge = [text for text in logs if "-m sim_bridge " in text.splitlines()[0]]
    assert (len(ground), len(bridge)) == (1, 1)
    assert SCENE_NAME in bridge[0]
    assert "import sim_bridge.truth" in bridge[0]
    seen = ground[0].splitlines()[1:]
    assert any(line == "import perception.depth.plane_sweep" for line in seen)
    assert [line for line in seen if SCENE_NAME in line or "/truth" in line] == []
    assert [line for line in seen if line.startswith("import") and line.split()[1].split(".")[0] in
            ("sim_bridge", "vehicle")] == []


@pytest.mark.parametrize("kill_at_s", [26.0, 31.8], ids=["with_many_views_left", "beside_its_views"])
def test_a_killed_vehicles_views_are_flown_by_the_other(tmp_path: Path, kill_at_s: float) -> None:
    run, complaints = fly(tmp_path, ["explore.max_views=6", "fleet.restarts=0"],
                          environment={KILL_AT_S: str(kill_at_s)}, modules={"uav1": "tests.killed_vehicle"})
    assert len(complaints) == 1
    assert complaints[0].startswith("uav1 ended with code -9")
    record = flight_of(run)
    assert record["phases"]["survey"]["start_s"] < kill_at_s
    assert json.loads(run.referee.read_text())["collisions"] == 0
    # until the dead vehicle counts as lost it may still get what the other has no way to
    moved = {(r["from"], r["to"]): {m["view_id"] for m in record["reassignments"] if m["from"] == r["from"]}
             for r in record["reassignments"]}
    assert {(1, 2)} <= set(moved) <= {(1, 2), (2, 1)}
    # it may hover where views were to be taken
    kept_away = {int(v) for v, outcome in record["outcomes"].items() if outcome != "flown"}
    reasons = {v: record["outcome_details"][str(v)] for v in kept_away}
    assert {v: why for v, why in reasons.items() if LOST_TEAMMATE not in why} == {}
    handed_over = moved[1, 2] - moved.get((2, 1), set()) - kept_away
    assert handed_over
    assert handed_over <= set(record["tours"]["2"])
    with np.load(run.trajectories) as tracks:
        origin = dict(zip(tracks["uav2_view_ids"], tracks["uav2_origin_ids"], strict=True))
    assert {origin[v] for v in handed_over} == {1}


def test_a_vehicle_that_runs_low_hands_its_views_over_and_keeps_their_origin(tmp_path: Path) -> None:
    """As in the thesis: Algorithm 1, the threshold, the remaining views to the other vehicle."""
    run, complaints = fly(tmp_path, [
        'survey.method="thesis"', "survey.stop_at_views=true", 'battery.model="distance"', "battery.percent_per_m=0.25",
        "battery.start_percent=[30.0, 100.0]", "explore.max_views=6", "survey.max_views=24"])
    assert complaints == []
    record, referee = flight_of(run), json.loads(run.referee.read_text())
    assert referee["collisions"] == 0
    assert any("vehicle 1 returns by itself" in note for note in record["notes"])
    assert record["fleet"]["battery_end_percent"]["1"] > 0.0
    assert set(record["outcomes"].values()) == {"flown"}
    assert record["reassignments"]
    assert {(r["from"], r["to"]) for r in record["reassignments"]} == {(1, 2)}
    assert {"energy"} <= {r["reason"] for r in record["reassignments"]} <= {"energy", "blocked"}
    assert {r["view_id"] for r in record["reassignments"]} <= set(record["tours"]["2"])


def test_a_killed_bridge_ends_the_flight_names_its_log_and_keeps_what_was_received(tmp_path: Path) -> None:
    def kill_bridge(flight: processes.Flight, status: Status) -> None:
        if status.pictures and "bridge" in flight.running:
            flight.running["bridge"].kill()

    run, complaints = fly(tmp_path, ["clock.speed=8.0", "fleet.restarts=0"], watch=kill_bridge)
    assert any(c.startswith("bridge ended with code -9; read") and c.endswith("bridge.log.") for c in complaints)
    with run.views_csv.open() as f:
        rows = list(csv.DictReader(f))
    assert rows
    assert all((run.root / row["path"]).is_file() for row in rows)
    assert flight_of(run)["tours"]
    assert run.trajectories.is_file()
