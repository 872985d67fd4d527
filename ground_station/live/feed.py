"""What the ground station tells those who watch: one `LiveUpdate` after the other, each with what is new."""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ground_station.control import Control
from ground_station.director import Director
from ground_station.drone import Drone, Stage
from ground_station.ingest import Picture
from ground_station.live.alarms import Alarms
from ground_station.operator import Operator
from ground_station.voice import Voice
from missions import live, topics
from missions.bus import Delivery
from missions.clock import SECOND_NS
from missions.grid import OCCUPIED
from missions.live import (
    LiveHello,
    LiveMap,
    LivePicture,
    LivePlan,
    LiveSite,
    LiveState,
    LiveUpdate,
    LiveVehicle,
)
from missions.messages import PictureMeta, Vector, vector
from missions.pads import fence_limit, geofence, takeoff_points
from missions.run_folder import RunFolder
from planning.nbv.survey import SurveyViewSpec

LEASE_S = 15.0
"""Watchers that have said nothing for so long, by the wall clock, are gone."""
TRAIL_STEP_M = 0.4


class LiveFeed:
    """Keeps what watchers were told. Costs nothing but a list of pictures while nobody watches."""

    def __init__(self, control: Control, director: Director, operator: Operator, run: RunFolder, voice: Voice) -> None:
        self._control, self._director, self._operator = control, director, operator
        self._fleet, self._recorder, self._run, self._voice = control.fleet, control.recorder, run, voice
        self._alarms = Alarms(control.fleet, control.mission.battery)
        self._site = _site(control)
        self._wall_start, self._heard = time.monotonic(), -np.inf
        self._metas: list[PictureMeta] = []
        self._curve: list[tuple[float, float, float]] = []
        self._whole, self._seq = True, 0
        self.playing: live.LivePlaying | None = None
        """What a recording says of itself."""
        self._told_pictures = self._told_curve = 0
        self._forget()

    def hear(self, beside: Iterable[Delivery]) -> None:
        """Notice who watches."""
        for delivery in beside:
            if isinstance(delivery.message, LiveHello):
                self._heard = time.monotonic()
                self._whole = self._whole or delivery.message.whole

    def see(self, pictures: Iterable[Picture]) -> None:
        """These have arrived."""
        self._metas += [p.meta for p in pictures]

    def tell(self) -> None:
        """Publish what is new, where somebody watches."""
        self._extend_curve()
        if time.monotonic() - self._heard < LEASE_S:
            self._voice.publish(topics.LIVE_UPDATE, self.update())

    def update(self) -> LiveUpdate:
        """What is new since the last one."""
        whole, self._whole = self._whole, False
        if whole:
            self._forget()
        self._seq += 1
        pictures, self._told_pictures = self._metas[self._told_pictures:], len(self._metas)
        curve, self._told_curve = self._curve[self._told_curve:], len(self._curve)
        return LiveUpdate(seq=self._seq, whole=whole, site=self._site, state=self._state(), plans=self._new_plans(),
                          pictures=[self._picture(m) for m in pictures], map=self._new_voxels(), curve=curve)

    def _forget(self) -> None:
        self._told_pictures = self._told_curve = 0
        self._told_plans: dict[int, LivePlan] = {}
        self._told_trail: dict[int, int] = {}
        self._told_solid: NDArray[np.bool_] | None = None
        self._told_grid: object = None

    def _extend_curve(self) -> None:
        status, survey = self._director.status(), self._director.survey
        done, total = (0, 0) if survey is None else survey.progress
        point = round(status.coverage, 4), round(done / total, 4) if total else 0.0
        if not self._curve or self._curve[-1][1:] != point:
            self._curve.append((self._fleet.t_ns / SECOND_NS, *point))

    def _state(self) -> LiveState:
        status, survey, regions = self._director.status(), self._director.survey, self._control.regions
        drones = self._fleet.drones.values()
        home = {d.vehicle_id: self._control.energy.home_percent(d.vehicle_id, d.position_enu_m) if d.airborne else 0.0
                for d in drones}
        views = {v.vehicle_id: (v.views_done, v.views_left) for v in status.vehicles}
        done, total = (0, 0) if survey is None else survey.progress
        lower, upper = regions.fence_enu_m
        return LiveState(
            phase=status.phase, started=self._operator.started, t_s=self._fleet.t_ns / SECOND_NS,
            wall_s=round(time.monotonic() - self._wall_start, 2), coverage=status.coverage,
            goal_coverage=self._director.goal_coverage, views_done=done, views_total=total, pictures=status.pictures,
            seconds_left=round(status.seconds_left, 1), fence_lower_enu_m=vector(lower, 3),
            fence_upper_enu_m=vector(upper, 3), regions=list(regions.marked),
            vehicles=[self._vehicle(d, home[d.vehicle_id], *views[d.vehicle_id]) for d in drones],
            alarms=self._alarms.now(home, self._operator.started), note=status.note,
            playing=self.playing)

    def _vehicle(self, drone: Drone, home_percent: float, views_done: int, views_left: int) -> LiveVehicle:
        state = drone.state
        return LiveVehicle(
            vehicle_id=drone.vehicle_id, stage=drone.stage.value, mode="" if state is None else state.mode,
            position_enu_m=vector(drone.position_enu_m if state is not None else
                                  self._site.pads_enu_m[drone.vehicle_id - 1], 3),
            yaw_enu_rad=0.0 if state is None else state.yaw_enu_rad,
            gimbal_elevation_rad=0.0 if state is None else state.gimbal_elevation_rad,
            speed_m_s=0.0 if state is None else round(float(np.linalg.norm(state.velocity_enu_m_s)), 2),
            battery_percent=round(drone.battery_percent, 2), home_percent=round(home_percent, 2),
            views_done=views_done, views_left=views_left, next_waypoint=drone.link.next_waypoint,
            flying=drone.airborne, held=drone.held, dropped=drone.dropped,
            reserve=drone.reserve, swaps_left=drone.swaps_left, trail_enu_m=self._new_trail(drone))

    def _new_trail(self, drone: Drone) -> list[Vector]:
        """Positions since the last update, some way apart."""
        track = self._recorder.tracks[drone.vehicle_id].position
        trail: list[Vector] = []
        last = None
        for place in track[self._told_trail.get(drone.vehicle_id, 0):]:
            if last is None or float(np.linalg.norm(np.subtract(place, last))) >= TRAIL_STEP_M:
                trail.append(vector(place, 3))
                last = place
        self._told_trail[drone.vehicle_id] = len(track)
        return trail

    def _new_plans(self) -> list[LivePlan]:
        new = [p for p in map(self._plan, self._fleet.drones.values()) if self._told_plans.get(p.vehicle_id) != p]
        self._told_plans |= {p.vehicle_id: p for p in new}
        return new

    def _plan(self, drone: Drone) -> LivePlan:
        route, survey = drone.link.route, self._director.survey
        flies = drone.stage is Stage.FLYING and route is not None
        return LivePlan(vehicle_id=drone.vehicle_id,
                        waypoints_enu_m=[w.position_enu_m for w in route.waypoints] if flies and route else [],
                        later_enu_m=[] if survey is None else survey.later_enu_m(drone.vehicle_id))

    def _picture(self, meta: PictureMeta) -> LivePicture:
        path = self._run.picture(meta.vehicle_id, meta.view_id).resolve()
        return LivePicture(vehicle_id=meta.vehicle_id, view_id=meta.view_id, phase=meta.phase,
                           t_s=meta.t_capture_ns / SECOND_NS, pose=meta.pose, camera=meta.camera, file=str(path))

    def _new_voxels(self) -> LiveMap | None:
        grid = self._control.grid
        if grid is None or grid is self._told_grid:
            return None
        solid = grid.state == OCCUPIED
        before = self._told_solid if self._told_solid is not None else np.zeros_like(solid)
        self._told_grid, self._told_solid = grid, solid
        return LiveMap(origin_enu_m=vector(grid.origin_enu_m, 3), voxel_m=grid.voxel_m,
                       solid=[(i, j, k) for i, j, k in np.argwhere(solid & ~before).tolist()],
                       gone=[(i, j, k) for i, j, k in np.argwhere(before & ~solid).tolist()])


def _site(control: Control) -> LiveSite:
    mission, site = control.mission, control.site
    (lower, upper), (least, most) = geofence(mission, site), fence_limit(mission, site)
    return LiveSite(
        title=mission.title, object_lower_enu_m=site.object_min_enu_m, object_upper_enu_m=site.object_max_enu_m,
        ground_up_m=site.ground_up_m, fence_lower_enu_m=vector(lower, 3), fence_upper_enu_m=vector(upper, 3),
        limit_lower_enu_m=vector(least, 3), limit_upper_enu_m=vector(most, 3),
        pads_enu_m=takeoff_points(mission, site), survey_range_m=SurveyViewSpec.of(mission.survey).sight.farthest_m,
        reserve_percent=mission.battery.reserve_percent, threshold_percent=mission.battery.threshold_percent)
