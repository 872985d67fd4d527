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
from missions.clock import BRIDGE, GROUND
from missions.errors import ProtocolError
from missions.grid import VoxelGrid
from missions.messages import (
    AnnouncedTrajectory,
    BatterySwap,
    FenceOrder,
    LegReport,
    MapSnapshot,
    MavlinkFrames,
    Message,
    PictureAck,
    PlanHash,
    RangeHits,
    RangeScan,
    SensorPicture,
    SiteBrief,
    VehicleState,
    vector,
)
from missions.mission import Mission
from missions.pads import fence_limit, geofence, hover_points, takeoff_points
from missions.topics import Topic
from planning.trajectories import Limits
from planning.trajectories.energy import energy_of
from vehicle.aircraft_file import AircraftState
from vehicle.autopilot.faces import Faces
from vehicle.avoidance import Avoidance
from vehicle.battery import Battery
from vehicle.body import Body
from vehicle.camera import CameraPayload, intact
from vehicle.executor import Executor
from vehicle.failsafe import Failsafe
from vehicle.faults import SimulatedFaults
from vehicle.judge import Judge
from vehicle.lookout import Lookout
from vehicle.modes import STANDBY
from vehicle.pilot import Pilot
from vehicle.sensor_memory import SensorMemory
from vehicle.settings import Settings
from vehicle.simulator import NS, Kinematics, KinematicSimulator, resting
from vehicle.teammates import Teammates
from vehicle.told import Told

log = logging.getLogger(__name__)

Outgoing = tuple[Topic[Any], Message, int]
IDLE_STATE_NS = NS
FULL_PERCENT = 100.0
NOTHING = np.zeros((0, 3))


class Vehicle:
    """All that one vehicle does in a tick. Decisions depend on deliveries and simulated time alone."""

    def __init__(self, mission: Mission, site: SiteBrief, vehicle_id: int, storage: Path,
                 memory: SensorMemory | None = None, body: Body | None = None, battery: Battery | None = None) -> None:
        """storage: folder of the vehicle's own memory card. memory: what it knows of space; nothing when left out.
        body and battery: simulated when left out."""
        self.id, self.mission = vehicle_id, mission
        fleet, n = mission.fleet, vehicle_id - 1
        pad = np.array(takeoff_points(mission, site)[n])
        hover = np.array(hover_points(mission, site)[n])
        box, limit = geofence(mission, site), fence_limit(mission, site)
        self.site = mission.site.anchor
        self.battery = battery or Battery(mission.battery.start_of(vehicle_id), energy_of(mission))
        self.body: Body = body or KinematicSimulator(pad, math.pi / 2.0)
        self.memory = memory or SensorMemory.of(mission, site)
        self.teammates = Teammates(vehicle_id)
        self.avoidance = Avoidance(self.memory, self.teammates, fleet, limit)
        self.pilot = Pilot(vehicle_id, self.body, self.avoidance, Limits.of_fleet(fleet))
        self.camera = CameraPayload(vehicle_id, mission.camera, storage)
        self.executor = Executor(self.pilot, self.battery, mission.battery, self.camera, pad, hover,
                                 fleet.vehicles - 1)
        self.judge = Judge(mission, self.site, self.executor, box, limit)
        self.faces = Faces(mission, vehicle_id, self.executor, self.judge, self._apply)
        self.lookout = Lookout(self.executor, self.judge.fence, limit, mission)
        self.failsafe = Failsafe(Settings.of(mission))
        self.faults = SimulatedFaults(mission.faults, vehicle_id)
        self.wake_ns = 0
        self._out: list[Outgoing] = []
        self._ground_takes_part = True
        self._t_ns = 0
        self._told = Told()
        self._last_scan: RangeScan | None = None
        self._state_ns = -IDLE_STATE_NS

    @property
    def aircraft(self) -> AircraftState:
        """What of it outlives this process."""
        now, battery, executor = self.body.at(self._t_ns), self.battery, self.executor
        return AircraftState(self._t_ns, vector(now.state.position), now.yaw_enu_rad, now.gimbal_elevation_rad,
                             battery.level_percent, battery.full_at_ns, executor.mode, executor.paused_by,
                             executor.below_hover, [vector(p) for p in self.pilot.helm.trail.points])

    def find(self, aircraft: AircraftState, t_ns: int) -> None:
        """Before the first step: this process takes the place of one that has died; that is where the aircraft is."""
        flying, helm = aircraft.mode != STANDBY, self.pilot.helm
        idle_s = (t_ns - aircraft.t_ns) / NS if flying else 0.0
        self.battery.restore(aircraft.battery_percent - self.battery.energy.rest_percent(idle_s), aircraft.swapped_ns)
        place = np.array(aircraft.position_enu_m)
        helm.begin_anew(resting(place, aircraft.yaw_enu_rad, aircraft.gimbal_elevation_rad), t_ns)
        helm.trail.follow([np.array(p) for p in aircraft.trail_enu_m])
        for point in helm.trail.points:
            self.executor.way_home.note(point, self.avoidance.clear)
        self.executor.found(aircraft.mode, aircraft.paused_by, aircraft.below_hover)
        self.lookout.begin(t_ns)
        self._t_ns = t_ns
        self.faces.text("restarted in the air, holding" if flying else "restarted", mav.MAV_SEVERITY_WARNING)

    def step(self, t_ns: int, deliveries: list[Delivery], participants: frozenset[str]) -> list[Outgoing]:
        """One tick: take in, move, decide, tell. Returns (topic, message, id in the key)."""
        self.body.step(t_ns)
        if self.executor.flying:
            self.battery.spend(self.body.flight.curve, *map(self.body.elapsed_s, (self._t_ns, t_ns)))
        self.battery.step(t_ns)
        self._t_ns = t_ns
        self._simulate_faults(t_ns)
        was_away = not self._ground_takes_part
        self._ground_takes_part = GROUND in participants and not self.faults.on("ground_link_lost")
        if was_away and self._ground_takes_part:
            self._tell_again()
        if self.teammates.note_participants(participants):
            self.pilot.helm.news = True
        self.judge.at(t_ns)
        self.faces.step(self.body.measured(t_ns), self._last_scan, self._ground_takes_part, t_ns)
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
            if self.faults.on("ground_link_lost"):
                return
            self.lookout.hear_ground(self._t_ns)
        handler = _HANDLERS.get(type(delivery.message))
        try:
            if isinstance(delivery.message, MavlinkFrames):
                self.faces.receive(delivery.message.frames, delivery.sender, self._t_ns)
                self.follow_fence()
            elif handler is not None:
                handler(self, delivery.message)
        except ProtocolError as e:
            log.warning("uav%d: refused a message from %s: %s", self.id, delivery.sender, e)

    def _plan_hash(self, message: PlanHash) -> None:
        self.judge.announced = message

    def _map(self, message: MapSnapshot) -> None:
        self.memory.put_map(VoxelGrid.from_message(message))

    def _battery_swap(self, message: BatterySwap) -> None:
        if not self.executor.flying and not self.battery.swapping and self.battery.level_percent < FULL_PERCENT:
            self.battery.begin_swap(self._t_ns + round(self.mission.battery.swap_s * NS))

    def _fence_order(self, message: FenceOrder) -> None:
        self._send(topics.FENCE_VERDICT, self.judge.widen(message))
        self.follow_fence()

    def follow_fence(self) -> None:
        """What was uploaded counts as long as nobody has switched it off."""
        self.lookout.fence = self.judge.fence if self.faces.craft.fence_enabled else self.judge.box

    def _scan(self, message: RangeScan) -> None:
        if message.vehicle_id == self.id and not self.faults.on("range_blind") and self.lookout.take_scan(message):
            self._last_scan = message
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
        self.faces.captured()

    def _picture_ack(self, message: PictureAck) -> None:
        for chunk in self.camera.acknowledge(message, self._t_ns):
            self._send(topics.PICTURE_CHUNK, chunk)

    def _simulate_faults(self, t_ns: int) -> None:
        for text in self.faults.step(t_ns, self.battery):
            self.faces.text(text, mav.MAV_SEVERITY_WARNING)
            log.warning("uav%d: %s", self.id, text)

    def _guard(self, t_ns: int) -> None:
        if self.faces.leader_heard_ns is not None:
            self.lookout.hear_ground(self.faces.leader_heard_ns)
        health = self.faults.health(self.body.health)
        condition = self.lookout.look(t_ns, self.failsafe.settings, health, self._ground_takes_part)
        for text, severity in self.failsafe.step(condition, self.executor):
            self.faces.text(text, severity)
            log.info("uav%d: %s", self.id, text)
        self.faces.craft.amiss, self.faces.craft.action = self.failsafe.active, self.failsafe.decision.action

    def _tell_again(self) -> None:
        """Our ground station was away: it is told once more what belongs to the plan under way, and sent what it is
        owed."""
        self.camera.owe_at_once()
        for report in self._told.reports:
            self._send(topics.LEG_REPORT, report)
        self.faces.reached_for_ground(self._told.reached)

    def _tell(self, t_ns: int) -> None:
        outbox, now = self.executor.outbox, self.body.measured(t_ns)
        self._told.note(self.judge.accepted, outbox.reports, outbox.reached)
        for request in (*outbox.shutters, *self.faces.craft.photos.step(now, t_ns)):
            self._send(topics.SHUTTER, request)
        for report in outbox.reports:
            self._send(topics.LEG_REPORT, report)
        for text in outbox.texts:
            self.faces.text(text)
        self.faces.reached(outbox.reached)
        outbox.clear()
        self.camera.mind_the_card(t_ns)
        if self._ground_takes_part:
            for chunk in self.camera.send_again(t_ns):
                self._send(topics.PICTURE_CHUNK, chunk)
        for view_id in self.camera.lost(t_ns):
            log.warning("uav%d: no picture came for view %d", self.id, view_id)
            self.faces.lost(view_id, t_ns)
            report = LegReport(plan_id=self.judge.accepted.plan_id if self.judge.accepted is not None else 0,
                               view_id=view_id, outcome="unreachable", detail="the camera gave no picture")
            self._told.reports.append(report)
            self._send(topics.LEG_REPORT, report)
        hits = self.memory.take_untold() if self._ground_takes_part else NOTHING
        if len(hits):
            self._send(topics.RANGE_HITS, RangeHits(t_ns=t_ns, points_enu_m=[vector(p) for p in hits]))
        announcement = self.pilot.helm.announcement(t_ns)
        if announcement is not None:
            self._send(topics.ANNOUNCED, announcement)
        for verdict in self.judge.take_verdicts():
            self._send(topics.PLAN_VERDICT, verdict)
        self._tell_state(now, t_ns)
        for link, frames in self.faces.frames(now, t_ns).items():
            self._send(_UP[link], MavlinkFrames(frames=frames))

    def _apply(self, settings: Settings) -> None:
        self.executor.apply(settings)
        self.failsafe.settings = settings

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


_UP = {GROUND: topics.MAVLINK_UP, BRIDGE: topics.DOOR_UP}
_HANDLERS: dict[type[Message], Callable[[Vehicle, Any], None]] = {
    PlanHash: Vehicle._plan_hash, MapSnapshot: Vehicle._map,
    RangeScan: Vehicle._scan, VehicleState: Vehicle._teammate, AnnouncedTrajectory: Vehicle._teammate,
    SensorPicture: Vehicle._picture, PictureAck: Vehicle._picture_ack, BatterySwap: Vehicle._battery_swap,
    FenceOrder: Vehicle._fence_order,
}
