"""One vehicle without its wires: messages and time in, messages out."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions import topics
from missions.bus import Delivery
from missions.clock import GROUND
from missions.errors import ProtocolError
from missions.grid import VoxelGrid
from missions.mavlink import Item, plan_sha256, route_from_items
from missions.messages import (
    AnnouncedTrajectory,
    BatterySwap,
    LegReport,
    MapSnapshot,
    MavlinkFrames,
    Message,
    PictureAck,
    PlanHash,
    PlanVerdict,
    RangeHits,
    RangeScan,
    SensorPicture,
    SiteBrief,
    VehicleState,
)
from missions.mission import Mission
from missions.pads import geofence, hover_points, takeoff_points
from missions.topics import Topic
from planning.trajectories import Limits
from planning.trajectories.energy import energy_of
from vehicle.autopilot import Autopilot
from vehicle.avoidance import Avoidance
from vehicle.battery import Battery
from vehicle.camera import CameraPayload, intact
from vehicle.executor import Executor
from vehicle.failsafe import Condition, Failsafe
from vehicle.mission_service import MissionService
from vehicle.pilot import Pilot
from vehicle.plan_check import refusal
from vehicle.sensor_memory import SensorMemory
from vehicle.simulator import NS, Kinematics, KinematicSimulator, vector
from vehicle.teammates import Teammates

log = logging.getLogger(__name__)

Outgoing = tuple[Topic[Any], Message, int]
IDLE_STATE_NS = NS


class Vehicle:
    """All that one vehicle does in a tick. Decisions depend on deliveries and simulated time alone."""

    def __init__(self, mission: Mission, site: SiteBrief, vehicle_id: int, storage: Path,
                 memory: SensorMemory | None = None) -> None:
        """storage: folder of the vehicle's own memory card. memory: what it knows of space; nothing when left out."""
        self.id, self.mission = vehicle_id, mission
        fleet, n = mission.fleet, vehicle_id - 1
        pad = np.array(takeoff_points(mission, site)[n])
        hover = np.array(hover_points(mission, site)[n])
        self.fence = geofence(mission, site)
        self.site = mission.site.anchor
        battery = mission.battery
        self.battery = Battery(battery.start_of(vehicle_id), energy_of(mission))
        self.simulator = KinematicSimulator(pad, math.pi / 2.0)
        self.memory = memory or SensorMemory.of(mission, site)
        self.teammates = Teammates(vehicle_id)
        self.avoidance = Avoidance(self.memory, self.teammates, fleet, self.fence)
        self.pilot = Pilot(vehicle_id, self.simulator, self.avoidance, Limits.of_fleet(fleet))
        self.camera = CameraPayload(vehicle_id, mission.camera, storage)
        self.executor = Executor(self.pilot, self.battery, mission.battery, self.camera, pad, hover,
                                 fleet.vehicles - 1)
        self.missions = MissionService(self._judge, self.executor.jump)
        self.autopilot = Autopilot(vehicle_id, self.site, self.executor, self.missions)
        self.failsafe = Failsafe()
        self.wake_ns = 0
        self._out: list[Outgoing] = []
        self._hash: PlanHash | None = None
        self._accepted: PlanHash | None = None
        self._ground_heard_ns = 0
        self._ground_takes_part = True
        self._t_ns = 0
        self._state_ns = -IDLE_STATE_NS

    def step(self, t_ns: int, deliveries: list[Delivery], participants: frozenset[str]) -> list[Outgoing]:
        """One tick: take in, move, decide, tell. Returns (topic, message, id in the key)."""
        if self.executor.flying:
            self.battery.spend(self.simulator.flight.curve, *map(self.simulator.elapsed_s, (self._t_ns, t_ns)))
        self.battery.step(t_ns)
        self._t_ns = t_ns
        self._ground_takes_part = GROUND in participants
        self.teammates.note_participants(participants)
        for delivery in deliveries:
            self._receive(delivery)
        self._guard(t_ns)
        self.executor.step(t_ns)
        self._tell(t_ns)
        self.wake_ns = self.executor.wake_ns or t_ns + NS
        out, self._out = self._out, []
        return out

    def _receive(self, delivery: Delivery) -> None:
        if delivery.sender == GROUND:
            self._ground_heard_ns = self._t_ns
        handler = _HANDLERS.get(type(delivery.message))
        try:
            if handler is not None:
                handler(self, delivery.message)
        except ProtocolError as e:
            log.warning("uav%d: refused a message from %s: %s", self.id, delivery.sender, e)

    def _mavlink(self, message: MavlinkFrames) -> None:
        self.autopilot.receive(message.frames, self._t_ns)

    def _plan_hash(self, message: PlanHash) -> None:
        self._hash = message

    def _map(self, message: MapSnapshot) -> None:
        self.memory.put_map(VoxelGrid.from_message(message))

    def _battery_swap(self, message: BatterySwap) -> None:
        if not self.executor.flying and not self.battery.swapping:
            self.battery.begin_swap(self._t_ns + round(self.mission.battery.swap_s * NS))

    def _scan(self, message: RangeScan) -> None:
        if message.vehicle_id == self.id:
            self.memory.put_scan(message, self.teammates.positions(self._t_ns), self.mission.fleet.separation_m / 2.0)

    def _teammate(self, message: VehicleState | AnnouncedTrajectory) -> None:
        if message.vehicle_id != self.id:
            self.teammates.hear(message)

    def _picture(self, message: SensorPicture) -> None:
        if message.meta.vehicle_id != self.id:
            return
        if not intact(message):
            raise ProtocolError(f"picture of view {message.meta.view_id} does not match its SHA-256")
        for chunk in self.camera.store(message, self._t_ns):
            self._send(topics.PICTURE_CHUNK, chunk)
        self.autopilot.captured(message.meta)

    def _picture_ack(self, message: PictureAck) -> None:
        for chunk in self.camera.acknowledge(message, self._t_ns):
            self._send(topics.PICTURE_CHUNK, chunk)

    def _judge(self, items: list[Item]) -> bool:
        """Accept or refuse a whole plan; nothing uploaded means the plan is cleared."""
        if not items:
            self._accepted = None
            self.executor.drop_plan()
            return True
        sha256, announced = plan_sha256(items), self._hash
        if announced is None or announced.sha256 != sha256 or announced.count != len(items):
            plan_id = announced.plan_id if announced is not None else 0
            return self._verdict(plan_id, sha256, "hash: the plan received is not the one that was announced")
        if self._accepted == announced:
            return self._verdict(announced.plan_id, sha256, "")
        try:
            route = route_from_items(items, self.site, announced.plan_id)
        except ProtocolError as e:
            return self._verdict(announced.plan_id, sha256, f"items: {e}")
        reason = refusal(route, self.pilot.position(self._t_ns), self.fence, self.mission.fleet, self.mission.battery,
                         self.avoidance, self.battery, self.executor.way_home)
        if not reason:
            self._accepted = announced
            self.executor.take(route, _item_groups(items))
        return self._verdict(announced.plan_id, sha256, reason)

    def _verdict(self, plan_id: int, sha256: str, reason: str) -> bool:
        self._send(topics.PLAN_VERDICT, PlanVerdict(plan_id=plan_id, sha256=sha256, accepted=not reason, reason=reason))
        if reason:
            self.autopilot.text(f"plan refused: {reason}", mav.MAV_SEVERITY_WARNING)
        return not reason

    def _guard(self, t_ns: int) -> None:
        here, way_home, spec = self.pilot.position(t_ns), self.executor.way_home, self.mission.battery
        condition = Condition(t_ns, self.battery.level_percent, spec.threshold_percent, spec.reserve_percent,
                              float(way_home.percent(here)), float(way_home.least_percent(here)),
                              self._ground_heard_ns, self._ground_takes_part)
        rule = self.failsafe.step(condition, self.executor)
        if rule is not None:
            self.autopilot.text(rule.name, rule.severity)
            log.info("uav%d: %s", self.id, rule.name)

    def _tell(self, t_ns: int) -> None:
        outbox = self.executor.outbox
        for request in outbox.shutters:
            self._send(topics.SHUTTER, request)
        for report in outbox.reports:
            self._send(topics.LEG_REPORT, report)
        for text in outbox.texts:
            self.autopilot.text(text)
        self.autopilot.reached(outbox.reached)
        outbox.clear()
        if self._ground_takes_part:
            for chunk in self.camera.send_again(t_ns):
                self._send(topics.PICTURE_CHUNK, chunk)
        for view_id in self.camera.lost(t_ns):
            log.warning("uav%d: no picture came for view %d", self.id, view_id)
            self._send(topics.LEG_REPORT, LegReport(
                plan_id=self._accepted.plan_id if self._accepted is not None else 0, view_id=view_id,
                outcome="unreachable", detail="the camera gave no picture"))
        hits = self.memory.take_untold()
        if len(hits):
            self._send(topics.RANGE_HITS, RangeHits(t_ns=t_ns, points_enu_m=[vector(p) for p in hits]))
        announcement = self.pilot.helm.announcement(t_ns)
        if announcement is not None:
            self._send(topics.ANNOUNCED, announcement)
        now = self.simulator.at(t_ns)
        self._tell_state(now, t_ns)
        self.autopilot.armed = self.autopilot.armed or self.executor.flying
        frames = self.autopilot.frames(now, t_ns)
        if frames:
            self._send(topics.MAVLINK_UP, MavlinkFrames(frames=frames))

    def _tell_state(self, now: Kinematics, t_ns: int) -> None:
        """Every tick in flight, once a second on the ground."""
        if not self.executor.flying and t_ns - self._state_ns < IDLE_STATE_NS:
            return
        self._state_ns = t_ns
        mode = self.executor.mode
        if self.pilot.waiting or self.executor.idle or self.battery.swapping:
            mode = "wait" if self.pilot.waiting else "swap" if self.battery.swapping else "hold"
        self._send(topics.VEHICLE_STATE, VehicleState(
            vehicle_id=self.id, t_ns=t_ns, position_enu_m=vector(now.state.position),
            velocity_enu_m_s=vector(now.state.velocity), acceleration_enu_m_s2=vector(now.state.acceleration),
            yaw_enu_rad=now.yaw_enu_rad, gimbal_elevation_rad=now.gimbal_elevation_rad,
            battery_percent=self.battery.level_percent, flying=self.executor.flying, mode=mode))

    def _send(self, topic: Topic[Any], message: Message) -> None:
        self._out.append((topic, message, self.id))


def _item_groups(items: list[Item]) -> list[list[int]]:
    """For each waypoint of the route, the sequence numbers of the mission items that it is made of."""
    groups: list[list[int]] = []
    for seq, item in enumerate(items):
        if item.command == mav.MAV_CMD_NAV_WAYPOINT:
            groups.append([seq])
        elif groups and item.command != mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            groups[-1].append(seq)
    return groups


_HANDLERS: dict[type[Message], Callable[[Vehicle, Any], None]] = {
    MavlinkFrames: Vehicle._mavlink, PlanHash: Vehicle._plan_hash, MapSnapshot: Vehicle._map,
    RangeScan: Vehicle._scan, VehicleState: Vehicle._teammate, AnnouncedTrajectory: Vehicle._teammate,
    SensorPicture: Vehicle._picture, PictureAck: Vehicle._picture_ack, BatterySwap: Vehicle._battery_swap,
}
