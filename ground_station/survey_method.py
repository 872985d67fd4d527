"""How a mission's survey is flown: by which method views are given out, and how pictures are taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ground_station.airspace import Airspace
from ground_station.leg_costs import LegCosts
from ground_station.legs import Shooting
from ground_station.minmax_tours import MinmaxTours
from ground_station.obstacles import NO_HITS
from ground_station.prior import Prior
from ground_station.roadmap_airspace import RoadmapAirspace
from ground_station.thesis_airspace import ThesisAirspace
from ground_station.thesis_tours import ThesisTours
from ground_station.tours import Method
from missions.camera import View
from missions.frames import Array
from missions.grid import VoxelGrid
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import hover_points
from planning.nbv.standoff import nearest_depth_m
from planning.paths.roadmap import build_roadmap
from planning.trajectories import shutter_speed_m_s


@dataclass(frozen=True)
class Means:
    """What the survey decides and leads with."""

    method: Method
    airspace: Airspace
    shooting: Shooting


def means_of(mission: Mission, site: SiteBrief, views: list[View], grid: VoxelGrid, prior: Prior | None,
             starts_enu_m: list[Array], hits_enu_m: Array = NO_HITS) -> Means:
    """By `survey.method`: ours over a roadmap of all views, or the thesis's, whose own planner leads the legs around
    what is known where it flies with a prior model. starts_enu_m: where vehicles are; hits_enu_m: (n, 3) what they have
    hit that no map shows."""
    shooting, plain = shooting_of(mission, views, grid), Airspace.of(grid, mission, site, prior, hits_enu_m)
    if mission.survey.method == "thesis":
        own = plain if prior is None else ThesisAirspace.with_prior(plain, prior, mission)
        return Means(ThesisTours(views, mission), own, shooting)
    places = [*starts_enu_m, *hover_points(mission, site), *(v.pose.position_enu_m for v in views)]
    roadmap = build_roadmap(plain.field, np.array(places), plain.clearance_m, starts=len(starts_enu_m))
    costs = LegCosts(roadmap, views, shooting, mission, plain)
    method = MinmaxTours(views, mission, costs, 100.0 - mission.battery.threshold_percent)
    return Means(method, RoadmapAirspace.over(plain, roadmap), shooting)


def shooting_of(mission: Mission, views: list[View], grid: VoxelGrid) -> Shooting:
    """At rest, or in passing so slowly that neither motion blur nor the ground sampling distance suffers."""
    spec, lens = mission.survey, mission.camera
    camera = lens.survey_camera()
    depth_m = nearest_depth_m(grid, [v.pose for v in views], camera)
    speed_m_s = {v.view_id: shutter_speed_m_s(float(depth), camera.fx_px, lens.exposure_s, lens.max_blur_px, spec.gsd_m)
                 for v, depth in zip(views, depth_m, strict=True)}
    return Shooting(spec.stop_at_views, spec.settle_s, spec.pass_m, speed_m_s)
