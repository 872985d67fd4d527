"""The simulated world as its participants meet it: pictures, ranges, verdict; and the process around it."""

from __future__ import annotations

import hashlib
import json
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from missions import topics
from missions.bus import Bus
from missions.camera import Camera, Pose
from missions.clock import BRIDGE, SECOND_NS, SimClock, Turn
from missions.messages import RangeScan, SensorPicture, ShutterRequest, SiteBrief, VehicleState
from missions.mission import CameraSpec, FleetSpec, Mission, SiteSpec, without_scene
from missions.mission_file import write_mission
from missions.sensors import RANGE_DIRECTIONS
from missions.simulation import ObstacleSpec, SceneSpec
from sim_bridge.__main__ import main, site_brief
from sim_bridge.clock_server import ClockServer
from sim_bridge.coverage import Coverage
from sim_bridge.pose_noise import measured
from sim_bridge.range_sensor import RangeSensor
from sim_bridge.scenes.load import load_scene
from sim_bridge.truth import Truth
from sim_bridge.world import World
from sim_bridge.world_journal import WorldJournal
from tests.loopback import free_endpoint

JOIN_S = 240.0
CAMERA = Camera.from_diagonal_fov(64, 36, 84.0)
BEAM = ObstacleSpec(center_enu_m=(0.0, -4.0, 5.0), size_m=(6.0, 0.2, 6.0), appears_at_s=1.0, disappears_at_s=2.0)
BOX = trimesh.creation.box(extents=(4.0, 4.0, 4.0)).apply_translation((0.0, 0.0, 5.0))
SITE = SiteBrief(object_min_enu_m=(-2.0, -2.0, 3.0), object_max_enu_m=(2.0, 2.0, 7.0), ground_up_m=0.0)


def box_scene(folder: Path) -> SceneSpec:
    """The box as a file."""
    BOX.export(folder / "box.ply")
    return SceneSpec(path=str(folder / "box.ply"), surroundings=False)


def truth() -> Truth:
    return Truth(np.asarray(BOX.vertices), np.asarray(BOX.faces, dtype=np.int32), [BEAM])


def state(vehicle_id: int, t_ns: int, position: tuple[float, float, float], flying: bool = True) -> VehicleState:
    return VehicleState(vehicle_id=vehicle_id, t_ns=t_ns, position_enu_m=position, velocity_enu_m_s=(0.0, 0.0, 0.0),
                        acceleration_enu_m_s2=(0.0, 0.0, 0.0), yaw_enu_rad=0.0, gimbal_elevation_rad=0.0,
                        battery_percent=50.0, flying=flying, mode="auto")


class GreyRenderer:
    """A renderer whose pictures tell how many boxes it was shown."""

    backend_name = "grey"

    def render(self, camera: Camera, pose: Pose, boxes: Sequence[Any], noise_key: int) -> Any:
        return np.full((camera.height_px, camera.width_px, 3), 50 + 100 * len(boxes), dtype=np.uint8)

    def close(self) -> None:
        """Nothing is held."""


@dataclass
class Heard:
    """What one participant was sent."""

    pictures: list[SensorPicture] = field(default_factory=list)
    scans: list[RangeScan] = field(default_factory=list)
    ticks: list[int] = field(default_factory=list)
    stopped: bool = False


def participant(name: str, endpoint: str, mission: Mission, heard: Heard,
                act: Callable[[Bus, Turn], bool]) -> threading.Thread:
    """A vehicle or the ground station as a thread; `act` says whether to stay."""

    def live() -> None:
        with Bus(name, "default", connect=endpoint) as bus:
            if name.startswith("uav"):
                bus.subscribe(topics.SENSOR_PICTURE, name[3:])
                bus.subscribe(topics.RANGE_SCAN, name[3:])
            clock = SimClock(bus, without_scene(mission).mission_hash)
            clock.join(JOIN_S)
            while not heard.stopped:
                turn = clock.next()
                heard.stopped = turn.stop
                heard.ticks.append(turn.tick)
                heard.pictures += [d.message for d in turn.deliveries if isinstance(d.message, SensorPicture)]
                heard.scans += [d.message for d in turn.deliveries if isinstance(d.message, RangeScan)]
                if not act(bus, turn):
                    clock.leave()
                    return
                clock.done(turn.t_ns + SECOND_NS)

    thread = threading.Thread(target=live, name=name, daemon=True)
    thread.start()
    return thread


def photographer(vehicle_id: int, position: tuple[float, float, float]) -> Callable[[Bus, Turn], bool]:
    """Stands 4 m below, then hovers, and takes an exploration picture every half second."""
    east, north, up = position

    def act(bus: Bus, turn: Turn) -> bool:
        now = position if turn.tick else (east, north, up - 4.0)
        bus.publish(topics.VEHICLE_STATE, state(vehicle_id, turn.t_ns, now, flying=turn.tick > 0), vehicle_id)
        if turn.t_ns % (SECOND_NS // 2) == 0 and not turn.stop:
            shutter = ShutterRequest(vehicle_id=vehicle_id, view_id=100 * vehicle_id + turn.t_ns * 2 // SECOND_NS,
                                     phase="explore", t_capture_ns=turn.t_ns, pose=Pose(position, math.pi / 2, 0.0),
                                     speed_m_s=0.0, camera=CAMERA)
            bus.publish(topics.SHUTTER, shutter, vehicle_id)
        return True

    return act


def until(tick: int) -> Callable[[Bus, Turn], bool]:
    return lambda _, turn: turn.tick < tick


@pytest.fixture
def flight(tmp_path: Path) -> tuple[World, dict[str, Heard]]:
    """2.5 s of two hovering photographers before the box, in the same process."""
    endpoint, mission = free_endpoint(), Mission(title="test", fleet=FleetSpec(vehicles=2), obstacles=[BEAM])
    heard = {name: Heard() for name in ("ground", "uav1", "uav2")}
    with Bus(BRIDGE, "default", listen=endpoint) as bus:
        clock = ClockServer(bus, mission.clock, without_scene(mission).mission_hash, SITE)
        world = World(bus, clock, mission, truth(), GreyRenderer())
        journal = WorldJournal(tmp_path / "world.bin", "", bus.boot)
        threads = [participant("ground", endpoint, mission, heard["ground"], until(25)),
                   participant("uav1", endpoint, mission, heard["uav1"], photographer(1, (0.0, -7.0, 5.0))),
                   participant("uav2", endpoint, mission, heard["uav2"], photographer(2, (4.0, -7.0, 5.0)))]
        clock.admit(set(heard), JOIN_S)
        world.run(journal)
        journal.close()
    for thread in threads:
        thread.join(JOIN_S)
    return world, heard


def test_every_shutter_gets_its_picture(flight: tuple[World, dict[str, Heard]]) -> None:
    world, heard = flight
    for vehicle_id in (1, 2):
        pictures = heard[f"uav{vehicle_id}"].pictures
        assert [p.meta.view_id for p in pictures] == [100 * vehicle_id + k for k in range(6)]
        for p in pictures:
            assert hashlib.sha256(p.jpeg).hexdigest() == p.meta.sha256
            assert len(p.jpeg) == p.meta.size_bytes
            assert (p.meta.vehicle_id, p.meta.camera, p.meta.phase) == (vehicle_id, CAMERA, "explore")
    assert len(world.true_pictures) == 12


def test_pictures_carry_measured_poses_and_the_truth_stays_behind() -> None:
    true = Pose((1.0, 2.0, 3.0), 0.4, -0.2)
    shutters = [ShutterRequest(vehicle_id=1, view_id=k, phase="survey", t_capture_ns=k * SECOND_NS, pose=true,
                               speed_m_s=0.0, camera=CAMERA) for k in range(2000)]
    spec = CameraSpec(position_sigma_m=0.02, attitude_sigma_deg=0.3)
    told = [measured(s, spec, seed=7) for s in shutters]
    assert told == [measured(s, spec, seed=7) for s in shutters]
    assert told[0] != measured(shutters[0], spec, seed=8)
    assert all(measured(s, CameraSpec(), seed=7) == true for s in shutters)
    assert measured(msgspec.structs.replace(shutters[0], phase="explore"), spec, seed=7) == true
    position = np.array([p.position_enu_m for p in told]) - true.position_enu_m
    assert position.std(axis=0) == pytest.approx([0.02] * 3, rel=0.06)
    assert position.mean(axis=0) == pytest.approx([0.0] * 3, abs=0.002)
    turned = [np.degrees(Rotation.from_matrix(true.enu_from_camera.T @ p.enu_from_camera).as_rotvec()) for p in told]
    assert np.std(turned, axis=0) == pytest.approx([0.3] * 3, rel=0.06)


def test_pictures_show_the_boxes_of_their_moment(flight: tuple[World, dict[str, Heard]]) -> None:
    pictures = flight[1]["uav1"].pictures
    means = [cv2.imdecode(np.frombuffer(p.jpeg, np.uint8), cv2.IMREAD_COLOR).mean() for p in pictures]
    assert means == pytest.approx([50, 50, 150, 150, 50, 50], abs=2)


def test_coverage_and_referee_watched(flight: tuple[World, dict[str, Heard]]) -> None:
    world, _ = flight
    points = np.array([[0.0, -2.0, 5.0], [0.0, 2.0, 5.0], [1.0, -2.0, 6.0], [1.5, -2.0, 4.0]])
    coverage = Coverage(truth(), points, 25.0)
    for picture in world.true_pictures:
        coverage.add(picture)
    assert coverage.per_view[-1] == 0.75
    assert coverage.view_ids == [k + 100 * v for k in range(6) for v in (1, 2)]
    assert world.referee.min_separation_m == pytest.approx(4.0)
    assert world.referee.collision_events == []


def test_ranges_come_at_ten_hertz(flight: tuple[World, dict[str, Heard]]) -> None:
    scans = flight[1]["uav1"].scans
    assert [s.t_ns for s in scans] == [k * SECOND_NS // 10 for k in range(1, 26)]
    ahead = int(np.argmax(RANGE_DIRECTIONS @ [0.0, 1.0, 0.0]))
    during = [s.ranges_m[ahead] for s in scans if SECOND_NS <= s.t_ns < 2 * SECOND_NS]
    before = [s.ranges_m[ahead] for s in scans if s.t_ns < SECOND_NS]
    forward = float(RANGE_DIRECTIONS[ahead, 1])
    assert during == pytest.approx([2.9 / forward] * 10, rel=1e-5)
    assert before == pytest.approx([5.0 / forward] * 9, rel=1e-5)


def test_everybody_hears_the_stop_after_the_ground_station_left(
        flight: tuple[World, dict[str, Heard]]) -> None:
    heard = flight[1]
    assert heard["ground"].ticks[-1] == 25
    assert heard["uav1"].stopped
    assert heard["uav2"].stopped
    assert heard["uav1"].ticks == heard["uav2"].ticks == list(range(27))


def test_the_range_sensor_is_silent_on_the_ground_and_blind_beyond_its_reach() -> None:
    sensor = RangeSensor(truth(), 8.0)
    assert sensor.scan(state(1, 0, (0.0, -7.0, 5.0), flying=False)) is None
    far = sensor.scan(state(1, 100_000_000, (0.0, -50.0, 5.0)))
    assert far is not None
    assert set(far.ranges_m) == {math.inf}
    assert sensor.scan(state(1, 150_000_000, (0.0, -7.0, 5.0))) is None
    assert sensor.scan(state(2, 150_000_000, (0.0, -7.0, 5.0))) is not None
    assert sensor.scan(state(1, 200_000_000, (0.0, -7.0, 5.0))) is not None


def test_true_depth_is_measured_along_the_optical_axis() -> None:
    depth = truth().depth(CAMERA, Pose((0.0, -10.0, 5.0), math.pi / 2, 0.0), 0)
    hit = np.isfinite(depth)
    assert depth[hit] == pytest.approx(8.0, rel=1e-5)
    assert hit.sum() == pytest.approx((4.0 / 8.0 * CAMERA.fx_px) ** 2, rel=0.15)


def test_the_mission_may_overrule_the_scene_on_the_site(tmp_path: Path) -> None:
    spec = box_scene(tmp_path)
    given = Mission(title="x", site=SiteSpec(object_min_enu_m=(0.0, 0.0, 0.0), object_max_enu_m=(1.0, 2.0, 3.0)))
    brief = site_brief(given, load_scene(spec, SiteSpec()))
    assert (brief.object_min_enu_m, brief.object_max_enu_m) == ((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    free = site_brief(Mission(title="x"), load_scene(spec, SiteSpec()))
    assert free.object_min_enu_m == pytest.approx(SITE.object_min_enu_m, abs=1e-6)
    assert free.object_max_enu_m == pytest.approx(SITE.object_max_enu_m, abs=1e-6)


@pytest.mark.parametrize(("text", "word"), [('title = "x"\nbogus = 1\n', "bogus"),
                                            ('title = "x"\n[scene]\nname = "cathedral"\n', "cathedral")])
def test_bad_missions_end_with_code_two(tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str,
                                        word: str) -> None:
    path = tmp_path / "m.toml"
    path.write_text(text, encoding="utf-8")
    assert main([str(path), "--run", str(tmp_path / "run"), "--listen", free_endpoint()]) == 2
    assert word in capsys.readouterr().err


def bridge_process(mission: Mission, folder: Path, endpoint: str) -> subprocess.Popen[bytes]:
    write_mission(mission, folder / "mission.toml")
    return subprocess.Popen([sys.executable, "-m", "sim_bridge", str(folder / "mission.toml"), "--run", str(folder),
                             "--listen", endpoint], env=dict(os.environ), stderr=subprocess.PIPE)


@pytest.mark.loopback
def test_the_process_flies_a_mission_and_leaves_the_truth(tmp_path: Path) -> None:
    mission = Mission(title="test", scene=box_scene(tmp_path), fleet=FleetSpec(vehicles=1),
                      site=SiteSpec(ground_up_m=0.0))
    endpoint, heard = free_endpoint(), {"ground": Heard(), "uav1": Heard()}
    process = bridge_process(mission, tmp_path, endpoint)
    threads = [participant("ground", endpoint, mission, heard["ground"], until(12)),
               participant("uav1", endpoint, mission, heard["uav1"], photographer(1, (0.0, -9.0, 5.0)))]
    _, errors = process.communicate(timeout=400)
    assert process.returncode == 0, errors.decode()
    for thread in threads:
        thread.join(JOIN_S)
    verdict = json.loads((tmp_path / "truth" / "referee.json").read_text(encoding="utf-8"))
    assert verdict["collisions"] == 0
    assert 4.0 <= verdict["min_clearance_m"] <= 5.0
    assert verdict["min_separation_m"] is None
    assert verdict["pictures"] == 3
    cover = verdict["coverage"]
    assert 0.0 < cover["per_view"][0] == cover["final"] == cover["auc"] <= cover["ceiling"] <= 1.0
    with np.load(tmp_path / "truth" / "reference_samples.npz") as samples:
        assert samples["points"].shape == samples["normals"].shape
        assert len(samples["points"]) > 10_000
        assert len(samples["parts"]) == 1
        assert samples["sample_part"].shape == (len(samples["points"]),)
        assert samples["triangle_part"].tolist() == [0] * 12
    assert len(trimesh.load_mesh(tmp_path / "truth" / "reference.ply").faces) == 12
    record = json.loads((tmp_path / "processes" / "bridge.json").read_text(encoding="utf-8"))
    assert record["frames"] == 3
    rows = (tmp_path / "truth" / "views.csv").read_text(encoding="utf-8").splitlines()
    assert [r.split(",")[4:7] for r in rows[1:]] == [["0.000000000", "-9.000000000", "5.000000000"]] * 3


@pytest.mark.loopback
def test_a_signal_in_flight_ends_it_with_the_truth_written(tmp_path: Path) -> None:
    mission = Mission(title="test", scene=box_scene(tmp_path), fleet=FleetSpec(vehicles=1),
                      site=SiteSpec(ground_up_m=0.0))
    endpoint, heard, asked = free_endpoint(), {"ground": Heard(), "uav1": Heard()}, threading.Event()
    process = bridge_process(mission, tmp_path, endpoint)

    def hang(_: Bus, turn: Turn) -> bool:
        if turn.tick == 4:
            process.send_signal(signal.SIGTERM)
            asked.wait(JOIN_S)
        return turn.tick < 4

    participant("ground", endpoint, mission, heard["ground"], hang)
    participant("uav1", endpoint, mission, heard["uav1"], photographer(1, (0.0, -9.0, 5.0)))
    _, errors = process.communicate(timeout=400)
    asked.set()
    assert process.returncode == 0, errors.decode()
    assert json.loads((tmp_path / "truth" / "referee.json").read_text(encoding="utf-8"))["pictures"] == 1
