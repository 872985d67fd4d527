"""The world on the far side of the wires: each tick it takes pictures, scans ranges and watches the vehicles."""

from __future__ import annotations

import hashlib
import logging
import time
from collections import deque
from functools import partial

import msgspec

from missions import topics
from missions.bus import Bus
from missions.clock import GROUND, SECOND_NS, vehicle_name
from missions.messages import MavlinkFrames, PictureMeta, SensorPicture, ShutterRequest, VehicleState
from missions.mission import Mission
from sim_bridge.clock_server import ClockServer, Round
from sim_bridge.doors import Doors
from sim_bridge.pose_noise import measured
from sim_bridge.range_sensor import RangeSensor
from sim_bridge.referee import Referee
from sim_bridge.render.renderer import Renderer
from sim_bridge.render.sensor import encode_jpeg
from sim_bridge.truth import Truth
from sim_bridge.world_journal import Step, WorldJournal

log = logging.getLogger(__name__)

TAKEN_UP_S = 300.0
"""Vehicles that have landed wait so long for somebody to take up the mission of a ground station that has died."""


SHOWN_PER_TICK = 200
"""States that the referee is shown at most per tick: more than a fleet tells in one."""


class World:
    """Answers the vehicles and keeps the score. Subscribes the bus; the clock admits participants afterwards."""

    def __init__(self, bus: Bus, clock: ClockServer, mission: Mission, truth: Truth, renderer: Renderer,
                 doors: Doors | None = None, ground: bool = True) -> None:
        """doors: for ground stations that are not ours. ground: whether the mission is over when ours leaves."""
        self._bus, self._clock, self._mission = bus, clock, mission
        self._truth, self._renderer = truth, renderer
        self._doors, self._ground = doors, ground
        self._range_sensor = RangeSensor(truth, mission.fleet.range_sensor_m)
        self._newest: dict[int, VehicleState] = {}
        self.referee = Referee(truth, mission.fleet)
        self._unjudged: deque[VehicleState] = deque()
        """What the referee has not been shown yet: much, after an earlier bridge has died."""
        self.true_pictures: list[PictureMeta] = []
        """Every picture that was taken, with its true pose."""
        self._last: Step | None = None
        """The last that an earlier bridge has lived through."""
        self.ticks = 0
        self._attended_ns = 0
        """When the ground station was there, or a vehicle flew, for the last time."""
        self.render_s = 0.0
        bus.subscribe(topics.VEHICLE_STATE)
        bus.subscribe(topics.SHUTTER)
        if doors is not None:
            bus.subscribe(topics.DOOR_UP)

    def live_through(self, past: list[Step]) -> None:
        """Know what an earlier bridge knew as it sent its last tick; what it sent before that one is for `run` to send
        once more."""
        for step in past[1:-1]:
            round_ = step.round()
            self.ticks += 1
            for state in self._watch(round_):
                self._range_sensor.due(state)
            for shutter in _shutters(round_):
                self._remember(shutter, self._meta(shutter, b""))
        self._last = past[-1]

    def run(self, journal: WorldJournal) -> None:
        """Serve the mission until the ground station leaves, nobody is left, time is over or somebody interrupts."""
        before = self._take_up() if self._last is not None else None
        over = before is not None and self._over(before)
        while not over:
            self._clock.pace(self._doors.wait if self._doors is not None else None, self._unattended)
            self._let_in()
            before = self._clock.run_tick(record=partial(journal.write, before))
            self._serve(before)
            self._clock.include_own()
            self._show_referee(SHOWN_PER_TICK)
            over = self._over(before)
        self._watch(self._clock.run_tick(stop=True))
        self._show_referee(len(self._unjudged))
        self.referee.finish()

    def _take_up(self) -> Round | None:
        """The last round that an earlier bridge heard, and what it sent upon it, with the same numbers."""
        assert self._last is not None, "only what was begun is taken up"
        step, self._last = self._last, None
        if step.clock.tick == 0:
            return None
        round_ = step.round()
        self._serve(round_)
        for vehicle_id in range(1, self._mission.fleet.vehicles + 1):  # door frames are not kept, but were numbered
            key = topics.DOOR_DOWN.key(self._bus.fleet, vehicle_id)
            while self._bus.published.get(key, 0) < step.clock.changed.get(self._bus.name, {}).get(key, 0):
                self._bus.publish(topics.DOOR_DOWN, MavlinkFrames(frames=[]), vehicle_id)
        self._clock.include_own()
        return round_

    def _over(self, round_: Round) -> bool:
        left = GROUND not in round_.participants if self._ground else not round_.participants
        if self._clock.interrupted or (left and not self._waits(round_)):
            return True
        late = round_.t_ns >= self._mission.clock.max_s * SECOND_NS
        if late:
            log.error("clock.max_s = %g is over and the mission is not; stopping it", self._mission.clock.max_s)
        return late

    @property
    def _unattended(self) -> bool:
        """Whether the ground station has died; another may take its place."""
        return self._ground and GROUND in self._clock.lost

    def _waits(self, round_: Round) -> bool:
        """Whether somebody may still take the mission up again: vehicles fly on meanwhile, and come home."""
        return (self._unattended and len(round_.participants) > 0
                and round_.t_ns - self._attended_ns < TAKEN_UP_S * SECOND_NS)

    def _serve(self, round_: Round) -> None:
        self.ticks += 1
        for state in self._watch(round_):
            scan = self._range_sensor.scan(state)
            if scan is not None:
                self._bus.publish(topics.RANGE_SCAN, scan, state.vehicle_id)
        for shutter in _shutters(round_):
            self._expose(shutter)
        if self._doors is not None:
            for delivery in round_.deliveries:
                if delivery.topic is topics.DOOR_UP:
                    self._doors.send(int(delivery.who), delivery.message.frames, round_.t_ns)

    def _let_in(self) -> None:
        """What came through the doors goes to the vehicles with the next tick."""
        if self._doors is None:
            return
        for vehicle_id, frames in self._doors.receive(self._clock.t_ns):
            self._bus.publish(topics.DOOR_DOWN, MavlinkFrames(frames=frames), vehicle_id)
        self._clock.include_own()

    def _watch(self, round_: Round) -> list[VehicleState]:
        """Note all states of a round for the referee, also of aircraft whose computer has died: they stay where they
        told last that they were. Returns the states that were told."""
        states = [d.message for d in round_.deliveries if isinstance(d.message, VehicleState)]
        if not self._unattended or any(s.flying for s in states):
            self._attended_ns = round_.t_ns
        self._newest |= {state.vehicle_id: state for state in states}
        absent = [resting(state, round_.t_ns) for k, state in self._newest.items()
                  if vehicle_name(k) not in round_.participants]
        self._unjudged.extend((*states, *absent))
        return states

    def _show_referee(self, at_most: int) -> None:
        """So many of the states that it has not seen; nobody's clock waits until it has judged a whole past."""
        for _ in range(min(at_most, len(self._unjudged))):
            self.referee.see(self._unjudged.popleft())

    def _expose(self, shutter: ShutterRequest) -> None:
        begin = time.perf_counter()
        boxes = [(o.center_enu_m, o.size_m) for o in self._truth.obstacles_at(shutter.t_capture_ns)]
        noise_key = shutter.t_capture_ns * 64 + shutter.vehicle_id
        rgb = self._renderer.render(shutter.camera, shutter.pose, boxes, noise_key)
        jpeg = encode_jpeg(rgb, self._mission.camera.jpeg_quality)
        self.render_s += time.perf_counter() - begin
        meta = self._meta(shutter, jpeg)
        self._bus.publish(topics.SENSOR_PICTURE, SensorPicture(meta=meta, jpeg=jpeg), shutter.vehicle_id)
        self._remember(shutter, meta)

    def _meta(self, shutter: ShutterRequest, jpeg: bytes) -> PictureMeta:
        spec = self._mission.camera
        return PictureMeta(vehicle_id=shutter.vehicle_id, view_id=shutter.view_id, phase=shutter.phase,
                           t_capture_ns=shutter.t_capture_ns, pose=measured(shutter, spec, self._mission.seed),
                           position_sigma_m=spec.position_sigma_m, speed_m_s=shutter.speed_m_s, camera=shutter.camera,
                           sha256=hashlib.sha256(jpeg).hexdigest(), size_bytes=len(jpeg))

    def _remember(self, shutter: ShutterRequest, meta: PictureMeta) -> None:
        self.true_pictures.append(msgspec.structs.replace(meta, pose=shutter.pose))


def resting(state: VehicleState, t_ns: int) -> VehicleState:
    """Still there at a later time."""
    still = (0.0, 0.0, 0.0)
    return msgspec.structs.replace(state, t_ns=t_ns, velocity_enu_m_s=still, acceleration_enu_m_s2=still)


def _shutters(round_: Round) -> list[ShutterRequest]:
    return [d.message for d in round_.deliveries if isinstance(d.message, ShutterRequest)]
