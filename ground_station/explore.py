"""Exploration decisions: pictures and positions in, legs out. No bus, no clock; equal calls give equal legs."""

from __future__ import annotations

import logging
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ground_station.airspace import Airspace, joined
from ground_station.decision import Asking, Busy, Decision, Leg
from ground_station.energy import EnergyBudget
from ground_station.exploration_log import ExplorationLog
from ground_station.ingest import Picture
from ground_station.legs import column_leg, picture_leg
from ground_station.novelty import Novelty
from ground_station.obstacles import NO_HITS
from ground_station.prior import Prior
from ground_station.regions import Regions
from missions.camera import Pose
from missions.frames import Array, forward_enu
from missions.grid import OCCUPIED, VoxelGrid
from missions.mavlink import Waypoint
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.pads import camera_bounds, fence_limit, hover_points, takeoff_columns
from perception.depth.depth_map import DepthMap
from perception.mapping.explorer_map import ExplorerMap
from planning.nbv.lattice import build_lattice
from planning.nbv.legs_ahead import Asker, Plan, plan_views
from planning.nbv.outlook import AheadSpec
from planning.nbv.stopping import Price
from planning.paths import NoPath, Reach
from planning.trajectories import Limits

log = logging.getLogger(__name__)

CLIMB_M = 5.0
"""A vehicle takes its first pictures while it climbs this much over its hover point: depth needs the baseline."""
GOAL_SPACING_M = 2.0
"""Goals of two vehicles are this much farther apart than fleet.separation_m."""
CLIMB_PICTURES = 8
"""Close enough together that two of them see every voxel before the column; the map calls nothing free that only one
picture looked through."""
SWEEP_OFFSET_M = 1.5
"""How far beside its middle a vehicle may fly in its column."""
LEAST_BASELINE_M = 1.5
"""A vehicle that only turns where it hovers brings home one picture and no depth; it goes elsewhere when it can."""
FALLBACK_TURN_RAD = math.radians(50.0)
MAX_FALLBACKS = 6
LEAST_GAIN_M2 = 0.5
"""No plan is flown whose best view promises less than this."""
FLOWN_STEP_M = 0.25
"""Ways that were flown are taken in by steps of this length."""
MAYBE_OPEN = 0.5
"""Chance that a look opens the way to a position, and the factor for each look that did not."""


class Explorer:
    """The shared map and the search over it."""

    def __init__(self, mission: Mission, site: SiteBrief, prior: Prior | None = None,
                 regions: Regions | None = None) -> None:
        """regions: what operators mark while it explores."""
        self._mission, self._site, self._prior = mission, site, prior
        self._regions = regions or Regions(mission, site)
        self.map = ExplorerMap(*fence_limit(mission, site), mission.explore.voxel_m, mission.fleet.radius_m)
        self._hover = [np.array(p) for p in hover_points(mission, site)]
        self._energy = EnergyBudget(mission, site)
        for lower, upper in takeoff_columns(mission, site):
            self.map.mark_free(lower, upper + np.array([0.0, 0.0, CLIMB_M]))
        self._lattice = build_lattice(*camera_bounds(mission, site), mission.explore)
        self._taken = np.zeros((len(self._lattice.positions_enu_m), len(self._lattice.yaw_enu_rad)), dtype=np.bool_)
        self._looks = np.zeros(len(self._lattice.positions_enu_m), dtype=np.int64)
        self._camera = mission.camera.explore_camera()
        self._ahead = AheadSpec(Limits.of_fleet(mission.fleet), mission.fleet.separation_m + GOAL_SPACING_M)
        self.grid: VoxelGrid = self.map.grid()
        self._novelty = Novelty(mission, site)
        self._imagined = self._novelty.imagined(self.grid)
        self.log, self._price = ExplorationLog(), Price(mission.explore.price_m2_per_m)
        self.goal_coverage: float | None = None
        """An operator's: explores until that is reached, whatever a view costs."""
        self._next_view_id = 1
        self.key_views: dict[int, Pose] = {}
        self.pictured: dict[tuple[int, int], Pose] = {}
        """Where every picture was taken, by vehicle and view."""
        self._in_map: dict[int, int] = {}
        """Key views' pictures as the map numbers them."""
        self.pictures_new = 0
        self._fallbacks: dict[int, int] = {}
        self._flown: dict[int, Array] = {}

    def flew(self, vehicle_id: int, position_enu_m: Array) -> None:
        """Where a vehicle is in flight. What is known to be free on its way stays so, however later pictures judge it:
        else the map may close around a vehicle that has long passed the place."""
        begun = self._flown.setdefault(vehicle_id, position_enu_m)
        if float(np.linalg.norm(position_enu_m - begun)) >= FLOWN_STEP_M:
            radius_m = self._mission.fleet.clearance_m + 2.0 * self._mission.explore.voxel_m
            self.map.hold_free(self.grid, begun, position_enu_m, radius_m)
            self._flown[vehicle_id] = position_enu_m

    def add(self, picture: Picture) -> None:
        """Take in a picture; it is mapped at the next decision."""
        if picture.rgb is None:
            return
        meta = picture.meta
        self.pictured[meta.vehicle_id, meta.view_id] = meta.pose
        number = self.map.add_picture(picture.rgb, meta.camera, meta.pose)
        if meta.view_id in self.key_views:
            self._in_map[meta.view_id] = number
            self.log.arrived(meta.view_id)
        self.pictures_new += 1
        self._novelty.add(meta.pose)

    def poses(self, every_picture: bool) -> list[Pose]:
        """Key poses in the order they were given out; or where every picture was taken, vehicle after vehicle, each in
        its order of flight."""
        if every_picture:
            return [self.pictured[key] for key in sorted(self.pictured)]
        return [self.key_views[key] for key in sorted(self.key_views)]

    def refresh(self) -> None:
        """Bring the map up to date with the pictures."""
        if self.pictures_new:
            self.map.update()
            self.pictures_new = 0
            self.grid = self.map.grid()
            self._imagined = self._novelty.imagined(self.grid)
            self.log.settle(self._novelty.tally(self.grid, self._imagined, self._lattice.positions_enu_m))

    @property
    def coverage(self) -> float:
        """Estimated share of the object's visible surface that was seen, 0 to 1."""
        return self.log.tally.coverage

    def depths(self, count: int) -> dict[int, DepthMap]:
        """By view id, depth of as many key views, spread over the flight."""
        found = {view_id: self.map.depth(number) for view_id, number in sorted(self._in_map.items())}
        known = [(view_id, depth) for view_id, depth in found.items() if depth is not None]
        chosen = np.linspace(0, len(known) - 1, min(count, len(known))).astype(np.int64)
        return dict(known[int(n)] for n in chosen)

    def decide(self, asking: list[Asking], busy: list[Busy], hits_enu_m: Array = NO_HITS) -> Decision:
        """Next views for the hovering vehicles over the map as `refresh` left it. Ways keep clear of what vehicles have
        hit (n, 3) and the map does not show."""
        airspace = Airspace.of(self._regions.applied(self.grid), self._mission, self._site, self._prior, hits_enu_m)
        reaches = {a.vehicle_id: airspace.reach(a.position_enu_m, _mates(a, asking, busy)) for a in asking}
        claimed = [b.goal for b in busy if b.goal is not None]
        ways_m = np.array([reaches[a.vehicle_id].distance_to(self._lattice.positions_enu_m) for a in asking])
        may = np.array([self._may_go(a, way, claimed) for a, way in zip(asking, ways_m, strict=True)])
        askers = [Asker(a.vehicle_id, np.where(ok, w, np.inf)) for a, w, ok in zip(asking, ways_m, may, strict=True)]
        barred = np.isfinite(ways_m).any(axis=0) & ~may.any(axis=0)
        imagined = replace(self._novelty.without(self._imagined, claimed), interest=self._regions.interest)
        plans = plan_views(imagined, self._lattice, self._camera, self._mission.explore.sensing_range_m, askers,
                           self._chance(barred), self._ahead, self._pays)
        stuck = [a.vehicle_id for a, way in zip(asking, ways_m, strict=True) if not np.isfinite(way).any()]
        spent = [a.vehicle_id for a, way in zip(asking, ways_m, strict=True)
                 if np.isfinite(way).any() and not self._affordable(a, way).any()]
        limited = [a.vehicle_id for a, way in zip(asking, ways_m, strict=True)
                   if (np.isfinite(way) & ~self._affordable(a, way)).any()]
        return Decision(self._legs(plans, airspace, reaches, asking, busy), stuck, spent, limited)

    def _legs(self, plans: list[Plan], airspace: Airspace, reaches: dict[int, Reach], asking: list[Asking],
              busy: list[Busy]) -> list[Leg]:
        """Legs to the first view of every plan; those that find no way around the goals given before are left out."""
        legs: list[Leg] = []
        for plan in plans:
            self._taken[plan.views[0]] = True
            self._looks[plan.opens] += 1
            a = next(a for a in asking if a.vehicle_id == plan.vehicle_id)
            goal = self._lattice.pose(*plan.views[0])
            at = np.array(goal.position_enu_m)
            mates = _mates(a, asking, busy) + [np.array(leg.goal.position_enu_m) for leg in legs]
            try:
                path = (airspace.path(a.position_enu_m, at, mates) if legs else
                        joined(a.position_enu_m, reaches[a.vehicle_id].path_to(at)))
            except NoPath:
                continue
            legs.append(self._leg(a, path, goal, plan.gains_m2[0]))
        return legs

    def _chance(self, barred: NDArray[np.bool_]) -> Array:
        """(p, o) how likely each view can be had once its position is looked at from afar: less with every look that
        did not open it, not at all beside known surface, where nobody may go, and for views that were given before."""
        chance = MAYBE_OPEN ** (1.0 + self._looks)
        solid = self.grid.centers(np.argwhere(self.grid.state == OCCUPIED))
        if len(solid):
            clearance_m = self._mission.fleet.clearance_m
            near, _ = cKDTree(solid).query(self._lattice.positions_enu_m, distance_upper_bound=clearance_m)
            chance[np.isfinite(near)] = 0.0
        return np.where(self._taken | barred[:, None], 0.0, chance[:, None])

    def _pays(self, gains_m2: list[float], legs_m: list[float]) -> bool:
        """Whether a plan is worth flying."""
        if max(gains_m2) < LEAST_GAIN_M2:
            self.log.ended = f"no view promised {LEAST_GAIN_M2:g} m²"
            return False
        if self.goal_coverage is not None:
            reached = self.coverage >= self.goal_coverage
            self.log.ended = f"the goal of {self.goal_coverage:.0%} coverage is reached" if reached else ""
            return not reached
        return self.log.worth(gains_m2, legs_m, self._price)

    def column(self, vehicle_id: int) -> Leg:
        """The first pictures: on the vertical line over the pad, facing the object's centre."""
        hover = self._hover[vehicle_id - 1]
        return self._sweep(vehicle_id, hover, float(hover[2]), float(hover[2]) + CLIMB_M, 0.0)

    def look_around(self, asking: Asking) -> Leg | None:
        """For a vehicle that can reach nothing: another pass through its column, off its middle, so that more is seen
        of the space before it; or other directions from where it hovers. None after MAX_FALLBACKS of them."""
        n = self._fallbacks[asking.vehicle_id] = self._fallbacks.get(asking.vehicle_id, 0) + 1
        if n > MAX_FALLBACKS:
            return None
        side = 1.0 if n % 2 else -1.0
        turn = side * FALLBACK_TURN_RAD * ((n - 1) // 2)
        hover, here = self._hover[asking.vehicle_id - 1], asking.position_enu_m
        if np.hypot(*(here - hover)[:2]) < 1.5 * SWEEP_OFFSET_M:
            ahead = forward_enu(self._yaw_to_object(hover), 0.0)
            offset = SWEEP_OFFSET_M * np.clip(ahead + side * np.array([-ahead[1], ahead[0], 0.0]), -1.0, 1.0)
            low, high = float(hover[2]), float(hover[2]) + CLIMB_M
            ends = (low, high) if here[2] < 0.5 * (low + high) else (high, low)
            return self._sweep(asking.vehicle_id, hover + offset, *ends, turn)
        x, y, z = (float(c) for c in here)
        goal = Pose((x, y, z), asking.yaw_enu_rad + side * FALLBACK_TURN_RAD, 0.0)
        return self._leg(asking, np.stack([here, here]), goal)

    def _sweep(self, vehicle_id: int, foot_enu_m: Array, first_up_m: float, last_up_m: float, turn_rad: float) -> Leg:
        """Pictures on a vertical line from the first to the last height, facing the object's centre but for a turn."""
        yaw = self._yaw_to_object(foot_enu_m) + turn_rad
        return self._register(vehicle_id, column_leg(foot_enu_m, (first_up_m, last_up_m), yaw, CLIMB_PICTURES,
                                                     self._next_view_id), abs(last_up_m - first_up_m))

    def _yaw_to_object(self, from_enu_m: Array) -> float:
        middle = 0.5 * (np.array(self._site.object_min_enu_m) + np.array(self._site.object_max_enu_m))
        return math.atan2(middle[1] - from_enu_m[1], middle[0] - from_enu_m[0])

    def look_again(self, vehicle_id: int) -> None:
        """The vehicle was shut in and is brought back to its column, from where it may look around once more."""
        self._fallbacks.pop(vehicle_id, None)

    def forbid(self, goal: Pose) -> None:
        """Never again send anybody to this position: it was refused or blocked."""
        near = np.linalg.norm(self._lattice.positions_enu_m - np.array(goal.position_enu_m), axis=1) < 1e-3
        self._taken[near] = True

    def _may_go(self, a: Asking, way_m: Array, claimed: list[Pose]) -> NDArray[np.bool_]:
        """(p,) positions within reach from which there is a baseline for depth, energy for the way home, and which are
        not another vehicle's goal."""
        positions = self._lattice.positions_enu_m
        away = np.linalg.norm(positions - a.position_enu_m, axis=1) > LEAST_BASELINE_M
        may = np.isfinite(way_m) & away if np.isfinite(way_m[away]).any() else np.isfinite(way_m)
        may &= self._affordable(a, way_m)
        for goal in claimed:
            may &= np.linalg.norm(positions - np.array(goal.position_enu_m), axis=1) >= self._ahead.separation_m
        return may

    def _affordable(self, a: Asking, way_m: Array) -> NDArray[np.bool_]:
        """(p,) positions that it can reach with energy for the way home."""
        return self._energy.affordable(a.vehicle_id, a.position_enu_m, self._lattice.positions_enu_m, way_m,
                                       a.usable_percent)

    def _leg(self, a: Asking, path: Array, goal: Pose, gain_m2: float | None = None) -> Leg:
        start = Pose((0.0, 0.0, 0.0), a.yaw_enu_rad, a.elevation_rad)
        return self._register(a.vehicle_id, picture_leg(path, start, goal, self._mission.explore.frames_per_leg,
                                                        self._next_view_id),
                              float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()), gain_m2)

    def _register(self, vehicle_id: int, waypoints: list[Waypoint], leg_m: float, gain_m2: float | None = None) -> Leg:
        ids = [w.view_id for w in waypoints if w.view_id is not None]
        self._next_view_id += len(ids)
        last = waypoints[-1]
        goal = Pose(last.position_enu_m, last.yaw_enu_rad, last.gimbal_elevation_rad)
        self.key_views[ids[-1]] = goal
        self.log.given(ids[-1], vehicle_id, len(ids), gain_m2 or 0.0, leg_m)
        return Leg(vehicle_id, waypoints, goal, gain_m2)


def _mates(me: Asking, asking: list[Asking], busy: list[Busy]) -> list[Array]:
    """Places that other vehicles hover at or are on their way to."""
    out = [a.position_enu_m for a in asking if a.vehicle_id != me.vehicle_id]
    for b in busy:
        out.append(b.position_enu_m)
        if b.goal is not None:
            out.append(np.array(b.goal.position_enu_m))
    return out
