"""The survey as the fleet flies it: views planned on the map, tours given out in chunks, events told to the survey."""

from __future__ import annotations

import logging

from ground_station.airspace import Airspace
from ground_station.control import Control
from ground_station.explore import Explorer
from ground_station.fleet import Drone, Stage
from ground_station.ledger import ENERGY
from ground_station.survey import Flyer, Survey
from ground_station.survey_views import known_space, survey_views
from missions.clock import SECOND_NS

log = logging.getLogger(__name__)


class SurveyPhase:
    """Who surveys what next."""

    def __init__(self, control: Control, explorer: Explorer | None) -> None:
        """explorer: what exploration knows; None when there was none."""
        self._control, self._fleet, self._recorder = control, control.fleet, control.recorder
        self._handed_over: set[int] = set()
        flyers = [self._flyer(d) for d in self._fleet.drones.values() if d.available]
        if explorer is not None:
            explorer.refresh()
        prior = control.prior
        grid = explorer.grid if explorer is not None else known_space(control.mission, control.site, prior)
        control.send_map(grid)
        if explorer is not None:
            self._recorder.write_map(grid, explorer.map.surface())
        explored = [] if explorer is None else explorer.poses(every_picture=control.mission.survey.views == "frames")
        views = survey_views(control.mission, control.site, grid, explored, [f.position_enu_m for f in flyers], prior)
        self._airspace = Airspace.of(grid, control.mission, control.site, prior)
        self.survey = Survey(views, control.mission.survey)
        self.survey.allocate(flyers, self._fleet.t_ns / SECOND_NS)
        log.info("survey: %d views for %d vehicles", len(views), len(flyers))

    def step(self) -> None:
        """One turn."""
        survey, t_s = self.survey, self._fleet.t_ns / SECOND_NS
        for picture in self._fleet.new_pictures:
            meta = picture.meta
            survey.flown(meta.view_id, meta.vehicle_id)
            origin = survey.ledger.origin(meta.view_id) if meta.view_id in survey.ledger else None
            self._recorder.picture(meta, meta.vehicle_id if origin is None else origin)
        for drone in self._fleet.drones.values():
            self._events(drone, survey)
        if survey.ledger.homeless():
            flyers = [self._flyer(d) for d in self._fleet.drones.values() if d.available]
            survey.redistribute([f for f in flyers if f.range_m > 0.0], t_s)
        for drone in self._fleet.drones.values():
            self._orders(drone, survey)
        self._recorder.outcomes, self._recorder.reassignments = survey.ledger.outcomes(), survey.ledger.reassignments

    def _events(self, drone: Drone, survey: Survey) -> None:
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

    def _orders(self, drone: Drone, survey: Survey) -> None:
        if drone.stage is Stage.PARKED and drone.available and survey.waiting(drone.vehicle_id):
            self._fleet.launch(drone)
        elif drone.stage is Stage.READY and survey.waiting(drone.vehicle_id) and drone.standing:
            hovering = [d.position_enu_m for d in self._fleet.in_stage(Stage.READY) if d is not drone]
            if self._control.may_rescue(drone) and survey.shut_in(self._flyer(drone), self._airspace, hovering):
                self._control.rescue(drone)
                return
            waypoints = survey.next_waypoints(self._flyer(drone), self._airspace, hovering)
            if waypoints:
                self._fleet.fly(drone, "survey", waypoints)
        elif drone.stage is Stage.READY and not survey.waiting(drone.vehicle_id):
            self._fleet.home(drone)

    def _flyer(self, drone: Drone) -> Flyer:
        return Flyer(drone.vehicle_id, drone.position_enu_m, drone.hover_enu_m,
                     self._control.range_m(drone, exploring=False))
