"""`swarmscan bench energy`, and what the ground station predicts and allows."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from ground_station.bench.energy import consumption, main
from ground_station.energy import EnergyBudget
from ground_station.report.run_data import RunData, Track
from missions.mavlink import Route, Waypoint
from missions.messages import SiteBrief, VehicleState
from missions.mission import Mission
from missions.pads import hover_points
from missions.run_folder import RunFolder
from planning.trajectories import MAX_RUN
from tests.vehicle_world import SITE, World, open_map, route

BRIEF: SiteBrief = SITE


def mission(**sections: object) -> Mission:
    return msgspec.convert({"title": "test", "fleet": {"vehicles": 1}, **sections}, Mission)


def hovering(position_enu_m: tuple[float, float, float]) -> VehicleState:
    return VehicleState(vehicle_id=1, t_ns=0, position_enu_m=position_enu_m, velocity_enu_m_s=(0.0, 0.0, 0.0),
                        acceleration_enu_m_s2=(0.0, 0.0, 0.0), yaw_enu_rad=0.0, gimbal_elevation_rad=0.0,
                        battery_percent=100.0, flying=True, mode="hold")


def test_the_benchmark_tells_the_fit_and_the_curve(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {p["flight"] for p in told["published"]} == {"hover", "longest", "farthest"}
    assert all(p["model_w"] == pytest.approx(p["published_w"], rel=1e-6) for p in told["published"])
    assert told["curve"][0]["power_w"] == pytest.approx(18.96 * 2.0)
    assert told["runs"] == []


def test_plans_are_summed_by_phase_and_waiting_is_told_apart(tmp_path: Path) -> None:
    t = np.arange(0.0, 60.0, 0.1)
    mode = np.where((t > 45.0) & (t < 50.0), "wait", "mission")
    track = Track(1, t, np.stack([2.0 * t, 0.0 * t, 0.0 * t], axis=1), 100.0 - t, mode)
    plans = [{"vehicle_id": 1, "phase": "survey", "views": 3, "flown": flown, "start_s": a, "end_s": b,
              "start_percent": 100.0 - a, "end_percent": 100.0 - b, "predicted_percent": told}
             for a, b, told, flown in ((0.0, 20.0, 20.4, True), (20.0, 30.0, 9.9, True), (40.0, 55.0, 10.0, True),
                                       (56.0, 59.0, 3.0, False))]
    data = RunData(RunFolder(tmp_path), mission(), [], {"plans": plans}, {}, [track])
    (row,) = consumption("run", data)
    assert (row.phase, row.plans, row.waited) == ("survey", 3, 1)
    assert row.used_percent == pytest.approx(45.0)
    assert row.error == pytest.approx(40.3 / 45.0 - 1.0)
    assert row.error_without_waiting == pytest.approx(30.3 / 30.0 - 1.0)
    assert row.within_3_percent == 1.0
    assert row.algorithm_1_error == pytest.approx(90.0 * 0.055 / 45.0 - 1.0, rel=0.01)


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (6.0, -4.0, 0.0)])
@pytest.mark.parametrize("stop", [True, False])
def test_a_flown_plan_consumes_what_was_predicted(stop: bool, wind: tuple[float, float, float], tmp_path: Path) -> None:
    told = mission(wind={"velocity_enu_m_s": wind})
    world = World(told, tmp_path)
    world.share_map(open_map(told))
    world.upload(route([(0, -9, 5)]), 1)
    assert world.run(60, lambda: world.views() == [100])
    world.run(3)
    state, plan = world.states[1][-1], route([(x, -9, 6 + x / 5) for x in (-8, -3, 2, 8)], plan_id=2, first_view=200,
                                             stop=stop)
    predicted = EnergyBudget(told, BRIEF).route_percent(state, plan.waypoints)
    before = world.vehicles[1].battery.level_percent
    world.upload(plan, 1)
    assert world.run(60, lambda: len(world.views()) == 5 and world.vehicles[1].executor.idle)
    used = before - world.vehicles[1].battery.level_percent
    assert used == pytest.approx(predicted, rel=0.03)


def test_a_plan_is_predicted_as_the_vehicle_reads_and_cuts_it(tmp_path: Path) -> None:
    """Pictures close beside corners, where MAVLink's rounding counts, and more waypoints than one run takes."""
    told = mission()
    world = World(told, tmp_path)
    world.share_map(open_map(told))
    world.upload(route([(0, -9, 5)]), 1)
    assert world.run(60, lambda: world.views() == [100])
    world.run(3)
    corners = [(x, -9.0 + 1.5 * (x % 2), 5.0) for x in range(-8, 9)]
    points = [p for a, b in itertools.pairwise(corners) for p in
              (a, tuple(float(u + 0.09 * (v - u)) for u, v in zip(a, b, strict=True)))]
    plan = Route(plan_id=2, phase="explore", waypoints=[
        Waypoint(position_enu_m=p, yaw_enu_rad=0.0, view_id=200 + n, stop=n == len(points) - 1)  # type: ignore[arg-type]
        for n, p in enumerate(points)])
    assert len(points) > MAX_RUN
    predicted = EnergyBudget(told, BRIEF).route_percent(world.states[1][-1], plan.waypoints)
    before = world.vehicles[1].battery.level_percent
    world.upload(plan, 1)
    assert world.run(120, lambda: len(world.views()) == 1 + len(points) and world.vehicles[1].executor.idle)
    assert before - world.vehicles[1].battery.level_percent == pytest.approx(predicted, rel=0.02)


def test_exploration_leaves_its_share_to_the_survey() -> None:
    budget = EnergyBudget(mission(battery={"start_percent": [80.0], "threshold_percent": 20.0}), BRIEF)
    assert budget.usable_percent(1, 80.0) == 60.0
    assert budget.usable_percent(1, 80.0, exploring=True) == 30.0
    assert budget.usable_percent(1, 15.0) < 0.0
    alone = EnergyBudget(mission(survey={"enabled": False}), BRIEF)
    assert alone.usable_percent(1, 70.0, exploring=True) == alone.usable_percent(1, 70.0) == 50.0


@pytest.mark.parametrize("model", ["power", "distance"])
def test_goals_are_affordable_as_long_as_the_way_home_is(model: str) -> None:
    told = mission(battery={"model": model})
    budget, hover = EnergyBudget(told, BRIEF), np.array(hover_points(told, BRIEF)[0])
    goals = hover + np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [100.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    way = np.array([0.0, 20.0, 100.0, np.inf])
    assert budget.affordable(1, hover, goals, way, 100.0).tolist() == [True, True, True, False]
    assert budget.affordable(1, hover, goals, way, 3.0).tolist() == [True, True, False, False]
    assert budget.affordable(1, hover, goals, way, -0.1).tolist() == [False, False, False, False]


def test_waypoints_passed_at_speed_take_less_than_stops() -> None:
    budget, state = EnergyBudget(mission(), BRIEF), hovering((0.0, 0.0, 5.0))
    totals = [budget.route_percent(state, [
        Waypoint(position_enu_m=(5.0 * n, 0.0, 5.0), yaw_enu_rad=0.0, stop=stop or n == 6) for n in range(1, 7)])
        for stop in (True, False)]
    assert totals[1] < totals[0]
