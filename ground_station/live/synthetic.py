"""A mission that is made up, for measuring and trying the page: it tells the page what a ground station would, as fast
as wanted. Vehicles circle a bridge of boxes that comes into the map bit by bit."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from ground_station.live.model import LiveModel
from missions import live
from missions.camera import Camera, Pose
from missions.live import LiveMap, LivePicture, LivePlan, LiveSite, LiveState, LiveUpdate, LiveVehicle, OperatorAnswer
from missions.messages import Vector, vector

VOXEL_M, LOW, HIGH = 0.5, np.array([-30.0, -14.0, 0.0]), np.array([30.0, 14.0, 22.0])
BOXES = (((-28, -4, 10), (28, 4, 11)), ((-28, -4, 11), (28, -3.5, 12.5)), ((-28, 3.5, 11), (28, 4, 12.5)),
         ((-16, -3, 0), (-13, 3, 10)), ((13, -3, 0), (16, 3, 10)), ((-15, -4, 12), (-14, -3, 22)),
         ((14, -4, 12), (15, -3, 22)), ((-15, 3, 12), (-14, 4, 22)), ((14, 3, 12), (15, 4, 22)),
         ((-15, -3, 20), (-14, 3, 21)), ((14, -3, 20), (15, 3, 21)), ((-30, -7, 0), (-27, 7, 10)),
         ((27, -7, 0), (30, 7, 10)))
STEP_S = 0.25
PICTURE_EVERY, PLAN_EVERY = 12, 240
"""Steps between two pictures, and two plans, of a vehicle."""
MAPPED_AFTER_S = 240.0
CAMERA = Camera.from_diagonal_fov(456, 256, 84.0)


class SyntheticMission:
    """Call `step` as often as a quarter of a second of flight is to pass. Everything goes through JSON, as it would."""

    def __init__(self, vehicles: int, folder: Path) -> None:
        """folder: for the pictures' files."""
        self.over = False
        self._vehicles, self._folder = vehicles, folder
        self._model, self._lock = LiveModel(), threading.Lock()
        self._steps, self._paused = 0, set[int]()
        self._angle_rad = np.arange(vehicles) * 2.0 * math.pi / vehicles
        self._solid = _bridge()
        self._told = 0
        self._images = [_image(folder / f"picture_{n}.jpg", n) for n in range(8)]
        self.step()

    @property
    def t_s(self) -> float:
        """Of flight."""
        return self._steps * STEP_S

    @contextmanager
    def reading(self) -> Iterator[LiveModel]:
        """As a mission under way."""
        with self._lock:
            yield self._model

    def do(self, action: live.AnyAction) -> OperatorAnswer:
        """Vehicles pause and resume; all else is only agreed to."""
        which = getattr(action, "vehicle_id", live.ALL)
        who = set(range(1, self._vehicles + 1)) if which == live.ALL else {which}
        if isinstance(action, live.Pause):
            self._paused |= who
        elif isinstance(action, live.Resume):
            self._paused -= who
        return OperatorAnswer(command_id="", accepted=True, text=type(action).__name__)

    def step(self) -> None:
        """A quarter of a second passes."""
        moving = np.array([k + 1 not in self._paused for k in range(self._vehicles)])
        self._angle_rad = self._angle_rad + moving * 0.02
        update = LiveUpdate(seq=self._steps + 1, whole=self._steps == 0, site=_site(self._vehicles),
                            state=self._state(), plans=self._plans(), pictures=self._pictures(), map=self._map(),
                            curve=[(self.t_s, self._share, 0.0)] if self._steps % 8 == 0 else [])
        self._steps += 1
        with self._lock:
            self._model.apply(msgspec.json.decode(msgspec.json.encode(update), type=LiveUpdate))

    @property
    def _share(self) -> float:
        return round(1.0 - math.exp(-3.0 * self.t_s / MAPPED_AFTER_S), 4)

    def _at(self, vehicle: int, ahead_rad: float = 0.0) -> Vector:
        a = float(self._angle_rad[vehicle]) + ahead_rad
        return (round(36.0 * math.cos(a), 3), round(16.0 * math.sin(a), 3),
                round(9.0 + 5.0 * math.sin(0.7 * a + vehicle), 3))

    def _pose(self, vehicle: int) -> Pose:
        x, y, z = self._at(vehicle)
        tx, ty, tz = 0.5 * x, 0.0, 9.0
        return Pose((x, y, z), math.atan2(ty - y, tx - x), math.atan2(tz - z, math.hypot(tx - x, ty - y)))

    def _state(self) -> LiveState:
        battery = max(5.0, 100.0 - 0.05 * self.t_s)
        vehicles = [LiveVehicle(
            vehicle_id=k + 1, stage="flying", mode="mission", position_enu_m=self._at(k),
            yaw_enu_rad=self._pose(k).yaw_enu_rad, gimbal_elevation_rad=self._pose(k).elevation_rad, speed_m_s=3.0,
            battery_percent=max(5.0, battery - 3.0 * k), home_percent=4.0 + k, views_done=self._steps // PICTURE_EVERY,
            views_left=40, next_waypoint=0, flying=True, held=k + 1 in self._paused, dropped=False,
            trail_enu_m=[self._at(k)]) for k in range(self._vehicles)]
        return LiveState(
            phase="explore", started=True, t_s=self.t_s, wall_s=self.t_s, coverage=self._share, goal_coverage=None,
            views_done=0, views_total=0, pictures=self._vehicles * (self._steps // PICTURE_EVERY), seconds_left=0.0,
            fence_lower_enu_m=_site(1).fence_lower_enu_m, fence_upper_enu_m=_site(1).fence_upper_enu_m,
            vehicles=vehicles, regions=[], alarms=[], note="")

    def _plans(self) -> list[LivePlan]:
        if self._steps % PLAN_EVERY:
            return []
        return [LivePlan(vehicle_id=k + 1, waypoints_enu_m=[self._at(k, 0.08 * n) for n in range(1, 12)],
                         later_enu_m=[self._at(k, 0.08 * n) for n in range(12, 40)]) for k in range(self._vehicles)]

    def _pictures(self) -> list[LivePicture]:
        if self._steps % PICTURE_EVERY:
            return []
        first = self._vehicles * (self._steps // PICTURE_EVERY)
        return [LivePicture(vehicle_id=k + 1, view_id=first + k, phase="explore", t_s=self.t_s, pose=self._pose(k),
                            camera=CAMERA, file=str(self._images[(first + k) % len(self._images)]))
                for k in range(self._vehicles)]

    def _map(self) -> LiveMap | None:
        upto = round(self._share * len(self._solid))
        if self._steps % 16 or upto == self._told:
            return None
        new, self._told = self._solid[self._told:upto], upto
        return LiveMap(origin_enu_m=vector(LOW), voxel_m=VOXEL_M, solid=[(i, j, k) for i, j, k in new.tolist()],
                       gone=[])


def _site(vehicles: int) -> LiveSite:
    return LiveSite(title="Synthetic bridge", object_lower_enu_m=vector(LOW), object_upper_enu_m=vector(HIGH),
                    ground_up_m=0.0, fence_lower_enu_m=(-52.0, -40.0, 0.0), fence_upper_enu_m=(52.0, 36.0, 44.0),
                    limit_lower_enu_m=(-60.0, -48.0, 0.0), limit_upper_enu_m=(60.0, 44.0, 52.0),
                    pads_enu_m=[(6.0 * k - 3.0 * vehicles, -30.0, 0.2) for k in range(vehicles)],
                    survey_range_m=14.0, reserve_percent=5.0, threshold_percent=20.0)


def _bridge() -> NDArray[np.int64]:
    """(n, 3) the surface voxels of the bridge, from one end to the other."""
    solid = np.zeros(tuple(((HIGH - LOW) / VOXEL_M).astype(int)), dtype=np.bool_)
    for low, high in BOXES:
        first, last = (((np.array(p) - LOW) / VOXEL_M).astype(int) for p in (low, high))
        solid[tuple(slice(a, b) for a, b in zip(first, last, strict=True))] = True
    index = np.argwhere(solid)
    return index[np.argsort(index[:, 0] + 3.0 * np.sin(index[:, 1] * 1.7 + index[:, 2]), kind="stable")]


def _image(path: Path, number: int) -> Path:
    ramp = np.linspace(60, 200, CAMERA.width_px, dtype=np.uint8)
    picture = np.repeat(ramp[None], CAMERA.height_px, axis=0)
    cv2.imwrite(str(path), cv2.applyColorMap(np.roll(picture, 40 * number, axis=1), cv2.COLORMAP_BONE))
    return path
