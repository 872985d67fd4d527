"""`swarmscan missions export RUN --format mcap`: the whole run for Foxglove (foxglove.dev), on its simulated clock.

Vehicles, trails, plans, pictures, batteries, coverage, and the cloud at the end. Made after the flight of what even one
that crashed leaves behind (telemetry log, views.csv, pictures) and, where they are there, of flight.json and the cloud,
so that nothing is recorded twice and the flight pays nothing; of `swarmscan simulate`, of what passed the doors.
Frame `site` is the mission's ENU frame.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import foxglove
import numpy as np
from foxglove import channels
from foxglove import messages as fox

from ground_station.mcap_flights import Flights
from ground_station.mcap_shapes import (
    FENCE_COLOUR,
    OBJECT_COLOUR,
    SITE,
    Event,
    Stamps,
    box,
    pose,
    transform,
)
from ground_station.report.run_data import RunData
from missions.camera import Camera
from missions.messages import SiteBrief
from missions.pads import geofence
from missions.tlog import read_tlog
from perception.reconstruct.cloud import read_cloud

THUMBNAIL_PX, JPEG_QUALITY = 320, 75
CLOUD_POINTS = 300_000
"""At most so many; more make players slow."""
_CLOUD_TYPE = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
                        ("alpha", "u1")])
_FIELD_TYPES = {"f": fox.PackedElementFieldNumericType.Float32, "u": fox.PackedElementFieldNumericType.Uint8}
_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def write_recording(data: RunData, path: Path) -> dict[str, int]:
    """Write the recording of a run; returns how many messages went out on each topic.

    Raises UserError where the run has no telemetry log, OSError when the file cannot be written.
    """
    stamps = Stamps(datetime.fromisoformat(data.mission.clock.epoch_utc).timestamp())
    path_of_log = data.run.tlog if data.run.tlog.is_file() or not data.run.door_tlog.is_file() else data.run.door_tlog
    log = read_tlog(path_of_log, data.mission.clock.epoch_utc)
    flown = list(Flights(data.mission.site.anchor, stamps).events(log))
    end_s = flown[-1].t_s if flown else 0.0
    shown = [*_boxes(data, stamps), *flown, *_pictures(data, stamps), *_coverage(data), *_cloud(data, stamps, end_s)]
    context = foxglove.Context()
    open_channels: dict[str, Any] = {}
    with foxglove.open_mcap(path, allow_overwrite=True, context=context):
        for event in sorted(shown, key=lambda e: e.t_s):
            if event.topic not in open_channels:
                open_channels[event.topic] = _channel(event, context)
            open_channels[event.topic].log(event.message, log_time=stamps.ns(event.t_s))
    return dict(sorted(Counter(e.topic for e in shown).items()))


def _channel(event: Event, context: foxglove.Context) -> Any:
    if isinstance(event.message, dict):
        numbers = {name: {"type": "number"} for name in event.message}
        schema = {"type": "object", "title": f"swarmscan.{event.topic.rpartition('/')[2]}", "properties": numbers}
        return foxglove.Channel(event.topic, schema=schema, context=context)
    return getattr(channels, f"{type(event.message).__name__}Channel")(event.topic, context=context)


def _boxes(data: RunData, stamps: Stamps) -> Iterator[Event]:
    """Geofence and the object's box, where the run knows them."""
    if data.box is not None and data.ground_up_m is not None:
        lower, upper = data.box
        brief = SiteBrief(object_min_enu_m=tuple(lower), object_max_enu_m=tuple(upper), ground_up_m=data.ground_up_m)
        yield Event(0.0, "/site/object", box(stamps(0.0), "object", lower, upper, OBJECT_COLOUR))
        yield Event(0.0, "/site/geofence",
                    box(stamps(0.0), "geofence", *geofence(data.mission, brief), FENCE_COLOUR))


def _pictures(data: RunData, stamps: Stamps) -> Iterator[Event]:
    """A thumbnail of each picture, and the camera that took it."""
    spec = data.mission.camera
    for view in data.views:
        camera = spec.survey_camera() if view.phase == "survey" else spec.explore_camera()
        small = camera.scaled(THUMBNAIL_PX, round(THUMBNAIL_PX * camera.height_px / camera.width_px))
        jpeg = _thumbnail(data.run.root / view.path, small)
        if jpeg is None:
            continue
        name, stamp = f"uav{view.vehicle_id}/camera", stamps(view.t_capture_s)
        turned = np.array([view.qw, view.qx, view.qy, view.qz])
        yield Event(view.t_capture_s, "/tf", transform(stamp, name, view.position_enu_m, turned))
        yield Event(view.t_capture_s, f"/{name}/calibration", fox.CameraCalibration(
            timestamp=stamp, frame_id=name, width=small.width_px, height=small.height_px,
            K=[float(k) for k in small.matrix.ravel()],
            P=[float(k) for k in np.pad(small.matrix, ((0, 0), (0, 1))).ravel()]))
        yield Event(view.t_capture_s, f"/{name}/picture", fox.CompressedImage(
            timestamp=stamp, frame_id=name, data=jpeg, format="jpeg"))


def _thumbnail(path: Path, camera: Camera) -> bytes | None:
    """None for a picture that is missing or torn."""
    picture = cv2.imread(str(path), cv2.IMREAD_REDUCED_COLOR_4) if path.is_file() else None
    if picture is None:
        return None
    small = cv2.resize(picture, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])


def _coverage(data: RunData) -> Iterator[Event]:
    """What exploration believed to have seen, at each of its key views."""
    taken_s = {view.view_id: view.t_capture_s for view in data.views}
    for row in data.flight.get("exploration", {}).get("views", []):
        if row["view_id"] in taken_s:
            yield Event(taken_s[row["view_id"]], "/coverage", {"coverage": row["coverage"]})


def _cloud(data: RunData, stamps: Stamps, end_s: float) -> Iterator[Event]:
    """The reconstruction, when all have landed."""
    if not data.run.cloud.is_file():
        return
    cloud = read_cloud(data.run.cloud)
    cloud = cloud.select(np.linspace(0, len(cloud) - 1, min(len(cloud), CLOUD_POINTS)).astype(np.int64))
    packed = np.zeros(len(cloud), _CLOUD_TYPE)
    for k, (axis, channel) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        packed[axis], packed[channel] = cloud.points_enu_m[:, k], cloud.colours[:, k]
    packed["alpha"] = 255
    fields = [fox.PackedElementField(name=name, offset=place[1], type=_FIELD_TYPES[place[0].kind])
              for name, place in (_CLOUD_TYPE.fields or {}).items()]
    yield Event(end_s, "/cloud", fox.PointCloud(
        timestamp=stamps(end_s), frame_id=SITE, pose=pose(np.zeros(3), _LEVEL), point_stride=_CLOUD_TYPE.itemsize,
        fields=fields, data=packed.tobytes()))
