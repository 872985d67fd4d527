"""The mission as a small state machine: explore, survey, return, over. One step per turn of the clock."""

from __future__ import annotations

import logging
import time
from typing import Literal

import numpy as np

from ground_station.airspace import Airspace
from ground_station.explore import Asking, Busy, Explorer, Leg
from ground_station.fleet import Drone, Fleet, Stage
from ground_station.ledger import ENERGY
from ground_station.recorder import Recorder
from ground_station.survey import Flyer, Survey
from ground_station.survey_views import known_outside, survey_views
from missions import topics
from missions.bus import Bus
from missions.clock import SECOND_NS
from missions.grid import VoxelGrid
from missions.messages import SiteBrief, Status, VehicleStatus
from missions.mission import Mission
from planning.allocate.battery import range_m

log = logging.getLogger(__name__)

EXPLORE_ENERGY_SHARE = 0.5
"""Share of the usable battery that exploration may take when a survey follows."""

MAX_TROUBLE = 8
"""Refused or blocked legs in a row after which a vehicle stops exploring."""

AWAY_M = 5.0
MAX_RESCUES = 2
"""Times that a vehicle around which the map has closed is called home, on the way that it remembers, to start anew."""

Phase = Literal["explore", "survey", "return", "over"]


class Director:
    """Decides what happens next, from what the fleet knows; the fleet carries it out."""

    def __init__(self, mission: Mission, site: SiteBrief, fleet: Fleet, bus: Bus, recorder: Recorder) -> None:
        self._mission, self._site, self._fleet, self._bus, self._recorder = mission, site, fleet, bus, recorder
        self._explorer = Explorer(mission, site)
        self._survey: Survey | None = None
        self._airspace: Airspace | None = None
        self._legs: dict[int, Leg] = {}
        self._column_flown: set[int] = set()
        self._done_exploring: set[int] = set()
        self._asked: set[int] = set()
        self._trouble: dict[int, int] = {}
        self._rescues: dict[int, int] = {}
        self._decisions = 0
        self._pictures = 0
        self._handed_over: set[int] = set()
        self._sent_grid: VoxelGrid | None = None
        self._wall = time.monotonic()
        self.phase: Phase = "explore" if mission.explore.enabled else "survey" if mission.survey.enabled else "return"
        recorder.begin(self.phase, 0)
        self._send_map(self._explorer.grid if mission.explore.enabled else known_outside(mission, site))

    def step(self) -> None:
        """One turn, after the fleet has received and before it sends."""
        self._pictures += len(self._fleet.new_pictures)
        if self.phase == "explore":
            self._step_explore()
        elif self.phase == "survey":
            self._step_survey()
        elif self.phase == "return":
            self._step_return()

    def status(self) -> Status:
        """What a person wants to know now."""
        coverage = self._recorder.predicted_coverage
        notes = self._recorder.notes
        return Status(phase=self.phase, t_ns=self._fleet.t_ns, coverage=coverage[-1] if coverage else 0.0,
                      pictures=self._pictures, seconds_left=self._seconds_left(),
                      vehicles=[self._vehicle_status(d) for d in self._fleet.drones.values()],
                      note=notes[-1] if notes else "")

    # --- explore ---

    def _step_explore(self) -> None:
        for picture in self._fleet.new_pictures:
            self._explorer.add(picture)
            self._recorder.picture(picture.meta, picture.meta.vehicle_id)
            if picture.meta.view_id in self._explorer.key_views:
                self._asked.clear()
                self._trouble.pop(picture.meta.vehicle_id, None)
        for drone in self._fleet.drones.values():
            self._settle_leg(drone)
        for drone in self._fleet.in_stage(Stage.PARKED):
            if drone.available and drone.vehicle_id not in self._done_exploring:
                self._fleet.launch(drone)
        self._give_views()
        if self._exploration_over():
            self._enter("survey" if self._mission.survey.enabled else "return")

    def _settle_leg(self, drone: Drone) -> None:
        """What was refused or reported blocked is not tried again; a vehicle that only ever meets trouble is done."""
        k, leg = drone.vehicle_id, self._legs.get(drone.vehicle_id)
        if leg is not None and (drone.refused or drone.reports):
            self._explorer.forbid(leg.goal)
            self._trouble[k] = self._trouble.get(k, 0) + 1
            if self._trouble[k] >= MAX_TROUBLE:
                self._done_exploring.add(k)
                self._recorder.note(self._fleet.t_ns, f"vehicle {k} stops exploring after {MAX_TROUBLE} legs in a row "
                                                      "that were refused or blocked")
        drone.reports.clear()
        drone.refused = ""

    def _give_views(self) -> None:
        ready = [d for d in self._fleet.in_stage(Stage.READY)
                 if d.vehicle_id not in self._done_exploring and d.standing]
        for drone in ready:
            if drone.vehicle_id not in self._column_flown:
                self._column_flown.add(drone.vehicle_id)
                self._fly_leg(drone, self._explorer.column(drone.vehicle_id))
            elif self._decisions >= self._mission.explore.max_views or self._range_m(drone) <= 0.0:
                self._done_exploring.add(drone.vehicle_id)
        asking = [d for d in ready if d.stage is Stage.READY and d.vehicle_id not in self._done_exploring]
        if any(d.vehicle_id not in self._asked for d in asking):
            self._decide(asking)
        if not self._fleet.in_stage(Stage.FLYING, Stage.LAUNCHING):
            self._done_exploring.update(d.vehicle_id for d in asking)

    def _decide(self, asking: list[Drone]) -> None:
        explorer = self._explorer
        explorer.refresh()
        self._asked.update(d.vehicle_id for d in asking)
        self._send_map(explorer.grid)
        self._recorder.predicted_coverage.append(round(explorer.coverage, 4))
        others = [d for d in self._fleet.drones.values() if d.airborne and d not in asking]
        budget = self._mission.explore.max_views - self._decisions
        found = explorer.decide([self._asking(d) for d in asking[:budget]], [self._busy(d) for d in others])
        for leg in found.legs:
            self._decisions += 1
            self._fly_leg(self._fleet.drones[leg.vehicle_id], leg)
        for drone in asking:
            if drone.stage is Stage.READY:
                self._without_view(drone, drone.vehicle_id in found.stuck)

    def _without_view(self, drone: Drone, stuck: bool) -> None:
        """Nothing for this vehicle now: wait for what the others find, or, when it is shut in, look around, and when
        that has not helped start anew from the pad."""
        if not stuck:
            return
        leg = self._explorer.look_around(self._asking(drone))
        if leg is not None:
            self._recorder.note(self._fleet.t_ns, f"vehicle {drone.vehicle_id} reaches no candidate and looks around")
            self._fly_leg(drone, leg)
        elif self._may_rescue(drone):
            self._rescue(drone)
            self._explorer.look_again(drone.vehicle_id)
            self._asked.discard(drone.vehicle_id)

    def _may_rescue(self, drone: Drone) -> bool:
        away = float(np.linalg.norm(drone.position_enu_m - drone.hover_enu_m))
        return away > AWAY_M and self._rescues.get(drone.vehicle_id, 0) < MAX_RESCUES

    def _rescue(self, drone: Drone) -> None:
        self._rescues[drone.vehicle_id] = self._rescues.get(drone.vehicle_id, 0) + 1
        self._recorder.note(self._fleet.t_ns, f"vehicle {drone.vehicle_id} is shut in by the map and is called home")
        self._fleet.home(drone)

    def _fly_leg(self, drone: Drone, leg: Leg) -> None:
        self._legs[drone.vehicle_id] = leg
        self._asked.discard(drone.vehicle_id)
        self._fleet.fly(drone, "explore", leg.waypoints)

    def _exploration_over(self) -> bool:
        if self._fleet.in_stage(Stage.FLYING, Stage.LAUNCHING):
            return False
        return all(not d.available or d.vehicle_id in self._done_exploring for d in self._fleet.drones.values())

    def _asking(self, drone: Drone) -> Asking:
        state = drone.state
        assert state is not None
        return Asking(drone.vehicle_id, drone.position_enu_m, state.yaw_enu_rad, state.gimbal_elevation_rad,
                      self._range_m(drone))

    def _busy(self, drone: Drone) -> Busy:
        leg = self._legs.get(drone.vehicle_id)
        flying = drone.stage is Stage.FLYING and leg is not None
        return Busy(drone.vehicle_id, drone.position_enu_m, leg.goal if leg is not None and flying else None)

    # --- survey ---

    def _begin_survey(self) -> None:
        flyers = [self._flyer(d) for d in self._fleet.drones.values() if d.available]
        explored = self._mission.explore.enabled
        if explored:
            self._explorer.refresh()
        grid = self._explorer.grid if explored else known_outside(self._mission, self._site)
        self._send_map(grid)
        if explored:
            self._recorder.write_map(grid, self._explorer.map.surface())
        views = survey_views(self._mission, self._site, grid, self._explorer.key_views,
                             [f.position_enu_m for f in flyers])
        self._airspace = Airspace.of(grid, self._mission, self._site)
        self._survey = Survey(views, self._mission.survey)
        self._survey.allocate(flyers, self._fleet.t_ns / SECOND_NS)
        log.info("survey: %d views for %d vehicles", len(views), len(flyers))

    def _step_survey(self) -> None:
        if self._survey is None:
            self._begin_survey()
        survey, t_s = self._survey, self._fleet.t_ns / SECOND_NS
        assert survey is not None
        for picture in self._fleet.new_pictures:
            meta = picture.meta
            survey.flown(meta.view_id, meta.vehicle_id)
            origin = survey.ledger.origin(meta.view_id) if meta.view_id in survey.ledger else None
            self._recorder.picture(meta, meta.vehicle_id if origin is None else origin)
        for drone in self._fleet.drones.values():
            self._survey_events(drone, survey)
        if survey.ledger.homeless():
            able = [d for d in self._fleet.drones.values() if d.available and self._range_m(d) > 0.0]
            survey.redistribute([self._flyer(d) for d in able], t_s)
        for drone in self._fleet.drones.values():
            self._survey_orders(drone, survey)
        self._recorder.outcomes, self._recorder.reassignments = survey.ledger.outcomes(), survey.ledger.reassignments
        if survey.over:
            self._enter("return")

    def _survey_events(self, drone: Drone, survey: Survey) -> None:
        k = drone.vehicle_id
        for report in drone.reports:
            survey.not_flown(report.view_id, k, report.outcome)
        drone.reports.clear()
        if drone.refused:
            survey.plan_refused(k)
            drone.refused = ""
        elif drone.stage is Stage.READY:
            survey.plan_over(k)
        if not drone.available and k not in self._handed_over:
            self._handed_over.add(k)
            survey.gone(k, "lost" if drone.stage is Stage.LOST else ENERGY)

    def _survey_orders(self, drone: Drone, survey: Survey) -> None:
        if drone.stage is Stage.PARKED and drone.available and survey.waiting(drone.vehicle_id):
            self._fleet.launch(drone)
        elif drone.stage is Stage.READY and survey.waiting(drone.vehicle_id) and drone.standing:
            assert self._airspace is not None
            hovering = [d.position_enu_m for d in self._fleet.in_stage(Stage.READY) if d is not drone]
            if self._may_rescue(drone) and survey.shut_in(self._flyer(drone), self._airspace, hovering):
                self._rescue(drone)
                return
            waypoints = survey.next_waypoints(self._flyer(drone), self._airspace, hovering)
            if waypoints:
                self._fleet.fly(drone, "survey", waypoints)
        elif drone.stage is Stage.READY and not survey.waiting(drone.vehicle_id):
            self._fleet.home(drone)

    def _flyer(self, drone: Drone) -> Flyer:
        return Flyer(drone.vehicle_id, drone.position_enu_m, drone.hover_enu_m,
                     range_m(drone.battery_percent, self._mission.battery.percent_per_m,
                             self._mission.battery.threshold_percent))

    # --- return ---

    def _step_return(self) -> None:
        for picture in self._fleet.new_pictures:
            self._recorder.picture(picture.meta, picture.meta.vehicle_id)
        for drone in self._fleet.in_stage(Stage.READY):
            self._fleet.home(drone)
        if not self._fleet.in_stage(Stage.READY, Stage.FLYING, Stage.LAUNCHING, Stage.HOMING):
            self._enter("over")

    # --- all phases ---

    def _enter(self, phase: Phase) -> None:
        self._recorder.end(self.phase, self._fleet.t_ns)
        self.phase = phase
        self._wall = time.monotonic()
        if phase != "over":
            self._recorder.begin(phase, self._fleet.t_ns)
        log.info("%.1f s: %s", self._fleet.t_ns / SECOND_NS, phase)

    def _send_map(self, grid: VoxelGrid) -> None:
        """The map that is planned on, to the vehicles, when it has changed."""
        if self._sent_grid is None or not np.array_equal(self._sent_grid.state, grid.state):
            self._bus.publish(topics.MAP_SNAPSHOT, grid.to_message(self._fleet.t_ns))
            self._sent_grid = grid

    def _range_m(self, drone: Drone) -> float:
        """What a vehicle may still fly in this phase, the way home included."""
        battery = self._mission.battery
        reserve = battery.threshold_percent
        if self.phase == "explore" and self._mission.survey.enabled:
            reserve += (1.0 - EXPLORE_ENERGY_SHARE) * max(0.0, battery.start_of(drone.vehicle_id) - reserve)
        return range_m(drone.battery_percent, battery.percent_per_m, reserve)

    def _seconds_left(self) -> float:
        """Of this phase, by the wall clock, from the share that is done; 0 when nothing can be said."""
        if self.phase == "explore":
            done, whole = self._decisions, self._mission.explore.max_views
        elif self._survey is not None:
            outcomes = self._survey.ledger.outcomes()
            done, whole = len(outcomes) - self._survey.ledger.open_count, len(outcomes)
        else:
            return 0.0
        return (time.monotonic() - self._wall) * (whole - done) / done if done else 0.0

    def _vehicle_status(self, drone: Drone) -> VehicleStatus:
        left = self._survey.left(drone.vehicle_id) if self._survey is not None else len(drone.awaited)
        return VehicleStatus(vehicle_id=drone.vehicle_id, mode=drone.stage.value, battery_percent=drone.battery_percent,
                             views_done=len(self._recorder.tracks[drone.vehicle_id].view_ids), views_left=left,
                             alive=drone.stage is not Stage.LOST)
