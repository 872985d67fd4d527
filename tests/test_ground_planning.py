"""Legs, airspace, views files and the launcher's refusals."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from ground_station import launcher
from ground_station.airspace import Airspace
from ground_station.decision import Asking
from ground_station.explore import MAX_FALLBACKS, Explorer
from ground_station.legs import picture_leg
from ground_station.novelty import Novelty
from ground_station.recorder import Recorder
from ground_station.survey_views import check_survey, known_outside, refining_views, survey_views
from ground_station.views_file import read_views
from missions.camera import Pose
from missions.errors import UserError
from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from missions.messages import SiteBrief, VehicleState
from missions.mission import CameraSpec, ExploreSpec, Mission, ReconstructSpec, SurveySpec
from missions.mission_file import load_mission
from missions.pads import geofence, hover_points
from missions.run_folder import RunFolder
from planning.paths import NoPath

SITE = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)
MISSION = Mission(title="t")


def known(free: tuple[slice, slice, slice]) -> Airspace:
    grid = VoxelGrid.unknown(*geofence(MISSION, SITE), 0.5)
    grid.state[free] = FREE
    return Airspace.of(grid, MISSION, SITE)


@example([(0.0, 0.0, 0.0), (0.0, 20.0, 2.0), (0.0, 1.125, 4.0625), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)], 3, 0.0, 0.0)
@given(st.lists(st.tuples(*[st.floats(-20, 20)] * 3), min_size=2, max_size=6), st.integers(1, 8),
       st.floats(-3, 3), st.floats(-3, 3))
def test_a_leg_ends_at_its_key_view_and_spreads_its_pictures(points: list[tuple[float, float, float]], frames: int,
                                                             yaw_a: float, yaw_b: float) -> None:
    path = np.array(points)
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    goal = Pose(points[-1], yaw_b, 0.3)
    leg = picture_leg(path, Pose((0.0, 0.0, 0.0), yaw_a, -0.5), goal, frames, 40)
    ids = [w.view_id for w in leg if w.view_id is not None]
    assert ids == list(range(40, 40 + len(ids)))
    assert len(ids) == (frames if length >= 0.05 else 1)
    assert np.allclose(leg[-1].position_enu_m, path[-1], atol=1e-6)
    assert leg[-1].gimbal_elevation_rad == pytest.approx(0.3)
    assert np.cos(leg[-1].yaw_enu_rad - yaw_b) == pytest.approx(1.0)
    assert leg[-1].stop
    assert leg[-1].view_id == ids[-1]
    assert not any(w.stop for w in leg[:-1])


def test_paths_stay_in_known_free_space_and_clear_of_teammates() -> None:
    space = known((slice(None), slice(None), slice(None)))
    a, b, mate = np.array([-12.0, -8.0, 5.0]), np.array([12.0, -8.0, 5.0]), np.array([0.0, -8.0, 5.0])
    path = space.path(a, b, [mate])
    f = np.linspace(0, 1, 200)[:, None]
    fine = np.concatenate([p + f * (q - p) for p, q in itertools.pairwise(path)])
    assert np.linalg.norm(fine - mate, axis=1).min() >= MISSION.fleet.separation_m
    with pytest.raises(NoPath, match="goal occupied"):
        known((slice(0, 40), slice(None), slice(None))).path(a, b, [])


@settings(max_examples=30, deadline=None)
@given(st.floats(0.2, 1.25))
def test_a_place_that_became_narrow_is_left_without_coming_nearer(depth: float) -> None:
    space = known((slice(0, 60), slice(None), slice(None)))
    wall = space.field.origin[0] + 0.5 * space.field.voxel_m + 60 * 0.5
    start = np.array([wall - depth, 0.0, 10.0])
    wide = space.wide_place(space.field, start)
    assert space.clear_at(wide[None])[0]
    before = space.field.clearance_m(start)[0]
    along = start + np.linspace(0, 1, 50)[:, None] * (wide - start)
    assert space.field.clearance_m(along).min() >= before - 0.35
    assert np.linalg.norm(wide - start) <= 4.0 + 1e-9


@pytest.mark.parametrize(("seed", "start"), [(2, (-11.62, 0.17, 3.0)), (9, (-14.99, 5.8, 5.71))])
def test_a_narrow_place_is_left_by_a_way_that_leads_on_not_into_the_nearest_pocket(
        seed: int, start: tuple[float, float, float]) -> None:
    grid = VoxelGrid.unknown(*geofence(MISSION, SITE), 0.5)
    grid.state[np.random.default_rng(seed).random(grid.state.shape) >= 0.01] = FREE
    space, here, goal = Airspace.of(grid, MISSION, SITE), np.array(start), np.array(hover_points(MISSION, SITE)[0])
    goals = goal + np.stack(np.meshgrid([-2, 0, 2], [-2, 0, 2], [0, 2, 4]), axis=-1).reshape(-1, 3)
    goal = goals[space.clear_at(goals)][0]
    assert 0.5 < space.field.clearance_m(here)[0] < space.clearance_m
    assert np.isfinite(space.reach(here, []).distance_to(goal)).all()
    path = space.path(here, goal, [])
    assert path[[0, -1]].tolist() == [here.tolist(), goal.tolist()]
    assert space.clear_at(path[1:]).all()


def test_shut_in_vehicles_look_around_inside_their_column_and_give_up() -> None:
    explorer = Explorer(MISSION, SITE)
    hover = np.array(hover_points(MISSION, SITE)[0])
    space = Airspace.of(explorer.grid, MISSION, SITE)
    here, seen = hover, set[int | None]()
    for _ in range(MAX_FALLBACKS):
        decision = explorer.decide([Asking(1, here, 0.0, 0.0, 1e4)], [])
        assert (decision.legs, decision.stuck, decision.spent) == ([], [1], [])
        leg = explorer.look_around(Asking(1, here, 0.0, 0.0, 1e4))
        assert leg is not None
        assert space.clear_at(np.array([w.position_enu_m for w in leg.waypoints])).all()
        ids = {w.view_id for w in leg.waypoints}
        assert not ids & seen
        seen |= ids
        here = np.array(leg.waypoints[-1].position_enu_m)
    assert explorer.look_around(Asking(1, here, 0.0, 0.0, 1e4)) is None


def test_the_map_does_not_close_behind_a_vehicle() -> None:
    explorer, (lower, upper) = Explorer(MISSION, SITE), geofence(MISSION, SITE)
    known = explorer.grid = VoxelGrid.unknown(lower, upper, 0.5)
    known.state[:] = FREE
    way = np.array(hover_points(MISSION, SITE)[0]) + np.linspace(0.0, 1.0, 40)[:, None] * np.array([-5.0, 0.0, 6.0])
    for position in way:
        explorer.flew(1, position)
    after = Airspace.of(explorer.map.grid(), MISSION, SITE)
    assert after.clear_at(way).all()
    assert not after.clear_at(way[-1:] + np.array([0.0, 3.0, 0.0]))[0]


def test_who_has_energy_for_nothing_gets_nothing_and_is_not_shut_in() -> None:
    explorer, (lower, upper) = Explorer(MISSION, SITE), geofence(MISSION, SITE)
    explorer.map.mark_free(lower, np.array([upper[0], SITE.object_min_enu_m[1] - 1.0, upper[2]]))
    explorer.grid = explorer.map.grid()
    here = np.array(hover_points(MISSION, SITE)[0])
    decision = explorer.decide([Asking(1, here, 0.0, 0.0, 0.0)], [])
    assert (decision.legs, decision.stuck, decision.spent) == ([], [], [1])
    [leg] = explorer.decide([Asking(1, here, 0.0, 0.0, 1e4)], []).legs
    assert leg.predicted_gain_m2 is not None
    assert leg.predicted_gain_m2 > 0.0
    assert leg.goal.position_enu_m == leg.waypoints[-1].position_enu_m


def test_views_files_are_read_or_refused_with_line_and_remedy(tmp_path: Path) -> None:
    path = tmp_path / "views.csv"
    path.write_text("view_id,east_m,north_m,up_m,yaw_deg,elevation_deg\n7,1,2,3,90,-30\n")
    [view] = read_views(path)
    assert (view.view_id, view.pose.position_enu_m) == (7, (1.0, 2.0, 3.0))
    assert (view.pose.yaw_enu_rad, view.pose.elevation_rad) == pytest.approx((np.pi / 2, -np.pi / 6))
    q = ",".join(map(str, view.pose.quaternion_wxyz))
    path.write_text(f"\ufeffview_id, east_m, north_m, up_m, qw, qx, qy, qz\n7,1,2,3,{q}\n", encoding="utf-8")
    assert read_views(path)[0].pose.yaw_enu_rad == pytest.approx(np.pi / 2)
    for text, hint in (("view_id,east_m\n1,2\n", "north_m, up_m are missing"),
                       ("view_id,east_m,north_m,up_m,yaw_deg,elevation_deg\n7,x,2,3,90,0\n", "line 2"),
                       ("view_id,east_m,north_m,up_m,yaw_deg,elevation_deg\n7,nan,2,3,90,0\n", "not a finite view"),
                       ("view_id,east_m,north_m,up_m,yaw_deg,elevation_deg\n" + "7,1,2,3,0,0\n" * 2, "occurs twice")):
        path.write_text(text)
        with pytest.raises(UserError, match=hint):
            read_views(path)


def test_a_survey_that_knows_nothing_is_refused() -> None:
    with pytest.raises(UserError, match="explore first or give a views file"):
        check_survey(Mission(title="t", explore=ExploreSpec(enabled=False)))
    with pytest.raises(UserError, match=r"explore first or set survey\.refine = 0"):
        check_survey(Mission(title="t", knowledge="mesh", explore=ExploreSpec(enabled=False),
                             survey=SurveySpec(refine=5)))
    measured = Mission(title="t", camera=CameraSpec(attitude_sigma_deg=0.3), survey=SurveySpec(refine=5))
    check_survey(measured)
    with pytest.raises(UserError, match=r"set reconstruct\.align = true"):
        check_survey(replace(measured, reconstruct=ReconstructSpec(align=False)))


def test_a_second_flight_goes_to_what_the_first_one_did_not_know_of() -> None:
    mission = Mission(title="t", survey=SurveySpec(max_views=20, refine=6))
    grid = VoxelGrid.unknown(*geofence(mission, SITE), 0.5)
    grid.state[:] = FREE
    west, east = (grid.index(np.array([x, 0.0, 1.0])) for x in (-3.0, 3.0))
    grid.state[west[0], west[1] - 4:west[1] + 4, west[2]:west[2] + 8] = OCCUPIED
    start = [np.array([0.0, -12.0, 4.0])]
    taken = [v.pose for v in survey_views(mission, SITE, grid, [], start)]
    assert refining_views(mission, SITE, grid, taken, 10021, start) == []
    grid.state[east[0], east[1] - 4:east[1] + 4, east[2]:east[2] + 8] = OCCUPIED
    more = refining_views(mission, SITE, grid, taken, 10021, start)
    assert [v.view_id for v in more] == list(range(10021, 10027))
    nearer_east = [v.pose.position_enu_m[0] + 2.0 * math.cos(v.pose.yaw_enu_rad) > 0.0 for v in more]
    assert all(nearer_east)


def test_without_exploration_the_objects_box_is_not_free() -> None:
    grid = known_outside(MISSION, SITE)
    inside = np.random.default_rng(1).uniform(SITE.object_min_enu_m, SITE.object_max_enu_m, (200, 3))
    assert (grid.state_at(inside) == UNKNOWN).all()
    assert grid.state_at(np.array([[-12.0, -8.0, 5.0]]))[0] == FREE


def test_the_command_line_overrides_the_mission_and_refuses_nonsense(tmp_path: Path) -> None:
    run = tmp_path / "run"
    options = launcher._parse(["bridge", "--set", "explore.max_views=7", "--vehicles", "3", "--scene", "statue",
                               "--speed", "2", "--run", str(run)])
    mission, folder = launcher.prepare(options)
    assert (mission.explore.max_views, mission.fleet.vehicles, mission.scene.name) == (7, 3, "statue")
    assert load_mission(folder.mission) == mission
    with pytest.raises(UserError, match="not empty"):
        launcher.prepare(options)
    for bad, hint in ((["bridge", "--scene", "nowhere.glb"], "nowhere.glb"), (["bridge", "--set", "x"], "no '='"),
                      (["bridge", "--set", "explore.mox=1"], "unknown key explore.mox"),
                      (["bridge", "--set", "airframe.range_km=60"], "airframe: no power model")):
        with pytest.raises(UserError, match=hint):
            launcher.prepare(launcher._parse([*bad, "--run", str(tmp_path / "other")]))


def test_what_is_known_is_written_when_the_mission_is_cut_short(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    recorder = Recorder(run, MISSION, SITE)
    recorder.begin("explore", 0)
    for tick in range(30):
        x = 0.1 * tick
        recorder.tracks[1].add(VehicleState(
            vehicle_id=1, t_ns=tick * 70_000_000, position_enu_m=(x, 0.0, 2.0), velocity_enu_m_s=(1.0, 0.0, 0.0),
            acceleration_enu_m_s2=(0.0, 0.0, 0.0), yaw_enu_rad=0.0, gimbal_elevation_rad=0.0,
            battery_percent=100.0 - x, flying=True, mode="mission" if tick < 20 else "hold"))
        if tick == 10:
            recorder.plan_begins(1, "explore", 4, tick * 70_000_000, predicted_percent=0.9)
    recorder.plan_ends(1, 29 * 70_000_000, flown=True)
    recorder.write(2_030_000_000)
    with np.load(run.trajectories) as tracks:
        assert np.allclose(tracks["uav1_t_s"], np.arange(21) / 10)
        assert np.allclose(tracks["uav1_position_enu_m"][:, 0], tracks["uav1_t_s"] / 0.7)
        assert tracks["uav1_mode"].tolist() == ["mission"] * 14 + ["hold"] * 7
    record = json.loads(run.flight.read_text())
    [plan] = record["plans"]
    assert (plan["start_s"], plan["end_s"], plan["flown"]) == (pytest.approx(0.7), pytest.approx(2.03), True)
    assert plan["start_percent"] - plan["end_percent"] == pytest.approx(1.9)
    assert record["phases"]["explore"]["end_s"] == pytest.approx(2.03)
    assert record["fleet"]["path_m"]["1"] == pytest.approx(2.9)


def test_imagination_learns_in_flight_where_the_mission_says_so() -> None:
    grid, last = VoxelGrid.unknown(*geofence(MISSION, SITE), 0.5), {}
    for adapt in (False, True):
        novelty = Novelty(Mission(title="t", explore=ExploreSpec(adapt=adapt)), SITE)
        for share in (0.4, 0.46, 0.5):
            state = np.zeros_like(grid.state)
            state[:int(share * len(state))] = FREE
            last[adapt] = novelty.imagined(VoxelGrid(grid.origin_enu_m, grid.voxel_m, state)).occupancy
    assert last[True].mean() < last[False].mean()
