"""Views are conserved: whatever dies, runs low or is blocked, each ends with one outcome; none is flown twice."""

from __future__ import annotations

import random
from collections import defaultdict
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ground_station.airspace import Airspace
from ground_station.energy import EnergyBudget
from ground_station.ledger import ENERGY, FLOWN, LOST, UNREACHABLE, ViewLedger
from ground_station.leg_costs import LegCosts
from ground_station.legs import Shooting
from ground_station.minmax_tours import MinmaxTours
from ground_station.survey import CHUNK_VIEWS, Survey
from ground_station.survey_phase import refused_view
from ground_station.thesis_tours import ThesisTours
from ground_station.tours import Flyer
from missions.camera import Pose, View
from missions.grid import FREE, OCCUPIED, VoxelGrid
from missions.messages import SiteBrief
from missions.mission import BatterySpec, Mission
from missions.pads import hover_points, takeoff_points
from planning.allocate.minmax import Effort
from planning.paths.roadmap import build_roadmap
from planning.trajectories import Limits
from planning.trajectories.energy import DistanceEnergy
from vehicle.way_home import WayHome

MISSION = Mission(title="t")
QUICK = Effort(iterations=200, chains=1)
SHOOTING = Shooting(stop=False, settle_s=0.5, pass_m=0.25, speed_m_s=defaultdict(lambda: 1.5))
SITE = SiteBrief(object_min_enu_m=(-5.0, -5.0, 0.0), object_max_enu_m=(5.0, 5.0, 8.0), ground_up_m=0.0)


def free_grid(wall: bool = False) -> VoxelGrid:
    grid = VoxelGrid.unknown(np.array([-30.0, -30.0, 0.0]), np.array([30.0, 30.0, 30.0]), 1.0)
    grid.state[:] = FREE
    if wall:
        grid.state[40:] = OCCUPIED
    return grid


def views(n: int, seed: int = 0) -> list[View]:
    rng = np.random.default_rng(seed)
    return [View(10001 + i, Pose(tuple(rng.uniform((-10, -10, 3), (8, 10, 12))), 0.0, 0.0)) for i in range(n)]


def flyer(k: int, usable_percent: float = 80.0, swaps: int = 0) -> Flyer:
    home = np.array([6.0 * k, -15.0, 3.0])
    return Flyer(k, home, home, usable_percent, swaps)


@lru_cache
def costs_of(targets: tuple[View, ...]) -> LegCosts:
    homes = [flyer(k).home_enu_m for k in range(1, 5)]
    roadmap = build_roadmap(AIR.field, np.array([*homes, *(v.pose.position_enu_m for v in targets)]), AIR.clearance_m)
    return LegCosts(roadmap, list(targets), SHOOTING, MISSION, AIR)


def survey_of(targets: list[View], method: str = "swarmscan") -> Survey:
    """Ours with little effort: what holds does not depend on how good the tours are."""
    if method == "thesis":
        return Survey(targets, ThesisTours(targets, MISSION), SHOOTING)
    return Survey(targets, MinmaxTours(targets, MISSION, costs_of(tuple(targets)), 80.0, QUICK, QUICK), SHOOTING)


GRID = free_grid()
AIR, BEHIND_WALL = (Airspace.of(grid, MISSION, SITE) for grid in (GRID, free_grid(wall=True)))


class Team:
    """Vehicles that come to grief at random: plans refused, views blocked, batteries empty, swapped, vehicles lost."""

    def __init__(self, survey: Survey, vehicles: int, rng: random.Random) -> None:
        self.survey, self.rng = survey, rng
        self.flyers = {k: flyer(k, swaps=rng.randrange(3)) for k in range(1, vehicles + 1)}
        self.flown: list[int] = []

    def able(self) -> list[Flyer]:
        return [f for f in self.flyers.values() if f.usable_percent > 0.0 or f.swaps]

    def fly(self, k: int, calm: bool) -> None:
        me = self.flyers[k]
        if me.swaps and self.survey.wants_swap(k):
            self.survey.swapped(k)
            me = self.flyers[k] = replace(me, usable_percent=80.0, swaps=me.swaps - 1)
        waypoints = self.survey.next_waypoints(me, AIR, []) if self.survey.waiting(k) else []
        plan = [w.view_id for w in waypoints if w.view_id is not None]
        assert not plan or me.usable_percent > 0.0
        assert not set(plan) & set(self.flown)
        if plan and self.rng.random() < 0.1:
            self.survey.plan_refused(k, "clearance")
            return
        for view_id in plan:
            event = self.rng.random()
            if event < 0.7:
                self.survey.flown(view_id, k)
                self.flown.append(view_id)
            elif event < 0.8:
                self.survey.not_flown(view_id, k, "blocked", "a crane")
            elif event < 0.85 and not calm:
                self.leave(k)
                return
        self.survey.plan_over(k)

    def leave(self, k: int) -> None:
        lost = self.rng.random() < 0.5
        self.survey.gone(k, "lost" if lost else ENERGY)
        self.flyers[k] = replace(self.flyers[k], usable_percent=0.0, swaps=0 if lost else self.flyers[k].swaps)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(["swarmscan", "thesis"]), st.integers(1, 4), st.sampled_from([0, 1, 2, 9, 30]),
       st.randoms(use_true_random=False))
def test_every_view_gets_exactly_one_outcome(method: str, vehicles: int, n: int, rng: random.Random) -> None:
    survey = survey_of(views(n), method)
    team = Team(survey, vehicles, rng)
    survey.begin(team.able(), 0.0)
    for step in range(400):
        if survey.over:
            break
        for k in team.flyers:
            team.fly(k, calm=step > 300)
        if survey.news([f.vehicle_id for f in team.able()]):
            survey.redistribute(team.able(), float(step))
    outcomes, flown = survey.ledger.outcomes(), team.flown
    assert survey.over
    assert set(outcomes) == {str(10001 + i) for i in range(n)}
    assert set(outcomes.values()) <= {FLOWN, UNREACHABLE, ENERGY, LOST}
    assert sorted(flown) == sorted(int(k) for k, v in outcomes.items() if v == FLOWN)
    assert len(flown) == len(set(flown))
    assert set(survey.ledger.details()) == {k for k, v in outcomes.items() if v != FLOWN}


def test_no_tour_ends_where_its_vehicle_would_refuse_to_go() -> None:
    """A vehicle keeps more for the way home, a detour and landing, than the way that the map shows takes."""
    battery = BatterySpec(model="distance", percent_per_m=1.6, threshold_percent=8.0)
    mission, targets = Mission(title="t", battery=battery), views(24)
    roadmap = build_roadmap(AIR.field, np.array([flyer(1).home_enu_m, *(v.pose.position_enu_m for v in targets)]),
                            AIR.clearance_m)
    costs, budget = LegCosts(roadmap, targets, SHOOTING, mission, AIR), EnergyBudget(mission, SITE)
    hover, energy, limits = flyer(1).home_enu_m, DistanceEnergy(1.6), Limits.of_fleet(mission.fleet)
    pad = hover - (np.array(hover_points(mission, SITE)[0]) - takeoff_points(mission, SITE)[0])
    keeps = WayHome(energy, hover, pad, limits, limits, limits, mission.fleet.vehicles - 1)
    fresh = 100.0 - battery.threshold_percent
    own = Flyer(1, hover, hover, fresh, 12, budget.at_home_percent(1))
    tours = MinmaxTours(targets, mission, costs, fresh, QUICK, QUICK).begin([own]).sorties[1]
    assert len(tours) > 1
    there, between = costs.from_place(hover).percent, costs.between.percent
    for sortie in tours:
        i = [v - targets[0].view_id for v in sortie]
        used = there[i[0]] + between[i[:-1], i[1:]].sum()
        kept = keeps.percent(np.array(targets[i[-1]].pose.position_enu_m))
        assert used + kept <= 100.0 - battery.reserve_percent + 1e-9


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 3), st.integers(0, 3), st.floats(1.0, 4.0))
def test_tours_stay_within_each_battery_and_go_on_with_the_next(vehicles: int, swaps: int, usable: float) -> None:
    targets = views(24)
    costs = costs_of(tuple(targets))
    flyers = [flyer(k, usable, swaps) for k in range(1, vehicles + 1)]
    tours = MinmaxTours(targets, MISSION, costs, usable, QUICK, QUICK).begin(flyers)
    given_out = [v for f in flyers for sortie in tours.sorties[f.vehicle_id] for v in sortie]
    assert sorted([*given_out, *tours.left_over]) == [v.view_id for v in targets]
    for f in flyers:
        assert len(tours.sorties[f.vehicle_id]) <= 1 + swaps
        for sortie in filter(None, tours.sorties[f.vehicle_id]):
            i = [v - targets[0].view_id for v in sortie]
            used = costs.from_place(f.home_enu_m).percent[i[0]] + costs.to_place(f.home_enu_m).percent[i[-1]]
            assert used + costs.between.percent[i[:-1], i[1:]].sum() <= usable + 1e-4


def test_whoever_joins_gets_views_of_the_others() -> None:
    survey = survey_of(views(30))
    survey.begin([flyer(1)], 0.0)
    assert survey.news([1]) == ""
    assert survey.news([1, 2]) == "join"
    survey.redistribute([flyer(1), flyer(2)], 3.0)
    assert survey.news([1, 2]) == ""
    assert survey.left(1) + survey.left(2) == 30
    assert survey.left(2) > 5
    assert {(r["from"], r["to"], r["reason"]) for r in survey.ledger.reassignments} == {(1, 2, "balance")}


def test_whoever_is_done_early_is_offered_what_the_others_have_not_been_sent_once() -> None:
    survey = survey_of(views(120))
    survey.begin([flyer(1), flyer(2)], 0.0)
    survey.next_waypoints(flyer(2), AIR, [])
    for view_id in survey.ledger.held_by(1):
        survey.flown(view_id, 1)
    unsent = survey.left(2) - CHUNK_VIEWS
    assert unsent > 5
    assert survey.news([1, 2]) == "idle"
    survey.redistribute([flyer(1), flyer(2)], 1.0)
    assert survey.news([1, 2]) == ""
    assert survey.left(1) + survey.left(2) == unsent + CHUNK_VIEWS
    assert survey.left(1) > 0


def test_what_was_sent_stays_with_its_vehicle_in_the_order_sent() -> None:
    survey = survey_of(views(60))
    survey.begin([flyer(1), flyer(2)], 0.0)
    sent = [w.view_id for w in survey.next_waypoints(flyer(2), AIR, []) if w.view_id is not None]
    survey.gone(1, LOST)
    survey.redistribute([flyer(2), flyer(3)], 1.0)
    assert set(sent) <= set(survey.ledger.held_by(2))
    assert not set(sent) & {w.view_id for w in survey.next_waypoints(flyer(2), AIR, [])}
    assert survey.left(3) > 0


def test_a_lost_vehicles_views_go_to_the_other_and_keep_their_origin() -> None:
    survey, both = survey_of(views(30)), [flyer(1), flyer(2)]
    survey.begin(both, 0.0)
    mine = survey.ledger.held_by(1)
    survey.next_waypoints(both[0], AIR, [])
    survey.flown(mine[0], 1)
    survey.gone(1, "lost")
    survey.redistribute([both[1]], 7.0)
    assert survey.ledger.held_by(1) == []
    assert len(survey.ledger.held_by(2)) == 29
    assert {survey.ledger.origin(v) for v in mine} == {1}
    assert [(r["view_id"], r["from"], r["to"], r["t_s"]) for r in survey.ledger.reassignments] == [
        (v, 1, 2, 7.0) for v in [r["view_id"] for r in survey.ledger.reassignments]]
    assert {r["view_id"] for r in survey.ledger.reassignments} == set(mine[1:])


def test_blocked_views_are_tried_once_by_another_then_unreachable() -> None:
    ledger = ViewLedger(views(1))
    ledger.assign(10001, 1, 0.0)
    ledger.blocked(10001, "a crane")
    assert ledger.homeless() == [10001]
    ledger.assign(10001, 2, 1.0)
    ledger.blocked(10001, "a crane")
    assert ledger.outcomes() == {"10001": UNREACHABLE}
    with pytest.raises(ValueError, match="not free"):
        ledger.assign(10001, 1, 2.0)


def test_a_refused_chunk_is_halved_until_the_bad_view_stands_alone() -> None:
    survey, me = survey_of(views(16)), flyer(1)
    survey.begin([me], 0.0)
    bad = survey.ledger.held_by(1)[5]
    for _ in range(40):
        if not survey.waiting(1):
            break
        plan = [w.view_id for w in survey.next_waypoints(me, AIR, []) if w.view_id is not None]
        if bad in plan:
            survey.plan_refused(1, "clearance")
            continue
        for view_id in plan:
            survey.flown(view_id, 1)
    survey.redistribute([me], 1.0)
    assert {k for k, v in survey.ledger.outcomes().items() if v != FLOWN} == {str(bad)}
    assert survey.ledger.outcomes()[str(bad)] == UNREACHABLE


def test_the_view_that_a_refusal_names_is_left_out_and_the_others_are_sent_again() -> None:
    survey, me = survey_of(views(16)), flyer(1)
    survey.begin([me], 0.0)
    sent = survey.next_waypoints(me, AIR, [])
    n = next(i for i, w in enumerate(sent) if i > 5 and w.view_id is not None)
    reason = f"plan refused: clearance: waypoint {n} is nearer than 1.0 m to what is not known to be free"
    culprit = refused_view(reason, sent)
    assert culprit == sent[n].view_id
    assert refused_view("plan refused: energy", sent) is None
    survey.plan_refused(1, reason, culprit)
    again = [w.view_id for w in survey.next_waypoints(me, AIR, []) if w.view_id is not None]
    assert again == [w.view_id for w in sent if w.view_id not in (None, culprit)]
    survey.redistribute([me], 1.0)
    assert survey.ledger.details() == {str(culprit): reason}


def test_views_in_solid_space_are_never_in_a_plan() -> None:
    inside = View(10001, Pose((20.0, 0.0, 10.0), 0.0, 0.0))
    outside = View(10002, Pose((0.0, 0.0, 10.0), 0.0, 0.0))
    survey = survey_of([inside, outside])
    survey.begin([flyer(1)], 0.0)
    plan = survey.next_waypoints(flyer(1), BEHIND_WALL, [])
    assert [w.view_id for w in plan if w.view_id is not None] == [10002]


def test_a_vehicle_without_a_way_to_any_of_its_views_is_shut_in() -> None:
    survey = survey_of(views(3))
    survey.begin([flyer(1)], 0.0)
    behind = Flyer(1, np.array([20.0, 0.0, 10.0]), flyer(1).home_enu_m, 1e4)
    assert not survey.shut_in(flyer(1), AIR, [])
    assert survey.shut_in(behind, BEHIND_WALL, [])
    assert not survey.shut_in(flyer(2), BEHIND_WALL, [])
    assert survey.left(1) == 3


def test_without_range_nothing_is_promised() -> None:
    survey, poor = survey_of(views(5)), flyer(2, usable_percent=0.01)
    survey.begin([flyer(1)], 0.0)
    survey.gone(1, ENERGY)
    survey.redistribute([poor], 1.0)
    assert set(survey.ledger.outcomes().values()) == {ENERGY}


def test_chunks_are_small_enough_to_upload() -> None:
    survey = survey_of(views(3 * CHUNK_VIEWS))
    survey.begin([flyer(1)], 0.0)
    plan = survey.next_waypoints(flyer(1), AIR, [])
    assert sum(w.view_id is not None for w in plan) == CHUNK_VIEWS <= 60
