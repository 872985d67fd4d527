"""A vehicle whose body is a real autopilot, here a stub that lags behind: the whole flight, and who has control."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from missions.mission import Mission
from missions.pads import takeoff_points
from tests.autopilot_world import AutopilotWorld
from tests.vehicle_world import NS, SITE, open_map, route

KINDS = ["px4", "ardupilot"]


def mission(vehicles: int = 1, **sections: object) -> Mission:
    return msgspec.convert({"title": "test", "fleet": {"vehicles": vehicles}, **sections}, Mission)


def world_of(tmp_path: Path, kind: str, vehicles: int = 1, **options: float) -> AutopilotWorld:
    world = AutopilotWorld(mission(vehicles), tmp_path, {1: kind}, **options)
    world.share_map(open_map(world.mission))
    return world


def flown(world: AutopilotWorld) -> bool:
    return world.t_ns > 5 * NS and world.landed()


@pytest.mark.parametrize("kind", KINDS)
def test_a_plan_is_flown_photographed_where_the_aircraft_is_and_ends_on_the_pad(tmp_path: Path, kind: str) -> None:
    world = world_of(tmp_path, kind)
    plan = route([(0, -8, 4), (8, -8, 4), (8, -8, 8), (-6, -9, 7)], home_after=True)
    world.upload(plan, 1)
    stub, errors = world.attached[1].stub, []
    seen = 0
    while not flown(world) and world.t_ns < 240 * NS:
        world.tick()
        for shutter in world.shutters[seen:]:
            errors.append(np.linalg.norm(np.subtract(shutter.pose.position_enu_m, world.stub_enu(1))))
        seen = len(world.shutters)
    assert flown(world)
    assert world.views() == [100, 101, 102, 103]
    assert world.reports == []
    assert max(errors) < 0.1
    for shutter, wanted in zip(world.shutters, plan.waypoints, strict=True):
        assert np.linalg.norm(np.subtract(shutter.pose.position_enu_m, wanted.position_enu_m)) < 0.35
    assert not stub.armed
    assert stub.armings == 1
    assert np.linalg.norm(world.stub_enu(1) - takeoff_points(world.mission, SITE)[0]) < 0.5
    assert stub.history == (["HOLD", "TAKEOFF", "HOLD", "OFFBOARD", "LAND"] if kind == "px4" else
                            ["STABILIZE", "GUIDED", "LAND"])


@pytest.mark.parametrize("drift_m", [-0.8, 0.8])
def test_height_that_has_drifted_on_the_pad_is_set_right_at_take_off(tmp_path: Path, drift_m: float) -> None:
    world = world_of(tmp_path, "px4")
    stub = world.attached[1].stub
    stub.local_origin = stub.local_origin + np.array([0.0, 0.0, drift_m])
    world.run(2)
    world.upload(route([(0, -8, 5)]), 1)
    assert world.run(60, lambda: world.views() == [100])
    assert np.linalg.norm(world.stub_enu(1) - np.array([0.0, -8.0, 5.0])) < 0.35


@pytest.mark.parametrize("kind", KINDS)
def test_the_aircraft_keeps_to_its_flight_and_takes_pictures_in_passing(tmp_path: Path, kind: str) -> None:
    world = world_of(tmp_path, kind)
    world.upload(route([(-8, -9, 5), (-3, -9, 5), (2, -9, 6), (8, -12, 5)], stop=False, home_after=True), 1)
    body, off, texts = world.vehicles[1].body, [], world.mavlink[1]
    while not flown(world) and world.t_ns < 240 * NS:
        t_ns = world.t_ns
        world.tick()
        if world.shutters and world.states[1][-1].mode not in ("land", "standby"):
            off.append(float(np.linalg.norm(body.at(t_ns).state.position - world.stub_enu(1))))
    assert flown(world)
    assert max(off) < 0.35
    assert "planning anew from where it is" not in [m.text for m in texts if m.get_type() == "STATUSTEXT"]
    assert world.views() == [100, 101, 102, 103]
    assert [s.speed_m_s > 0.5 for s in world.shutters] == [False, True, True, False]
