"""The thesis's planning experiment on the views of a run: what its figures 5.7 to 5.15 are drawn from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
import trimesh

from ground_station.report.run_data import RunData
from ground_station.report.thesis import PLANS, ReportedPlan
from ground_station.views_file import read_views
from missions.errors import UserError
from missions.frames import Array
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import geofence, hover_points
from missions.prior_file import prior_file
from planning.allocate.cost import LegCost
from planning.allocate.thesis_experiment import Discharge, Experiment, Obstacle, experiment, percent_per_m_to_stop

COSTS = ("distance", "distance_elevation")
BOUNDS_MARGIN_M = 5.0
BELOW_THRESHOLD_PERCENT = 0.12
"""How far below the threshold a vehicle is where it stops: the thesis's stopped at 19.88 %."""


@dataclass(frozen=True)
class ThesisRun:
    """Plans over the same views, by kind of cost."""

    positions_enu_m: Array
    """(n, 3) all views in the order in which they were taken or planned; a plan's view ids are indices into it."""
    plans: dict[str, Experiment]
    surface_enu_m: Array
    """(s, 3) samples of the structure; none where it is unknown."""


def planned_positions(data: RunData) -> Array:
    """(n, 3) where the survey's views stand: those of a file, exploration's pictures when these are flown again, else
    where the survey's pictures were taken."""
    spec = data.mission.survey
    if spec.views == "file":
        return np.array([v.pose.position_enu_m for v in read_views(Path(spec.views_path))])
    phase = "explore" if spec.views == "frames" else "survey"
    rows = sorted((v for v in data.views if v.phase == phase),
                  key=lambda v: (v.vehicle_id if phase == "explore" else 0, v.view_id))
    if not rows:
        raise UserError(f"{data.run.views_csv}: no {phase} pictures; fly the mission's {phase} phase first.")
    return np.array([v.position_enu_m for v in rows[: spec.max_views]])


@dataclass(frozen=True)
class Setting:
    """What is planned: views (n, 3), vehicles, batteries, weights of Eq. 4.4; what is known of pads and structure."""

    positions_enu_m: Array
    vehicles: int
    discharge: Discharge
    alpha: float = 1.0
    beta: float = 0.5
    starts_enu_m: Array | None = None
    obstacle: Obstacle | None = None
    seed: int = 1

    def plan(self, cost: str) -> Experiment:
        """With one kind of cost."""
        return experiment(self.positions_enu_m, self.vehicles, LegCost(cost, self.alpha, self.beta),  # type: ignore[arg-type]
                          self.discharge, self.starts_enu_m, self.obstacle, self.seed)


def plan_both(setting: Setting, stop_index: int | None = None) -> dict[str, Experiment]:
    """Plans by kind of cost.

    stop_index: at the consumption with which the vehicle with most points meets the threshold there with the distance
    cost. Raises UserError when the index is beyond its tour.
    """
    if stop_index is not None:
        paid = setting.discharge
        free = replace(setting, discharge=replace(paid, percent_per_m=0.0)).plan("distance")
        rate = consumption_for(free, stop_index, paid.threshold_percent - BELOW_THRESHOLD_PERCENT)
        setting = replace(setting, discharge=replace(paid, percent_per_m=rate))
    return {cost: setting.plan(cost) for cost in COSTS}


def plan_run(data: RunData, percent_per_m: float | None = None, stop_index: int | None = None) -> ThesisRun:
    """Plan a run's views with both costs. percent_per_m replaces the mission's. Raises UserError without views."""
    mission, survey, positions = data.mission, data.mission.survey, planned_positions(data)
    rate = mission.battery.percent_per_m if percent_per_m is None else percent_per_m
    setting = Setting(positions, mission.fleet.vehicles, Discharge(rate, mission.battery.threshold_percent),
                      survey.alpha, survey.beta, _starts(data), _obstacle(data, positions), mission.seed)
    return ThesisRun(positions, plan_both(setting, stop_index), _surface(data))


def write_waypoints(plan: Experiment, path: Path) -> None:
    """The thesis's .npz; its arrays are those of `Experiment.table`."""
    np.savez_compressed(path, **plan.table())  # type: ignore[arg-type]


def reported_plan(mission: Mission) -> ReportedPlan | None:
    """What the thesis tells of a mission's scene; None where it is not one of its own."""
    return PLANS.get("" if mission.scene.path else mission.scene.name)


def consumption_for(plan: Experiment, stop_index: int, level_percent: float) -> float:
    """Percent per metre at which the vehicle with most points reaches a level at an index. Raises UserError."""
    longest = max(plan.tours.values(), key=lambda tour: len(tour.own.view))
    if not 0 < stop_index < len(longest.own.view):
        raise UserError(f"stop index {stop_index}: the longest tour has {len(longest.own.view)} points; "
                        f"give 1 to {len(longest.own.view) - 1}.")
    return percent_per_m_to_stop(longest.forecast.distance_m, stop_index, level_percent)


def _starts(data: RunData) -> Array | None:
    """Where the tours begin: over the pads, or where exploration ended; None where that is not known."""
    phases, told = data.flight.get("phases") or {}, data.flight.get("site")
    if "survey" not in phases or told is None or len(data.tracks) != data.mission.fleet.vehicles:
        return None
    if "explore" not in phases:
        return np.array(hover_points(data.mission, msgspec.convert(told, SiteBrief)))
    begin = phases["survey"]["start_s"]
    return np.array([[np.interp(begin, t.t_s, column) for column in t.position_enu_m.T] for t in data.tracks])


def _obstacle(data: RunData, positions: Array) -> Obstacle | None:
    """The structure, which the thesis's planner knows: the prior model, else the truth; None when there is neither."""
    known = [p for p in (prior_file(data.mission, data.run), data.run.truth_mesh) if p is not None and p.is_file()]
    if not known:
        data.notes.append("truth/reference.ply is missing: the thesis's tours were not led around the structure.")
        return None
    mesh = trimesh.load_mesh(known[0], process=False)
    told = data.flight.get("site") or data.referee.get("site")
    if told is None:
        lower, upper = positions.min(axis=0) - BOUNDS_MARGIN_M, positions.max(axis=0) + BOUNDS_MARGIN_M
        lower[2] = positions[:, 2].min()
    else:
        site = msgspec.convert(told, SiteBrief)
        lower, upper = geofence(data.mission, site)
        lower[2] = min(site.ground_up_m + data.mission.site.camera_floor_m, positions[:, 2].min())
    return Obstacle(np.asarray(mesh.triangles, dtype=np.float64), lower, upper)


def _surface(data: RunData) -> Array:
    if not data.run.truth_samples.is_file():
        return np.zeros((0, 3))
    with np.load(data.run.truth_samples) as stored:
        return np.asarray(stored["points"], dtype=np.float64)
