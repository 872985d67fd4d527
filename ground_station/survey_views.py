"""Which survey views to fly: planned on the explored map, views of the exploration again, or a file."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ground_station.airspace import Airspace
from ground_station.obstacles import NO_HITS
from ground_station.prior import Prior
from ground_station.views_file import read_views
from missions.camera import Pose, View
from missions.errors import UserError
from missions.frames import Array
from missions.grid import FREE, VoxelGrid
from missions.lattice import lattice_positions
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import camera_bounds, geofence, surface_box
from planning.nbv.interest import Interest
from planning.nbv.survey import SurveyViewSpec, plan_survey

log = logging.getLogger(__name__)

FIRST_VIEW_ID = 10001
CANDIDATE_STEP_M = 2.0


def check_survey(mission: Mission) -> None:
    """Whether the mission's survey can be flown at all. Raises UserError."""
    if mission.survey.enabled and mission.survey.refine:
        _check_refining(mission)
    if not mission.survey.enabled or mission.explore.enabled or mission.survey.views == "file":
        return
    if mission.survey.views != "map" or mission.knowledge == "none":
        raise UserError("mission: survey.views = "
                        f'"{mission.survey.views}" needs explore.enabled = true; explore first or give a views file.')


def _check_refining(mission: Mission) -> None:
    if not mission.explore.enabled:
        raise UserError("mission: survey.refine needs explore.enabled = true, for it completes the explored map; "
                        "explore first or set survey.refine = 0.")
    if not (mission.camera.exact_poses or mission.reconstruct.align):
        raise UserError("mission: survey.refine takes depth from survey pictures, whose measured poses have to be "
                        "aligned for that; set reconstruct.align = true or survey.refine = 0.")


def known_space(mission: Mission, site: SiteBrief, prior: Prior | None) -> VoxelGrid:
    """What is known without exploration: what the prior model says, else what lies outside the object's box."""
    return known_outside(mission, site) if prior is None else prior.grid


def known_outside(mission: Mission, site: SiteBrief) -> VoxelGrid:
    """Without exploration, with a file of views: the space that the file's author vouches for, which is the fence
    without the object's box grown by the clearance."""
    lower, upper = geofence(mission, site)
    grid = VoxelGrid.unknown(lower, upper, mission.explore.voxel_m)
    grid.state[:] = FREE
    room = mission.fleet.clearance_m
    first = np.clip(grid.index(np.array(site.object_min_enu_m) - room), 0, None)
    last = grid.index(np.array(site.object_max_enu_m) + room) + 1
    grid.state[first[0]:last[0], first[1]:last[1], first[2]:last[2]] = 0
    return grid


def survey_views(mission: Mission, site: SiteBrief, grid: VoxelGrid, explored: Sequence[Pose],
                 starts_enu_m: list[Array], prior: Prior | None = None, hits_enu_m: Array = NO_HITS,
                 interest: Interest | None = None) -> list[View]:
    """The survey's views with ids from FIRST_VIEW_ID up. explored: the exploration's poses that may be flown again.
    interest: where pictures of planned views count more."""
    spec = mission.survey
    if spec.views == "file":
        poses = [v.pose for v in read_views(Path(spec.views_path))]
    elif spec.views in ("exploration", "frames"):
        poses = list(explored[: spec.max_views])
    else:
        airspace = Airspace.of(grid, mission, site, prior, hits_enu_m)
        wanted = replace(SurveyViewSpec.of(spec), interest=interest)
        poses = _planned(mission, grid, airspace, site, starts_enu_m, wanted, [])
    return [View(FIRST_VIEW_ID + i, pose) for i, pose in enumerate(poses)]


def refining_views(mission: Mission, site: SiteBrief, grid: VoxelGrid, taken: Sequence[Pose], first_view_id: int,
                   starts_enu_m: list[Array], prior: Prior | None = None, hits_enu_m: Array = NO_HITS,
                   interest: Interest | None = None) -> list[View]:
    """At most survey.refine more views for what the pictures taken show too rarely."""
    spec = replace(SurveyViewSpec.of(mission.survey), max_views=mission.survey.refine, interest=interest)
    airspace = Airspace.of(grid, mission, site, prior, hits_enu_m)
    poses = _planned(mission, grid, airspace, site, starts_enu_m, spec, taken)
    return [View(first_view_id + i, pose) for i, pose in enumerate(poses)]


def _planned(mission: Mission, grid: VoxelGrid, airspace: Airspace, site: SiteBrief, starts_enu_m: list[Array],
             spec: SurveyViewSpec, taken: Sequence[Pose]) -> list[Pose]:
    if not starts_enu_m:
        return []
    positions = lattice_positions(*camera_bounds(mission, site), CANDIDATE_STEP_M)
    positions = positions[airspace.clear_at(positions)]
    far = np.array([airspace.reach(start, []).distance_to(positions) for start in starts_enu_m])
    positions = positions[np.isfinite(far).any(axis=0)]
    plan = plan_survey(grid, positions, mission.camera.survey_camera(), *surface_box(mission, site), spec, taken)
    log.info("survey: %d views; %d of %d patches can be seen from %d positions; "
             "%.0f %% of these in one picture, %.0f %% in three",
             len(plan.poses), plan.coverable.sum(), len(plan.patches), len(positions), 100.0 * plan.covered_share(1),
             100.0 * plan.covered_share(3))
    return plan.poses
