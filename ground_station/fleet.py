"""The vehicles as the mission sees them: stages of each, its plan, its pictures still to come."""

from __future__ import annotations

import logging
from collections.abc import Iterable

import numpy as np

from ground_station.attendance import Attendance
from ground_station.drone import FULL_PERCENT, Drone, FenceAsked, Stage
from ground_station.energy import EnergyBudget
from ground_station.fleet_link import Command, VehicleLink, arm, go_on, land, pause, return_to_launch, takeoff
from ground_station.ingest import Ingest, Picture
from ground_station.obstacles import SeenObstacles
from ground_station.recorder import Recorder
from ground_station.storage_hold import StorageHold
from ground_station.voice import Voice
from missions import topics
from missions.bus import Delivery
from missions.clock import SECOND_NS, Turn, vehicle_name
from missions.frames import Array
from missions.mavlink import Route, Waypoint
from missions.messages import (
    BatterySwap,
    FenceOrder,
    LegReport,
    MavlinkFrames,
    SiteBrief,
    Vector,
    VehicleState,
)
from missions.mission import Mission
from missions.pads import hover_points
from planning.trajectories import Clear

log = logging.getLogger(__name__)

LATE_PICTURE_S = 5.0
"""A plan is over this long after its last item even if a picture of it has not come."""
TAKEOFF_TRIES = 3
AT_HOVER_M = 0.5


class Fleet:
    """All vehicles, their links and pictures, in lock-step."""

    def __init__(self, mission: Mission, site: SiteBrief, voice: Voice, ingest: Ingest, recorder: Recorder) -> None:
        self._mission, self._voice, self._ingest, self._recorder = mission, voice, ingest, recorder
        self._latency_ns = round(mission.clock.link_latency_s * SECOND_NS)
        anchor = mission.site.anchor
        self._origin_alt_m = mission.site.origin_alt_m
        hovers = hover_points(mission, site)
        taking_part = mission.fleet.vehicles - mission.fleet.reserve
        self.drones = {k: Drone(k, VehicleLink(k, anchor), np.array(hovers[k - 1]), swaps_left=mission.battery.swaps,
                                dropped=k > taking_part, reserve=k > taking_part)
                       for k in range(1, mission.fleet.vehicles + 1)}
        self.t_ns = 0
        self.new_pictures: list[Picture] = []
        self.storage = StorageHold()
        self.attendance = Attendance(mission.fleet.lost_after_s, ingest, recorder)
        self.obstacles = SeenObstacles()
        self._energy = EnergyBudget(mission, site)
        self._plan_id = 0
        self._away_until_ns = 0

    def receive(self, turn: Turn) -> None:
        """Take in everything that was delivered, and move the vehicles' stages on."""
        self.t_ns = turn.t_ns
        self.new_pictures = []
        self.attendance.returned.clear()
        for delivery in turn.deliveries:
            drone = self.drones.get(int(delivery.who)) if delivery.who.isdigit() else None
            if drone is not None and delivery.sender == vehicle_name(drone.vehicle_id):
                self._take(drone, delivery)
        for vehicle_id, request in self._ingest.overdue(turn.t_ns):
            self._voice.publish(topics.PICTURE_ACK, request, vehicle_id)
        for drone in self.drones.values():
            self._advance(drone, vehicle_name(drone.vehicle_id) in turn.participants)
        news = self.storage.step(self, self._ingest.trouble)
        if news:
            self._recorder.note(self.t_ns, news)
            log.warning(news)

    def send(self) -> int:
        """Publish what the links have to say; the time at which the next tick is wanted."""
        early = False
        for drone in self.drones.values():
            if drone.gone:
                continue
            out = drone.link.poll(self.t_ns)
            if out.plan_hash is not None:
                self._voice.publish(topics.PLAN_HASH, out.plan_hash, drone.vehicle_id)
            if out.frames:
                self._voice.publish(topics.MAVLINK_DOWN, MavlinkFrames(frames=out.frames), drone.vehicle_id)
                self._recorder.mavlink.write(out.frames, self.t_ns)
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

    def pause(self, drone: Drone) -> Command | None:
        """An operator has a vehicle hold where it is; one on its pad stays there, and nothing is sent."""
        drone.link.held = True
        return None if drone.on_pad else drone.link.order(pause())

    def resume(self, drone: Drone) -> Command | None:
        """It goes on with what it did; one that was on its way home comes home first. None on the pad."""
        drone.link.held = False
        if drone.on_pad:
            return None
        return drone.link.order(return_to_launch() if drone.stage is Stage.HOMING else go_on())

    def recall(self, drone: Drone) -> Command | None:
        """An operator calls a vehicle home, at once, to wait there; None when it is on its pad already."""
        drone.link.held = True
        return self._break_off(drone, return_to_launch())

    def drop(self, drone: Drone) -> Command | None:
        """An operator takes a vehicle out of the mission; it comes home."""
        drone.dropped = True
        return self.abandon(drone)

    def add(self, drone: Drone) -> None:
        """An operator has a vehicle that was dropped, or is in reserve, take part."""
        drone.dropped = drone.reserve = drone.link.held = False

    def abandon(self, drone: Drone) -> Command | None:
        """Call a vehicle home at once, not to wait for anybody; None when it is on its pad."""
        drone.link.held = False
        return self._break_off(drone, return_to_launch())

    def land(self, drone: Drone) -> Command | None:
        """An operator has a vehicle land where it is; it flies no more. None, and nothing, when it is on its pad."""
        if drone.on_pad:
            return None
        drone.spent, drone.swaps_left = True, 0
        return self._break_off(drone, land())

    def widen_fence(self, drone: Drone, lower_enu_m: Vector, upper_enu_m: Vector) -> FenceAsked:
        """An operator moves the fence out: the vehicle is to take the wider one on board."""
        number = 1 if drone.fence_asked is None else drone.fence_asked.order.order_id + 1
        order = FenceOrder(order_id=number, lower_enu_m=lower_enu_m, upper_enu_m=upper_enu_m)
        self._voice.publish(topics.FENCE_ORDER, order, drone.vehicle_id)
        drone.fence_asked = FenceAsked(order)
        return drone.fence_asked

    def _break_off(self, drone: Drone, command: Command) -> Command | None:
        drone.link.cancel()
        if drone.on_pad:
            return None
        self._leave_plan(drone, Stage.HOMING)
        return drone.link.order(command)

    def swap(self, drone: Drone) -> None:
        """Have the battery of a parked vehicle changed; what it can fly is reckoned with the new one from now on."""
        drone.stage, drone.swaps_left, drone.spent = Stage.SWAPPING, drone.swaps_left - 1, False
        self._voice.publish(topics.BATTERY_SWAP, BatterySwap(vehicle_id=drone.vehicle_id), drone.vehicle_id)
        self._recorder.note(self.t_ns, f"vehicle {drone.vehicle_id} gets a fresh battery")

    def meet_again(self, t_ns: int) -> None:
        """This ground station was away: nothing is asked of a vehicle before it has been heard."""
        self._away_until_ns = t_ns
        self._recorder.note(t_ns, "the ground station was away and takes the mission up again")
        for drone in self.drones.values():
            drone.link.away, drone.idle_since_ns = drone.stage is not Stage.LOST, -1

    def in_stage(self, *stages: Stage) -> list[Drone]:
        """Vehicles in any of these stages, by id."""
        return [d for d in self.drones.values() if d.stage in stages]

    def free(self, *stages: Stage) -> list[Drone]:
        """Of these, the vehicles that no operator holds."""
        return [d for d in self.in_stage(*stages) if not d.held]

    def _take(self, drone: Drone, delivery: Delivery) -> None:
        message = delivery.message
        if delivery.topic is topics.MAVLINK_UP:
            drone.link.on_frames(message.frames)
            self._recorder.mavlink.write(message.frames, self.t_ns)
        elif delivery.topic is topics.VEHICLE_STATE and message.vehicle_id == drone.vehicle_id:
            drone.link.on_state(message)
            self._recorder.tracks[drone.vehicle_id].add(message)
        elif delivery.topic is topics.PLAN_VERDICT:
            drone.link.on_verdict(message)
        elif delivery.topic is topics.FENCE_VERDICT:
            asked = drone.fence_asked
            if asked is not None and asked.order.order_id == message.order_id:
                asked.verdict = message
        elif delivery.topic is topics.LEG_REPORT:
            self._on_report(drone, message)
        elif delivery.topic is topics.RANGE_HITS:
            self.obstacles.hear(message)
        elif delivery.topic is topics.PICTURE_CHUNK:
            ack, picture = self._ingest.receive(drone.vehicle_id, message, self.t_ns)
            if ack is not None:
                self._voice.publish(topics.PICTURE_ACK, ack, drone.vehicle_id)
            if picture is not None:
                self.new_pictures.append(picture)
                _discard(drone.awaited, picture.meta.view_id)

    def _on_report(self, drone: Drone, report: LegReport) -> None:
        if (report.plan_id, report.view_id) in drone.reported:
            return
        drone.reported.add((report.plan_id, report.view_id))
        if not drone.recalled:
            drone.reports.append(report)
        _discard(drone.awaited, report.view_id)
        self._recorder.note(self.t_ns, f"vehicle {drone.vehicle_id} did not fly view {report.view_id}: "
                                       f"{report.outcome}{' (' + report.detail + ')' if report.detail else ''}")

    def _advance(self, drone: Drone, present: bool) -> None:
        """One step of a vehicle's stage."""
        if not present:
            self.attendance.miss(drone, self.t_ns)
            return
        if drone.gone:
            self.attendance.find(drone, self.t_ns)
            return
        failure = drone.link.take_failure()
        if failure:
            self._on_failure(drone, failure)
        state = drone.state
        if state is None or (drone.link.away and not self._met(drone, state)):
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

    def _met(self, drone: Drone, state: VehicleState) -> bool:
        """Whether a vehicle has been heard again; what it did by itself meanwhile is made its stage."""
        if state.t_ns < self._away_until_ns:
            return False
        drone.link.take_up_again()
        if drone.fence_asked is not None and drone.fence_asked.verdict is None:
            self._voice.publish(topics.FENCE_ORDER, drone.fence_asked.order, drone.vehicle_id)
        came_home = not state.flying and drone.stage in (Stage.READY, Stage.FLYING, Stage.LAUNCHING)
        if came_home or (drone.link.returning and drone.stage in (Stage.READY, Stage.FLYING)):
            where = "on its pad" if came_home else "on its way home"
            self._recorder.note(self.t_ns, f"vehicle {drone.vehicle_id} is found {where}")
            if drone.stage is Stage.FLYING and drone.link.uploading:
                drone.refused = "the ground station was away"
                drone.awaited.clear()
            self._leave_plan(drone, Stage.PARKED if came_home else Stage.HOMING)
            drone.link.cancel()
            drone.spent = state.battery_percent <= self._mission.battery.threshold_percent
        elif drone.stage is Stage.SWAPPING:
            self._voice.publish(topics.BATTERY_SWAP, BatterySwap(vehicle_id=drone.vehicle_id), drone.vehicle_id)
        return True

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
        if drone.link.busy or not drone.standing or drone.vehicle_id in self.storage.held:
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


def places(drones: Iterable[Drone]) -> list[Array]:
    """Positions of vehicles."""
    return [d.position_enu_m for d in drones]


def _discard(values: list[int], value: int) -> None:
    if value in values:
        values.remove(value)
