"""The mission as a small state machine: explore, survey, return, over. One step per turn of the clock."""

from __future__ import annotations

import logging
import time
from typing import Literal

from ground_station.control import Control
from ground_station.drone import Drone, Stage
from ground_station.explore_phase import ExplorePhase
from ground_station.survey import Survey
from ground_station.survey_phase import SurveyPhase
from ground_station.survey_views import known_space
from missions.clock import SECOND_NS
from missions.messages import Status, VehicleStatus

log = logging.getLogger(__name__)

Phase = Literal["explore", "survey", "return", "over"]


class Director:
    """Decides what happens next, from what the fleet knows; the fleet carries it out."""

    def __init__(self, control: Control) -> None:
        mission, recorder = control.mission, control.recorder
        self._control, self._fleet, self._recorder = control, control.fleet, recorder
        self._explore = ExplorePhase(control) if mission.explore.enabled else None
        self._survey: SurveyPhase | None = None
        self._pictures = 0
        self._wall = time.monotonic()
        self.phase: Phase = "explore" if mission.explore.enabled else "survey" if mission.survey.enabled else "return"
        recorder.begin(self.phase, 0)
        control.send_map(self._explore.explorer.grid if self._explore is not None else
                         known_space(mission, control.site, control.prior))

    def step(self) -> None:
        """One turn, after the fleet has received and before it sends."""
        self._pictures += len(self._fleet.new_pictures)
        if self._fleet.attendance.returned:
            self._control.send_map_again()
        if self.phase == "explore":
            self._step_explore()
        elif self.phase == "survey":
            self._step_survey()
        elif self.phase == "return":
            self._step_return()

    def abort(self) -> None:
        """An operator ends the mission; what is known is kept."""
        if self.phase in ("return", "over"):
            return
        if self.phase == "explore" and self._explore is not None:
            self._explore.conclude()
        self._enter("return")

    def regions_changed(self) -> None:
        """An operator has changed where may be flown or what counts."""
        if self._control.grid is not None:
            self._control.send_map(self._control.grid)
        if self.phase == "explore" and self._explore is not None:
            self._explore.think_again()
        elif self.phase == "survey" and self._survey is not None and self._control.grid is not None:
            self._survey.restrict(self._control.regions.applied(self._control.grid))

    def aim_for(self, coverage: float) -> str:
        """Explore until this share is seen; a sentence when it is too late for that."""
        if self.phase != "explore" or self._explore is None:
            return "the mission does not explore any more"
        self._explore.aim_for(coverage)
        return ""

    @property
    def goal_coverage(self) -> float | None:
        """An operator's."""
        return None if self._explore is None else self._explore.explorer.goal_coverage

    @property
    def survey(self) -> Survey | None:
        """The survey under way, or the last one."""
        return None if self._survey is None else self._survey.survey

    def status(self) -> Status:
        """What a person wants to know now."""
        coverage = self._recorder.predicted_coverage
        notes = self._recorder.notes
        return Status(phase=self.phase, t_ns=self._fleet.t_ns, coverage=coverage[-1] if coverage else 0.0,
                      pictures=self._pictures, seconds_left=self._seconds_left(),
                      vehicles=[self._vehicle_status(d) for d in self._fleet.drones.values()],
                      note=notes[-1] if notes else "")

    def _step_explore(self) -> None:
        assert self._explore is not None
        self._explore.step()
        if self._explore.over:
            self._explore.conclude()
            self._enter("survey" if self._control.mission.survey.enabled else "return")

    def _step_survey(self) -> None:
        if self._survey is None:
            self._survey = SurveyPhase(self._control, self._explore.explorer if self._explore is not None else None)
        self._survey.step()
        if self._survey.over:
            self._enter("return")

    def _step_return(self) -> None:
        for picture in self._fleet.new_pictures:
            self._recorder.picture(picture.meta, picture.meta.vehicle_id)
        for drone in self._fleet.free(Stage.READY):
            self._fleet.home(drone)
        if not self._fleet.in_stage(Stage.READY, Stage.FLYING, Stage.LAUNCHING, Stage.HOMING, Stage.MISSING):
            self._enter("over")

    def _enter(self, phase: Phase) -> None:
        self._recorder.end(self.phase, self._fleet.t_ns)
        self.phase = phase
        self._wall = time.monotonic()
        if phase != "over":
            self._recorder.begin(phase, self._fleet.t_ns)
        log.info("%.1f s: %s", self._fleet.t_ns / SECOND_NS, phase)

    def _seconds_left(self) -> float:
        """Of this phase, by the wall clock, from the share that is done; 0 when nothing can be said."""
        if self.phase == "explore" and self._explore is not None:
            done, whole = self._explore.progress
        elif self._survey is not None:
            done, whole = self._survey.progress
        else:
            return 0.0
        return (time.monotonic() - self._wall) * (whole - done) / done if done else 0.0

    def _vehicle_status(self, drone: Drone) -> VehicleStatus:
        left = self._survey.survey.left(drone.vehicle_id) if self._survey is not None else len(drone.awaited)
        return VehicleStatus(vehicle_id=drone.vehicle_id, mode=drone.stage.value, battery_percent=drone.battery_percent,
                             views_done=len(self._recorder.tracks[drone.vehicle_id].view_ids), views_left=left,
                             alive=not drone.gone)
