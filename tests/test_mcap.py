"""The recording for Foxglove, read back with the mcap package and its own schemas."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from pymavlink.dialects.v20 import common as mav

from ground_station.cli import main
from missions.camera import Pose
from missions.clock import SECOND_NS
from missions.flight_plan import item_from_params
from missions.frames import Site
from missions.mavlink import Endpoint, Route, Waypoint, item_message, items_from_route
from missions.mission import FleetSpec, Mission, SiteSpec
from missions.mission_file import write_mission
from missions.run_folder import RunFolder, write_views
from missions.tlog import Tlog
from perception.reconstruct.cloud import Cloud, write_cloud

MISSION = Mission(title="Tower", fleet=FleetSpec(vehicles=2), site=SiteSpec(
    origin_lat_deg=47.4, origin_lon_deg=8.55, origin_alt_m=488.0, object_min_enu_m=(-5.0, -5.0, 0.0),
    object_max_enu_m=(5.0, 5.0, 10.0), ground_up_m=0.0))
EPOCH_S = datetime.fromisoformat(MISSION.clock.epoch_utc).timestamp()
ANCHOR = Site(47.4, 8.55, 488.0)
CORNERS = [(0.0, 20.0, 5.0), (10.0, 20.0, 8.0), (10.0, -20.0, 8.0)]
SECONDS = 12
POSE = Pose((1.0, 20.0, 5.5), -math.pi / 2.0, -0.2)


def telemetry(vehicle_id: int, second: int) -> list[bytes]:
    """A vehicle that flies east at 1 m/s, looking north."""
    end, ms = Endpoint(vehicle_id, 1), second * 1000
    position = np.array([float(second), 20.0, 5.0 + vehicle_id])
    lat, lon, alt = ANCHOR.geodetic_from_enu(position)
    place = round(lat * 1e7), round(lon * 1e7), round(alt * 1000)
    return [end.pack(m) for m in (
        mav.MAVLink_attitude_message(ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        mav.MAVLink_local_position_ned_message(ms, position[1], position[0], -position[2], 0.0, 1.0, 0.0),
        mav.MAVLink_global_position_int_message(ms, *place, 0, 0, 0, 0, 0),
        mav.MAVLink_battery_status_message(0, 1, 1, 0, [0] * 10, -1, -1, -1, 100 - second))]


def plan_upload() -> list[bytes]:
    ground, vehicle = Endpoint(255, 190), Endpoint(1, 1)
    items = items_from_route(Route(plan_id=1, phase="survey", waypoints=[
        Waypoint(position_enu_m=c, yaw_enu_rad=0.0, view_id=n) for n, c in enumerate(CORNERS)]), ANCHOR)
    return [ground.pack(mav.MAVLink_mission_count_message(1, 1, len(items))),
            *(ground.pack(item_message(item, seq, 1, 1)) for seq, item in enumerate(items)),
            vehicle.pack(mav.MAVLink_mission_ack_message(255, 190, mav.MAV_MISSION_ACCEPTED))]


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """A run as a ground station that was killed leaves it: neither flight.json nor trajectories.npz."""
    run = RunFolder(tmp_path)
    write_mission(MISSION, run.mission)
    tlog = Tlog(run.tlog, MISSION.clock.epoch_utc)
    for second in range(SECONDS):
        tlog.write(telemetry(1, second) + telemetry(2, second), second * SECOND_NS)
        if second == 2:
            tlog.write(plan_upload(), second * SECOND_NS)
            tlog.write([Endpoint(1, 1).pack(mav.MAVLink_statustext_message(4, b"battery low"))], second * SECOND_NS)
    tlog.flush()
    camera = MISSION.camera.survey_camera()
    cv2.imwrite(str(run.picture(1, 10001)), np.full((camera.height_px, camera.width_px, 3), 128, np.uint8))
    rows: list[list[Any]] = [
        [view, 1, "survey", 4.0 + view % 2, *POSE.position_enu_m, *POSE.quaternion_wxyz, 0.0,
         run.picture(1, view).relative_to(run.root).as_posix()] for view in (10001, 10002)]
    write_views(run.views_csv, rows)
    return run


def read(path: Path) -> Iterator[tuple[str, str, float, Any]]:
    """(topic, schema, simulated time in s, message), decoded with the schemas in the file."""
    with path.open("rb") as f:
        for schema, channel, message in make_reader(f).iter_messages():
            if channel.message_encoding == "json":
                decoded: Any = json.loads(message.data)
            else:
                pool = descriptor_pool.DescriptorPool()
                for proto in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(proto)
                kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
                decoded = kind.FromString(message.data)
                if decoded.DESCRIPTOR.fields_by_name.get("timestamp"):
                    assert decoded.timestamp.ToNanoseconds() == message.log_time
            yield channel.topic, schema.name, message.log_time / 1e9 - EPOCH_S, decoded


def recording(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> list[tuple[str, str, float, Any]]:
    assert main(["missions", "export", str(run.root), "--format", "mcap", "--json"]) == 0
    told = {row["topic"]: row["messages"] for row in json.loads(capsys.readouterr().out)}
    messages = list(read(run.recording))
    assert Counter(topic for topic, *_ in messages) == told
    assert [t for _, _, t, _ in messages] == sorted(t for _, _, t, _ in messages)
    return messages


def test_a_run_that_crashed_is_shown_with_all_that_it_left(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    messages = recording(run, capsys)
    assert {(topic, schema) for topic, schema, *_ in messages} == {
        ("/tf", "foxglove.FrameTransform"), ("/log", "foxglove.Log"),
        ("/site/object", "foxglove.SceneUpdate"), ("/site/geofence", "foxglove.SceneUpdate"),
        ("/uav1/camera/picture", "foxglove.CompressedImage"),
        ("/uav1/camera/calibration", "foxglove.CameraCalibration"), ("/uav1/plan", "foxglove.SceneUpdate"),
        *((f"/uav{k}/{name}", schema) for k in (1, 2) for name, schema in (
            ("pose", "foxglove.PoseInFrame"), ("location", "foxglove.LocationFix"),
            ("battery", "swarmscan.battery"), ("trail", "foxglove.SceneUpdate")))}
    by_topic = {topic: message for topic, _, _, message in messages}
    assert by_topic["/uav1/battery"] == {"percent": 100 - SECONDS + 1}
    at = by_topic["/uav2/pose"].pose
    assert (at.position.x, at.position.y, at.position.z) == (SECONDS - 1, 20.0, 7.0)
    assert (at.orientation.w, at.orientation.z) == (pytest.approx(0.5**0.5), pytest.approx(0.5**0.5))
    place = by_topic["/uav1/location"]
    assert ANCHOR.enu_from_geodetic(place.latitude, place.longitude, place.altitude) == pytest.approx(
        (SECONDS - 1, 20.0, 6.0), abs=0.01)
    assert (by_topic["/log"].message, by_topic["/log"].name) == ("battery low", "uav1")


def test_trails_are_whole_and_plans_are_where_they_were_sent(run: RunFolder,
                                                             capsys: pytest.CaptureFixture[str]) -> None:
    messages = recording(run, capsys)
    trail = [e for topic, _, _, m in messages if topic == "/uav1/trail" for e in m.entities]
    assert [e.id for e in trail] == ["trail 1", "trail 2"]
    east = [[p.x for p in e.lines[0].points] for e in trail]
    assert east == [[0, 1, 2, 3, 4, 5], [5, 6, 7, 8, 9, 10]]
    (t_s, plan), = [(t, m) for topic, _, t, m in messages if topic == "/uav1/plan"]
    assert t_s == pytest.approx(2.0)
    points = [(p.x, p.y, p.z) for p in plan.entities[0].lines[0].points]
    assert np.array(points) == pytest.approx(np.array(CORNERS), abs=0.01)
    fence, = [m for topic, _, _, m in messages if topic == "/site/geofence"]
    assert len(fence.entities[0].lines[0].points) == 24


def test_pictures_are_small_and_their_cameras_look_where_they_looked(
        run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    messages = recording(run, capsys)
    by_topic = {topic: (t, m) for topic, _, t, m in messages}
    t_s, picture = by_topic["/uav1/camera/picture"]
    assert t_s == pytest.approx(5.0)
    small = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)
    calibration = by_topic["/uav1/camera/calibration"][1]
    assert small.shape == (calibration.height, calibration.width, 3) == (180, 320, 3)
    assert calibration.K[2] == 160.0
    turned, = [m for topic, _, _, m in messages if topic == "/tf" and m.child_frame_id == picture.frame_id]
    q = turned.rotation
    assert (q.w, q.x, q.y, q.z) == pytest.approx(tuple(POSE.quaternion_wxyz), abs=1e-8)


def test_coverage_and_cloud_are_added_where_the_run_has_them(run: RunFolder,
                                                             capsys: pytest.CaptureFixture[str]) -> None:
    run.flight.write_text(json.dumps({"exploration": {"views": [{"view_id": 10002, "coverage": 0.5},
                                                                {"view_id": 77, "coverage": 0.7}]}}))
    points = np.arange(30, dtype=np.float32).reshape(10, 3)
    write_cloud(Cloud(points, np.full((10, 3), 200, np.uint8), np.tile(np.float32([0, 0, 1]), (10, 1)),
                      np.ones(10, np.uint8)), run.cloud)
    messages = recording(run, capsys)
    assert [m for topic, _, _, m in messages if topic == "/coverage"] == [{"coverage": 0.5}]
    (t_s, cloud), = [(t, m) for topic, _, t, m in messages if topic == "/cloud"]
    assert t_s == pytest.approx(SECONDS - 1)
    got = np.frombuffer(cloud.data, np.dtype([("p", "<f4", 3), ("c", "u1", 4)]))
    assert (got["p"] == points).all()
    assert (got["c"] == (200, 200, 200, 255)).all()
    assert cloud.point_stride == got.itemsize


def test_without_a_ground_station_of_ours_what_passed_the_doors_is_shown(
        run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    """A client of another make, whose plan has altitudes above home."""
    client, vehicle = Endpoint(245, 190), Endpoint(1, 1)
    item = item_from_params(3, mav.MAV_CMD_NAV_WAYPOINT, (0, 0, 0, 0, 47.4, 8.55, 12.0), "drawn")
    log = Tlog(run.door_tlog, MISSION.clock.epoch_utc)
    log.write([vehicle.pack(mav.MAVLink_home_position_message(0, 0, 0, 0.0, 0.0, -0.5, [1, 0, 0, 0], 0, 0, 0)),
               client.pack(mav.MAVLink_mission_count_message(1, 1, 1)), client.pack(item_message(item, 0, 1, 1)),
               vehicle.pack(mav.MAVLink_mission_ack_message(245, 190, mav.MAV_MISSION_ACCEPTED))], 0)
    log.flush()
    run.tlog.unlink()
    plan, = [m for topic, _, _, m in recording(run, capsys) if topic == "/uav1/plan"]
    assert [(p.x, p.y, p.z) for p in plan.entities[0].lines[0].points] == [pytest.approx((0.0, 0.0, 12.5))]


def test_without_a_telemetry_log_there_is_nothing_to_show(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    run.tlog.unlink()
    assert main(["missions", "export", str(run.root), "--format", "mcap"]) == 2
    assert "flight.tlog: no telemetry log" in capsys.readouterr().err
