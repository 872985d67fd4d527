"""The world on the far side of the wires: each tick it takes pictures, scans ranges and watches the vehicles."""

from __future__ import annotations

import hashlib
import logging
import time

import msgspec

from missions import topics
from missions.bus import Bus
from missions.clock import GROUND, SECOND_NS, vehicle_name
from missions.messages import PictureMeta, SensorPicture, ShutterRequest, VehicleState
from missions.mission import Mission
from sim_bridge.clock_server import ClockServer, Round
from sim_bridge.coverage import Coverage
from sim_bridge.pose_noise import measured
from sim_bridge.range_sensor import RangeSensor
from sim_bridge.referee import Referee
from sim_bridge.render.renderer import Renderer
from sim_bridge.render.sensor import encode_jpeg
from sim_bridge.truth import Truth

log = logging.getLogger(__name__)

EXPLORE = "explore"


class World:
    """Answers the vehicles and keeps the score. Subscribes the bus; the clock admits participants afterwards."""

    def __init__(self, bus: Bus, clock: ClockServer, mission: Mission, truth: Truth, renderer: Renderer,
                 coverage: Coverage) -> None:
        self._bus, self._clock, self._mission = bus, clock, mission
        self._truth, self._renderer, self._coverage = truth, renderer, coverage
        self._range_sensor = RangeSensor(truth, mission.fleet.range_sensor_m)
        self._flying = {vehicle_name(k): k for k in range(1, mission.fleet.vehicles + 1)}
        self.referee = Referee(truth, mission.fleet)
        self.true_pictures: list[PictureMeta] = []
        """Every picture that was taken, with its true pose."""
        self.ticks = 0
        self.render_s = 0.0
        bus.subscribe(topics.VEHICLE_STATE)
        bus.subscribe(topics.SHUTTER)

    def run(self) -> None:
        """Serve the mission until the ground station leaves, nobody is left, time is over or somebody interrupts."""
        over = False
        while not over:
            round_ = self._clock.run_tick()
            self._serve(round_)
            self._clock.include_own()
            over = self._over(round_)
        self._watch(self._clock.run_tick(stop=True))
        self.referee.finish()

    def _over(self, round_: Round) -> bool:
        if GROUND not in round_.participants or self._clock.interrupted:
            return True
        late = round_.t_ns >= self._mission.clock.max_s * SECOND_NS
        if late:
            log.error("clock.max_s = %g is over and the mission is not; stopping it", self._mission.clock.max_s)
        return late

    def _serve(self, round_: Round) -> None:
        self.ticks += 1
        for state in self._watch(round_):
            scan = self._range_sensor.scan(state)
            if scan is not None:
                self._bus.publish(topics.RANGE_SCAN, scan, state.vehicle_id)
        for delivery in round_.deliveries:
            if isinstance(delivery.message, ShutterRequest):
                self._expose(delivery.message)

    def _watch(self, round_: Round) -> list[VehicleState]:
        """Show the referee all states of a round, forget vehicles that have left, return the states."""
        states = [d.message for d in round_.deliveries if isinstance(d.message, VehicleState)]
        for state in states:
            self.referee.see(state)
        for name in [n for n in self._flying if n not in round_.participants]:
            self.referee.drop(self._flying.pop(name))
        return states

    def _expose(self, shutter: ShutterRequest) -> None:
        begin = time.perf_counter()
        boxes = [(o.center_enu_m, o.size_m) for o in self._truth.obstacles_at(shutter.t_capture_ns)]
        noise_key = shutter.t_capture_ns * 64 + shutter.vehicle_id
        rgb = self._renderer.render(shutter.camera, shutter.pose, boxes, noise_key)
        jpeg = encode_jpeg(rgb, self._mission.camera.jpeg_quality)
        self.render_s += time.perf_counter() - begin
        spec = self._mission.camera
        meta = PictureMeta(vehicle_id=shutter.vehicle_id, view_id=shutter.view_id, phase=shutter.phase,
                           t_capture_ns=shutter.t_capture_ns, pose=measured(shutter, spec, self._mission.seed),
                           position_sigma_m=spec.position_sigma_m, speed_m_s=shutter.speed_m_s, camera=shutter.camera,
                           sha256=hashlib.sha256(jpeg).hexdigest(), size_bytes=len(jpeg))
        self._bus.publish(topics.SENSOR_PICTURE, SensorPicture(meta=meta, jpeg=jpeg), shutter.vehicle_id)
        self.true_pictures.append(msgspec.structs.replace(meta, pose=shutter.pose))
        if shutter.phase == EXPLORE:
            self._coverage.add(shutter)
