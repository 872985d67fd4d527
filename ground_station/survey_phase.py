"""The survey as the fleet flies it: views planned on the map, tours given out in chunks, events told to the survey."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable
from dataclasses import replace

from ground_station.airspace import Airspace
from ground_station.control import Control
from ground_station.drone import Drone, Stage
from ground_station.explore import Explorer
from ground_station.ledger import ENERGY, LOST, OPERATOR, ViewLedger
from ground_station.survey import Survey
from ground_station.survey_map import CompletedMap, completed_map
from ground_station.survey_method import means_of
from ground_station.survey_views import FIRST_VIEW_ID, known_space, refining_views, survey_views
from ground_station.tours import Flyer
from ground_station.traffic import Traffic, holding
from missions.camera import View
from missions.clock import SECOND_NS
from missions.errors import UserError
from missions.frames import Array
from missions.grid import VoxelGrid
from missions.mavlink import Waypoint

log = logging.getLogger(__name__)

PARTS = (1.0, 0.5, 0.25)
"""Shares of a chunk that are tried when waiting does not keep it clear of the others."""


class SurveyPhase:
    """Who surveys what next."""

    def __init__(self, control: Control, explorer: Explorer | None) -> None:
        """explorer: what exploration knows; None when there was none."""
        self._control, self._fleet, self._recorder = control, control.fleet, control.recorder
        self._handed_over: set[int] = set()
        self._sent: dict[int, list[Waypoint]] = {}
        self._traffic = Traffic(control.mission)
        self._ledgers: list[ViewLedger] = []
        self._landing = False
        """Whether all come home before the second flight is planned."""
        mission = control.mission
        if explorer is not None:
            explorer.refresh()
        grid = explorer.grid if explorer is not None else known_space(mission, control.site, control.prior)
        explored = [] if explorer is None else explorer.poses(every_picture=mission.survey.views == "frames")
        self._map = None if explorer is None or not mission.survey.refine else completed_map(explorer, mission,
                                                                                             control.recorder.run)
        self._begin("start", grid, lambda flyable, starts, hits: survey_views(
            mission, control.site, flyable, explored, starts, control.prior, hits, control.regions.interest))

    def _begin(self, why: str, grid: VoxelGrid, plan: Callable[[VoxelGrid, list[Array], Array], list[View]]) -> None:
        """A flight over the views that are planned from where the vehicles are, keeping clear of what they have hit."""
        control, flyers = self._control, self._flyers()
        control.send_map(grid)
        starts, hits = [f.position_enu_m for f in flyers], control.unmapped_hits(grid)
        flyable = control.regions.applied(grid)
        views = plan(flyable, starts, hits)
        means = means_of(control.mission, control.site, views, flyable, control.prior, starts, hits)
        self._airspace, self.survey = means.airspace, Survey(views, means.method, means.shooting)
        self._ledgers.append(self.survey.ledger)
        self._allocate(why, lambda: self.survey.begin(flyers, self._t_s))
        log.info("survey: %d views for %d vehicles", len(views), len(flyers))

    @property
    def over(self) -> bool:
        """Whether every view has its outcome, and no other flight is to come."""
        return self.survey.over and self._map is None

    @property
    def progress(self) -> tuple[int, int]:
        """(views with an outcome, all views) of all flights so far."""
        whole = sum(len(ledger.outcomes()) for ledger in self._ledgers)
        return whole - sum(ledger.open_count for ledger in self._ledgers), whole

    def _may_refine(self, completed: CompletedMap) -> bool:
        """Whether it is time for the second flight; where planning it takes long, whoever flies lands before."""
        if not completed.needs_time:
            return True
        if not self._landing:
            self._landing = True
            self._control.note("all pictures are taken; they are aligned when all have landed, before a second flight")
        return not self._fleet.free(Stage.LAUNCHING, Stage.READY, Stage.FLYING, Stage.HOMING)

    def _refine(self, completed: CompletedMap) -> None:
        """A second flight, to what the first one's pictures show too rarely."""
        self._map = None
        if not self._flyers():
            self._control.note("no vehicle has energy for a second flight")
            return
        control, taken = self._control, self.survey.ledger.flown_poses()
        try:
            grid = completed.grid()
        except UserError as e:
            control.note(f"no second flight: {e}")
            return
        first_view_id = FIRST_VIEW_ID + self.survey.progress[1]
        self._begin("refine", grid, lambda flyable, starts, hits: refining_views(
            control.mission, control.site, flyable, taken, first_view_id, starts, control.prior, hits,
            control.regions.interest))
        control.note(f"{self.survey.progress[1]} more views for what fewer than "
                     f"{control.mission.survey.pictures_per_patch} pictures show")

    def restrict(self, grid: VoxelGrid) -> None:
        """An operator has changed where may be flown: this map shows where."""
        control = self._control
        now = Airspace.of(grid, control.mission, control.site, control.prior, control.unmapped_hits(grid))
        self._airspace = replace(self._airspace, field=now.field)

    def step(self) -> None:
        """One turn."""
        survey = self.survey
        for picture in self._fleet.new_pictures:
            if self._map is not None:
                self._map.add(picture)
            meta = picture.meta
            survey.flown(meta.view_id, meta.vehicle_id)
            origin = survey.ledger.origin(meta.view_id) if meta.view_id in survey.ledger else None
            self._recorder.picture(meta, meta.vehicle_id if origin is None else origin)
        for drone in self._fleet.drones.values():
            self._events(drone, survey)
        flyers = self._flyers()
        news = survey.news([f.vehicle_id for f in flyers])
        if news:
            self._allocate(news, lambda: survey.redistribute(flyers, self._t_s))
        if survey.over and self._map is not None and self._may_refine(self._map):
            self._refine(self._map)
        for drone in self._fleet.drones.values():
            self._orders(drone, self.survey)
        self._record()

    def _record(self) -> None:
        recorder = self._recorder
        recorder.outcomes = {k: v for ledger in self._ledgers for k, v in ledger.outcomes().items()}
        recorder.outcome_details = {k: v for ledger in self._ledgers for k, v in ledger.details().items()}
        recorder.reassignments = [r for ledger in self._ledgers for r in ledger.reassignments]

    @property
    def _t_s(self) -> float:
        return self._fleet.t_ns / SECOND_NS

    def _allocate(self, why: str, act: Callable[[], None]) -> None:
        """Do it, and record how long it took."""
        began = time.perf_counter()
        act()
        self._recorder.allocations.append({"t_s": self._t_s, "why": why, "open_views": self.survey.ledger.open_count,
                                           "wall_s": round(time.perf_counter() - began, 3)})

    def _events(self, drone: Drone, survey: Survey) -> None:
        k = drone.vehicle_id
        for report in drone.reports:
            survey.not_flown(report.view_id, k, report.outcome, report.detail)
        drone.reports.clear()
        if drone.refused:
            survey.plan_refused(k, drone.refused, refused_view(drone.refused, self._sent.get(k, [])))
            drone.refused = ""
        elif drone.recalled or drone.stage is Stage.MISSING:
            survey.take_back(k)
        elif drone.stage is Stage.READY:
            survey.plan_over(k)
        if drone.available:
            self._handed_over.discard(k)
        elif k not in self._handed_over:
            self._handed_over.add(k)
            survey.gone(k, _why_gone(drone))

    def _orders(self, drone: Drone, survey: Survey) -> None:
        k = drone.vehicle_id
        if drone.held:
            return
        if drone.stage is Stage.PARKED and drone.swaps_left and survey.wants_swap(k):
            self._fleet.swap(drone)
            survey.swapped(k)
        elif drone.stage is Stage.PARKED and drone.available and survey.waiting(k):
            self._fleet.launch(drone)
        elif drone.stage is Stage.READY and survey.waiting(k) and drone.standing:
            self._fly_on(drone, survey)
        elif drone.stage is Stage.READY and not survey.waiting(k):
            self._go_home(drone)

    def _fly_on(self, drone: Drone, survey: Survey) -> None:
        """The next chunk, or home when the map has closed around the vehicle."""
        hovering = [d.position_enu_m for d in self._fleet.in_stage(Stage.READY) if d is not drone]
        flyer = self._flyer(drone)
        if self._control.may_rescue(drone) and survey.shut_in(flyer, self._airspace, hovering):
            self._control.rescue(drone)
            return
        waypoints = self._kept_apart(drone, flyer, hovering)
        if waypoints:
            self._fleet.fly(drone, "survey", waypoints, self._airspace.outline_clear)

    def _kept_apart(self, drone: Drone, flyer: Flyer, hovering: list[Array]) -> list[Waypoint]:
        """The vehicle's next chunk, or the part of it that needs no more than waiting to keep clear of the others."""
        state, k = drone.state, drone.vehicle_id
        assert state is not None
        moving = [d.vehicle_id for d in self._fleet.in_stage(Stage.FLYING, Stage.HOMING)]
        resting, lost = ([d.position_enu_m for d in self._fleet.in_stage(*stages)
                          if d is not drone and d.state is not None and d.state.flying]
                         for stages in ((Stage.READY, Stage.LAUNCHING), (Stage.MISSING, Stage.LOST)))
        for share in PARTS:
            waypoints = self.survey.next_waypoints(flyer, self._airspace, hovering, share)
            if not waypoints:
                return []
            hold_s = self._traffic.hold_s(state, waypoints, self._t_s, moving, resting, lost)
            if hold_s is not None:
                break
            if share > PARTS[-1]:
                self.survey.take_back(k)
        else:
            self._control.note(f"vehicle {k} cannot keep clear of the others by waiting, and yields in flight")
        if hold_s:
            self._control.note(f"vehicle {k} waits {hold_s:.1f} s before its next views")
            waypoints = [holding(state, hold_s), *waypoints]
        self._traffic.flies(state, waypoints, self._t_s)
        self._sent[k] = waypoints
        return waypoints

    def _go_home(self, drone: Drone) -> None:
        assert drone.state is not None
        x, y, z = (float(c) for c in drone.hover_enu_m)
        self._traffic.flies(drone.state, [Waypoint(position_enu_m=(x, y, z), yaw_enu_rad=drone.state.yaw_enu_rad)],
                            self._t_s)
        self._fleet.home(drone)

    def _flyers(self) -> list[Flyer]:
        """Who can take views, with what is in the battery or with the next one."""
        flyers = [self._flyer(d) for d in self._fleet.drones.values() if d.stage is not Stage.LOST]
        return [f for f in flyers if f.usable_percent > 0.0 or f.swaps]

    def _flyer(self, drone: Drone) -> Flyer:
        place = drone.position_enu_m if drone.airborne else drone.hover_enu_m
        usable = self._control.usable_percent(drone, exploring=False) if drone.available else 0.0
        k, energy = drone.vehicle_id, self._control.energy
        take_off = energy.take_off_percent(k)
        return Flyer(k, place, drone.hover_enu_m, usable if drone.airborne else max(0.0, usable - take_off),
                     0 if drone.dropped else drone.swaps_left, energy.at_home_percent(k), take_off)


def _why_gone(drone: Drone) -> str:
    if drone.stage is Stage.LOST:
        return LOST
    return OPERATOR if drone.dropped else ENERGY


def refused_view(reason: str, waypoints: list[Waypoint]) -> int | None:
    """The view at the waypoint that a vehicle's refusal names; None when it names none, or one without a view."""
    found = re.search(r"waypoint (\d+)", reason)
    n = int(found[1]) if found else len(waypoints)
    return waypoints[n].view_id if n < len(waypoints) else None
