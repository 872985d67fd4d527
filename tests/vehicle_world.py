"""A world for vehicles in one process: lock-step delivery, an analytic range sensor, a ground station that uploads."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions import topics
from missions.bus import Delivery
from missions.clock import BRIDGE, GROUND, vehicle_name
from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid
from missions.mavlink import (
    AUTOPILOT_COMPONENT,
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    Endpoint,
    Route,
    Waypoint,
    item_message,
    items_from_route,
    plan_sha256,
)
from missions.messages import (
    FenceVerdict,
    LegReport,
    MavlinkFrames,
    PictureAck,
    PictureChunk,
    PictureMeta,
    PlanHash,
    PlanVerdict,
    RangeScan,
    SensorPicture,
    ShutterRequest,
    SiteBrief,
    VehicleState,
)
from missions.mission import Mission
from missions.pads import fence_limit
from missions.sensors import RANGE_DIRECTIONS
from vehicle.vehicle import Vehicle

SITE = SiteBrief(object_min_enu_m=(-10.0, -2.0, 0.0), object_max_enu_m=(10.0, 2.0, 10.0), ground_up_m=0.0)
TICK_NS, LATENCY_NS, NS = 100_000_000, 10_000_000, 1_000_000_000
Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def box_ranges(position: Array, boxes: Iterable[Box], reach_m: float) -> Array:
    """Ranges along RANGE_DIRECTIONS to axis-aligned boxes and the ground z = 0, inf beyond reach."""
    d = np.where(np.abs(RANGE_DIRECTIONS) < 1e-12, 1e-12, RANGE_DIRECTIONS)
    best = np.where(d[:, 2] < 0, -position[2] / d[:, 2], np.inf)
    for lower, upper in boxes:
        t1, t2 = (np.array(lower) - position) / d, (np.array(upper) - position) / d
        near, far = np.minimum(t1, t2).max(axis=1), np.maximum(t1, t2).min(axis=1)
        best = np.minimum(best, np.where((near <= far) & (far >= 0), np.maximum(near, 0.0), np.inf))
    return np.where(best <= reach_m, best, np.inf)


def box_distance(points: Array, box: Box) -> Array:
    """(n,) distances of points (n, 3) to a box."""
    gap = np.maximum(np.maximum(np.array(box[0]) - points, points - np.array(box[1])), 0.0)
    return np.asarray(np.linalg.norm(gap, axis=1))


def open_map(mission: Mission, solid: Iterable[Box] = ()) -> VoxelGrid:
    """Everything that maps cover is free, but for these boxes."""
    grid = VoxelGrid.unknown(*fence_limit(mission, SITE), mission.explore.voxel_m)
    grid.state[:] = FREE
    centers = grid.centers(np.stack(np.indices(grid.state.shape), axis=-1))
    for lower, upper in solid:
        inside = np.all((centers >= np.array(lower) - 0.25) & (centers <= np.array(upper) + 0.25), axis=-1)
        grid.state[inside] = OCCUPIED
    return grid


def route(points: list[tuple[float, float, float]], *, plan_id: int = 1, stop: bool = True, first_view: int = 100,
          home_after: bool = False, phase: str = "explore") -> Route:
    """Waypoints at these points, each with a picture."""
    waypoints = [Waypoint(position_enu_m=p, yaw_enu_rad=0.3 * n, gimbal_elevation_rad=-0.1 * n, stop=stop, settle_s=0.3,
                          view_id=first_view + n) for n, p in enumerate(points)]
    return Route(plan_id=plan_id, phase=phase, waypoints=waypoints, home_after=home_after)


class World:
    """Vehicles, the bridge and the ground station of a test."""

    def __init__(self, mission: Mission, folder: Path, *, obstacles: Iterable[Box] = (),
                 acknowledge: bool = True) -> None:
        self.mission, self.obstacles, self.acknowledge = mission, list(obstacles), acknowledge
        self.vehicles = {k: Vehicle(mission, SITE, k, folder / str(k)) for k in range(1, mission.fleet.vehicles + 1)}
        for k in self.vehicles:
            (folder / str(k)).mkdir(exist_ok=True)
        self.t_ns, self.ground_alive = 0, True
        self.inbox: dict[int, list[Delivery]] = {k: [] for k in self.vehicles}
        self.endpoint = Endpoint(GROUND_SYSTEM, GROUND_COMPONENT)
        self.plans: dict[int, list[Any]] = {}
        self.site = mission.site.anchor
        self.states: dict[int, list[VehicleState]] = {k: [] for k in self.vehicles}
        self.verdicts: list[PlanVerdict] = []
        self.fence_verdicts: list[FenceVerdict] = []
        self.reports: list[LegReport] = []
        self.shutters: list[ShutterRequest] = []
        self.chunks: list[PictureChunk] = []
        self.mavlink: dict[int, list[Any]] = {k: [] for k in self.vehicles}

    def upload(self, plan: Route, to: int, *, start: bool = True, sha256: str | None = None) -> None:
        """Announce and offer a plan."""
        self.plans[to] = items_from_route(plan, self.site)
        self.send(to, topics.PLAN_HASH, PlanHash(plan_id=plan.plan_id, count=len(self.plans[to]),
                                                 sha256=sha256 or plan_sha256(self.plans[to])))
        self.tell(to, mav.MAVLink_mission_count_message(to, AUTOPILOT_COMPONENT, len(self.plans[to])))
        self.start_when_accepted = start

    def command(self, to: int, command: int, *params: float) -> None:
        """COMMAND_LONG."""
        values = [*params, *([0.0] * (7 - len(params)))]
        self.tell(to, mav.MAVLink_command_long_message(to, AUTOPILOT_COMPONENT, command, 0, *values))

    def tell(self, to: int, *messages: Any) -> None:
        """MAVLink frames from the ground."""
        self.send(to, topics.MAVLINK_DOWN, MavlinkFrames(frames=[self.endpoint.pack(m) for m in messages]))

    def send(self, to: int, topic: Any, message: Any, sender: str = GROUND) -> None:
        """A message that vehicle `to` gets at its next tick."""
        self.inbox[to].append(Delivery(topic, str(to), sender, self.t_ns, message))

    def share_map(self, grid: VoxelGrid) -> None:
        """A snapshot to all."""
        for k in self.vehicles:
            self.send(k, topics.MAP_SNAPSHOT, grid.to_message(self.t_ns))

    def tick(self) -> None:
        """One tick of everybody."""
        ground = {GROUND} if self.ground_alive else set()
        names = frozenset({BRIDGE, *map(vehicle_name, self.vehicles)} | ground)
        inbox, self.inbox = self.inbox, {k: [] for k in self.vehicles}
        for box in inbox.values():
            box.sort(key=lambda d: d.topic.key("f", d.who))
        sent = [(k, o) for k, v in sorted(self.vehicles.items()) for o in v.step(self.t_ns, inbox[k], names)]
        for k, (topic, message, _) in sent:
            self._carry(k, topic, message)
        wake = min(v.wake_ns for v in self.vehicles.values())
        self.t_ns = min((self.t_ns // TICK_NS + 1) * TICK_NS, max(self.t_ns + LATENCY_NS, wake))

    def run(self, seconds: float, until: Any = None) -> bool:
        """Ticks until the condition holds; whether it did."""
        end = self.t_ns + round(seconds * NS)
        while self.t_ns < end:
            self.tick()
            if until is not None and until():
                return True
        return until is None

    def landed(self) -> bool:
        """Whether all are on the ground again."""
        return all(not v.executor.flying for v in self.vehicles.values())

    def views(self) -> list[int]:
        """Views whose shutter opened, in order."""
        return [s.view_id for s in self.shutters]

    def path(self, k: int) -> Array:
        """(n, 3) positions told."""
        return np.array([s.position_enu_m for s in self.states[k]])

    def _carry(self, k: int, topic: Any, message: Any) -> None:
        if topic in (topics.VEHICLE_STATE, topics.ANNOUNCED):
            for other in self.vehicles:
                if other != k:
                    self.send(other, topic, message, vehicle_name(k))
        if isinstance(message, VehicleState):
            self.states[k].append(message)
            self._scan(k, message)
        elif isinstance(message, ShutterRequest):
            self._expose(k, message)
        elif isinstance(message, MavlinkFrames):
            self._ground_mavlink(k, message)
        elif isinstance(message, PlanVerdict):
            self.verdicts.append(message)
        elif isinstance(message, FenceVerdict):
            self.fence_verdicts.append(message)
        elif isinstance(message, LegReport):
            self.reports.append(message)
        elif isinstance(message, PictureChunk):
            self.chunks.append(message)
            if self.acknowledge and self.ground_alive:
                self.send(k, topics.PICTURE_ACK, PictureAck(view_id=message.meta.view_id, sha256=message.meta.sha256))

    def _scan(self, k: int, state: VehicleState) -> None:
        ranges = box_ranges(np.array(state.position_enu_m), self.obstacles, self.mission.fleet.range_sensor_m)
        self.send(k, topics.RANGE_SCAN, RangeScan(vehicle_id=k, t_ns=self.t_ns, position_enu_m=state.position_enu_m,
                                                  ranges_m=ranges.tolist()), BRIDGE)

    def _expose(self, k: int, request: ShutterRequest) -> None:
        self.shutters.append(request)
        jpeg = bytes([request.view_id % 256]) * 300_000
        meta = PictureMeta(vehicle_id=k, view_id=request.view_id, phase=request.phase, pose=request.pose,
                           t_capture_ns=request.t_capture_ns, position_sigma_m=0.0, speed_m_s=request.speed_m_s,
                           camera=request.camera, sha256=hashlib.sha256(jpeg).hexdigest(), size_bytes=len(jpeg))
        self.send(k, topics.SENSOR_PICTURE, SensorPicture(meta=meta, jpeg=jpeg), BRIDGE)

    def _ground_mavlink(self, k: int, message: MavlinkFrames) -> None:
        for m in Endpoint(GROUND_SYSTEM, GROUND_COMPONENT).parse(message.frames):
            self.mavlink[k].append(m)
            if not self.ground_alive:
                continue
            if m.get_type() == "MISSION_REQUEST_INT":
                self.tell(k, item_message(self.plans[k][m.seq], m.seq, k, AUTOPILOT_COMPONENT))
            elif m.get_type() == "MISSION_ACK" and m.type == mav.MAV_MISSION_ACCEPTED and self.start_when_accepted:
                self.command(k, mav.MAV_CMD_MISSION_START)
