"""The vehicles as the mission sees them: stages of each, its plan, its pictures still to come."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from ground_station.energy import EnergyBudget
from ground_station.fleet_link import VehicleLink, arm, return_to_launch, takeoff
from ground_station.ingest import Ingest, Picture
from ground_station.obstacles import SeenObstacles
from ground_station.recorder import Recorder
from missions import topics
from missions.bus import Bus, Delivery
from missions.clock import SECOND_NS, Turn, vehicle_name
from missions.frames import Array
from missions.mavlink import Route, Waypoint
from missions.messages import BatterySwap, LegReport, MavlinkFrames, SiteBrief, VehicleState
from missions.mission import Mission
from missions.pads import hover_points
from planning.trajectories import Clear

log = logging.getLogger(__name__)

LATE_PICTURE_S = 5.0
"""A plan is over this long after its last item even if a picture of it has not come."""
TAKEOFF_TRIES = 3
FULL_PERCENT = 100.0
AT_HOVER_M, STANDING_M_S = 0.5, 0.05


class Stage(Enum):
    """Where a vehicle is in its own little life."""

    PARKED = "parked"
    LAUNCHING = "launching"
    READY = "ready"
    FLYING = "flying"
    HOMING = "homing"
    SWAPPING = "swapping"
    LOST = "lost"


@dataclass
class Drone:
    """One vehicle. `awaited` holds the views of its plan whose pictures have neither come nor been given up."""

    vehicle_id: int
    link: VehicleLink
    hover_enu_m: Array
    stage: Stage = Stage.PARKED
    awaited: list[int] = field(default_factory=list)
    goal: Waypoint | None = None
    reports: list[LegReport] = field(default_factory=list)
    refused: str = ""
    spent: bool = False
    """It came home by itself for lack of energy, or cannot take off: it flies no more with this battery."""
    swaps_left: int = 0
    launches_failed: int = 0
    idle_since_ns: int = -1

    @property
    def state(self) -> VehicleState | None:
        """The newest state."""
        return self.link.telemetry.state

    @property
    def position_enu_m(self) -> Array:
        """(3,) the newest position; the hover point before anything is known."""
        return self.hover_enu_m if self.state is None else np.array(self.state.position_enu_m)

    @property
    def battery_percent(self) -> float:
        """The newest battery level; that of the new battery while it is put in."""
        if self.stage is Stage.SWAPPING:
            return FULL_PERCENT
        return self.link.telemetry.battery_percent if self.state is None else self.state.battery_percent

    @property
    def standing(self) -> bool:
        """Whether it does not move."""
        return self.state is not None and float(np.linalg.norm(self.state.velocity_enu_m_s)) < STANDING_M_S

    @property
    def available(self) -> bool:
        """Whether it can be given anything to fly, now or after a launch."""
        return not self.spent and self.stage is not Stage.LOST

    @property
    def airborne(self) -> bool:
        """Whether it is in the air as far as is known."""
        return self.stage is not Stage.LOST and self.state is not None and self.state.flying


class Fleet:
    """All vehicles, their links and pictures, in lock-step."""

    def __init__(self, mission: Mission, site: SiteBrief, bus: Bus, ingest: Ingest, recorder: Recorder) -> None:
        self._mission, self._bus, self._ingest, self._recorder = mission, bus, ingest, recorder
        self._latency_ns = round(mission.clock.link_latency_s * SECOND_NS)
        anchor = mission.site.anchor
        self._origin_alt_m = mission.site.origin_alt_m
        hovers = hover_points(mission, site)
        self.drones = {k: Drone(k, VehicleLink(k, anchor), np.array(hovers[k - 1]), swaps_left=mission.battery.swaps)
                       for k in range(1, mission.fleet.vehicles + 1)}
        self.t_ns = 0
        self.new_pictures: list[Picture] = []
        self.obstacles = SeenObstacles()
        self._energy = EnergyBudget(mission, site)
        self._plan_id = 0

    def receive(self, turn: Turn) -> None:
        """Take in everything that was delivered, and move the vehicles' stages on."""
        self.t_ns = turn.t_ns
        self.new_pictures = []
        for delivery in turn.deliveries:
            drone = self.drones.get(int(delivery.who)) if delivery.who.isdigit() else None
            if drone is not None and delivery.sender == vehicle_name(drone.vehicle_id):
                self._take(drone, delivery)
        for vehicle_id, request in self._ingest.overdue(turn.t_ns):
            self._bus.publish(topics.PICTURE_ACK, request, vehicle_id)
        for drone in self.drones.values():
            self._advance(drone, vehicle_name(drone.vehicle_id) in turn.participants)

    def send(self) -> int:
        """Publish what the links have to say; the time at which the next tick is wanted."""
        early = False
        for drone in self.drones.values():
            if drone.stage is Stage.LOST:
                continue
            out = drone.link.poll(self.t_ns)
            if out.plan_hash is not None:
                self._bus.publish(topics.PLAN_HASH, out.plan_hash, drone.vehicle_id)
            if out.frames:
                self._bus.publish(topics.MAVLINK_DOWN, MavlinkFrames(frames=out.frames), drone.vehicle_id)
            early = early or drone.link.busy
        step = self._latency_ns if early else round(self._mission.clock.tick_s * SECOND_NS)
        return self.t_ns + step

    def launch(self, drone: Drone) -> None:
        """Arm and take off to the hover point over the pad."""
        drone.stage = Stage.LAUNCHING
        drone.link.command(arm(), takeoff(float(self._origin_alt_m + drone.hover_enu_m[2])))

    def fly(self, drone: Drone, phase: str, waypoints: list[Waypoint], clear: Clear | None = None) -> None:
        """Send a hovering vehicle over these waypoints, between which it will blend corners where that is `clear`."""
        self._plan_id += 1
        drone.stage, drone.goal, drone.refused, drone.idle_since_ns = Stage.FLYING, waypoints[-1], "", -1
        drone.awaited = [w.view_id for w in waypoints if w.view_id is not None]
        self._recorder.plan_begins(drone.vehicle_id, phase, len(drone.awaited), self.t_ns,
                                   self._predicted_percent(drone, waypoints, clear))
        drone.link.fly(Route(plan_id=self._plan_id, phase=phase, waypoints=waypoints))

    def home(self, drone: Drone) -> None:
        """Send a vehicle home to land."""
        self._leave_plan(drone, Stage.HOMING)
        drone.link.cancel()
        drone.link.command(return_to_launch())

    def swap(self, drone: Drone) -> None:
        """Have the battery of a parked vehicle changed; what it can fly is reckoned with the new one from now on."""
        drone.stage, drone.swaps_left, drone.spent = Stage.SWAPPING, drone.swaps_left - 1, False
        self._bus.publish(topics.BATTERY_SWAP, BatterySwap(vehicle_id=drone.vehicle_id), drone.vehicle_id)
        self._recorder.note(self.t_ns, f"vehicle {drone.vehicle_id} gets a fresh battery")

    def in_stage(self, *stages: Stage) -> list[Drone]:
        """Vehicles in any of these stages, by id."""
        return [d for d in self.drones.values() if d.stage in stages]

    def _take(self, drone: Drone, delivery: Delivery) -> None:
        message = delivery.message
        if delivery.topic is topics.MAVLINK_UP:
            drone.link.on_frames(message.frames)
        elif delivery.topic is topics.VEHICLE_STATE and message.vehicle_id == drone.vehicle_id:
            drone.link.on_state(message)
            self._recorder.tracks[drone.vehicle_id].add(message)
        elif delivery.topic is topics.PLAN_VERDICT:
            drone.link.on_verdict(message)
        elif delivery.topic is topics.LEG_REPORT:
            self._on_report(drone, message)
        elif delivery.topic is topics.RANGE_HITS:
            self.obstacles.hear(message)
        elif delivery.topic is topics.PICTURE_CHUNK:
            ack, picture = self._ingest.receive(drone.vehicle_id, message, self.t_ns)
            if ack is not None:
                self._bus.publish(topics.PICTURE_ACK, ack, drone.vehicle_id)
            if picture is not None:
                self.new_pictures.append(picture)
                _discard(drone.awaited, picture.meta.view_id)

    def _on_report(self, drone: Drone, report: LegReport) -> None:
        drone.reports.append(report)
        _discard(drone.awaited, report.view_id)
        self._recorder.note(self.t_ns, f"vehicle {drone.vehicle_id} did not fly view {report.view_id}: "
                                       f"{report.outcome}{' (' + report.detail + ')' if report.detail else ''}")

    def _advance(self, drone: Drone, present: bool) -> None:
        """One step of a vehicle's stage."""
        if drone.stage is Stage.LOST:
            return
        if not present:
            self._lose(drone)
            return
        failure = drone.link.take_failure()
        if failure:
            self._on_failure(drone, failure)
        state = drone.state
        if state is None:
            return
        if drone.stage is Stage.LAUNCHING and not drone.link.busy and self._hovers(drone):
            drone.stage = Stage.READY
        elif drone.stage is Stage.FLYING and self._plan_over(drone):
            self._leave_plan(drone, Stage.READY, flown=True)
        elif self._ready_on_the_pad(drone, state):
            drone.stage = Stage.PARKED
        if drone.stage in (Stage.READY, Stage.FLYING, Stage.LAUNCHING) and drone.link.returning:
            self._leave_plan(drone, Stage.HOMING)
            drone.spent = True
            drone.link.cancel()
            self._recorder.note(self.t_ns, f"vehicle {drone.vehicle_id} returns by itself at "
                                           f"{drone.battery_percent:.1f} %")

    def _predicted_percent(self, drone: Drone, waypoints: list[Waypoint], clear: Clear | None) -> float | None:
        return None if drone.state is None else self._energy.route_percent(drone.state, waypoints, clear)

    def _leave_plan(self, drone: Drone, stage: Stage, flown: bool = False) -> None:
        drone.stage, drone.goal = stage, None
        self._recorder.plan_ends(drone.vehicle_id, self.t_ns, flown)

    def _ready_on_the_pad(self, drone: Drone, state: VehicleState) -> bool:
        if drone.stage is Stage.SWAPPING:
            return state.mode == "standby" and state.battery_percent == FULL_PERCENT
        return drone.stage is Stage.HOMING and not drone.link.busy and not state.flying

    def _hovers(self, drone: Drone) -> bool:
        return (drone.airborne and drone.standing
                and float(np.linalg.norm(drone.position_enu_m - drone.hover_enu_m)) < AT_HOVER_M)

    def _plan_over(self, drone: Drone) -> bool:
        """Every view of the plan is here or was reported (the last waypoint is one), or the plan was flown to its end
        and its pictures have had time enough to come."""
        if drone.link.busy or not drone.standing:
            return False
        if not drone.awaited:
            return True
        if not drone.link.plan_finished:
            return False
        if drone.idle_since_ns < 0:
            drone.idle_since_ns = self.t_ns
        return self.t_ns - drone.idle_since_ns >= round(LATE_PICTURE_S * SECOND_NS)

    def _on_failure(self, drone: Drone, reason: str) -> None:
        self._recorder.note(self.t_ns, f"vehicle {drone.vehicle_id}: {reason}")
        log.warning("vehicle %d: %s", drone.vehicle_id, reason)
        if drone.stage is Stage.FLYING:
            self._leave_plan(drone, Stage.READY)
            drone.refused = reason
            drone.awaited.clear()
        elif drone.stage is Stage.LAUNCHING:
            drone.launches_failed += 1
            drone.stage = Stage.PARKED
            if drone.launches_failed >= TAKEOFF_TRIES:
                drone.spent, drone.swaps_left = True, 0
        elif drone.stage is Stage.HOMING:
            drone.link.command(return_to_launch())

    def _lose(self, drone: Drone) -> None:
        self._leave_plan(drone, Stage.LOST)
        drone.awaited.clear()
        drone.link.cancel()
        self._ingest.forget(drone.vehicle_id)
        self._recorder.note(self.t_ns, f"vehicle {drone.vehicle_id} is lost")
        log.warning("vehicle %d is lost", drone.vehicle_id)


def places(drones: Iterable[Drone]) -> list[Array]:
    """Positions of vehicles."""
    return [d.position_enu_m for d in drones]


def _discard(values: list[int], value: int) -> None:
    if value in values:
        values.remove(value)
