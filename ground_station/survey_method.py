"""How a mission's survey is flown: by which method views are given out, and how pictures are taken."""

from __future__ import annotations

from ground_station.airspace import Airspace
from ground_station.leg_costs import LegCosts
from ground_station.legs import Shooting
from ground_station.minmax_tours import MinmaxTours
from ground_station.prior import Prior
from ground_station.thesis_airspace import ThesisAirspace
from ground_station.thesis_tours import ThesisTours
from ground_station.tours import Method
from missions.camera import View
from missions.grid import VoxelGrid
from missions.messages import SiteBrief
from missions.mission import Mission
from planning.nbv.standoff import nearest_depth_m
from planning.trajectories import shutter_speed_m_s


def method_of(mission: Mission, views: list[View]) -> Method:
    """What `survey.method` names."""
    if mission.survey.method == "thesis":
        return ThesisTours(views, mission)
    return MinmaxTours(views, mission, LegCosts(views, mission), 100.0 - mission.battery.threshold_percent)


def airspace_of(mission: Mission, site: SiteBrief, grid: VoxelGrid, prior: Prior | None) -> Airspace:
    """Who leads the survey's legs around what is known: the thesis where its method flies with a prior model."""
    if mission.survey.method == "thesis" and prior is not None:
        return ThesisAirspace.with_prior(prior, grid, mission, site)
    return Airspace.of(grid, mission, site, prior)


def shooting_of(mission: Mission, views: list[View], grid: VoxelGrid) -> Shooting:
    """At rest, or in passing so slowly that neither motion blur nor the ground sampling distance suffers."""
    spec, lens = mission.survey, mission.camera
    camera = lens.survey_camera()
    depth_m = nearest_depth_m(grid, [v.pose for v in views], camera)
    speed_m_s = {v.view_id: shutter_speed_m_s(float(depth), camera.fx_px, lens.exposure_s, lens.max_blur_px, spec.gsd_m)
                 for v, depth in zip(views, depth_m, strict=True)}
    return Shooting(spec.stop_at_views, spec.settle_s, spec.pass_m, speed_m_s)
