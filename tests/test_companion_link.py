"""A companion's link: parameters, identity, battery, place, bad wires, and a simulated vehicle beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missions.errors import UserError
from tests.autopilot_world import Attached, AutopilotWorld, stub_on_pad
from tests.test_companion_control import LEGS, under_way
from tests.test_companion_flight import KINDS, flown, mission, world_of
from tests.vehicle_world import NS, open_map, route
from vehicle.external.companion import aligned, check_clock


@pytest.mark.parametrize("kind", KINDS)
def test_the_battery_that_is_reported_decides(tmp_path: Path, kind: str) -> None:
    world = under_way(tmp_path, kind)
    world.attached[1].stub.battery_percent = 19.0
    assert world.run(120, lambda: flown(world))
    assert {r.outcome for r in world.reports} == {"energy"}
    assert world.attached[1].stub.history[-1] == "LAND", "home by the vehicle's own way, not by the autopilot's"
    assert world.states[1][-1].battery_percent == 19.0


def test_an_unknown_battery_is_not_enough_to_take_off(tmp_path: Path) -> None:
    world = AutopilotWorld(mission(), tmp_path, {1: "px4"})
    world.attached[1].stub.battery_percent = None
    world.run(15)
    world.upload(route(LEGS), 1)
    world.run(10)
    assert world.attached[1].stub.armings == 0


@pytest.mark.parametrize("kind", KINDS)
def test_a_wire_that_loses_every_third_frame_changes_nothing(tmp_path: Path, kind: str) -> None:
    world = world_of(tmp_path, kind)
    world.attached[1].loss = 0.33
    world.upload(route(LEGS, home_after=True), 1)
    assert world.run(240, lambda: flown(world))
    assert world.views() == [100, 101, 102, 103]
    assert world.attached[1].stub.armings == 1


def test_a_simulated_and_a_real_vehicle_keep_apart(tmp_path: Path) -> None:
    world = AutopilotWorld(mission(2), tmp_path, {2: "px4"})
    world.share_map(open_map(world.mission))
    world.upload(route([(-8, -9, 5), (8, -9, 5), (-8, -9, 5)], home_after=True), 1)
    world.upload(route([(8, -9, 5), (-8, -9, 5), (8, -9, 5)], home_after=True, first_view=200, plan_id=2), 2)
    apart = []
    while not (flown(world) and world.t_ns > 60 * NS) and world.t_ns < 400 * NS:
        world.tick()
        flying = all(v.executor.flying for v in world.vehicles.values())
        other = world.vehicles[1].body.measured(world.t_ns).state.position
        apart += [float(np.linalg.norm(other - world.stub_enu(2)))] if flying else []
    assert sorted(world.views()) == [100, 101, 102, 200, 201, 202]
    assert min(apart) > 2.2


def test_parameters_that_would_not_do_are_changed_and_read_back() -> None:
    attached = Attached(stub_on_pad(mission(), "px4"))
    setup = attached.set_up(mission())
    assert attached.stub.parameters["COM_OBL_RC_ACT"][0] == 5.0
    assert attached.stub.parameters["MPC_Z_VEL_MAX_DN"][0] == pytest.approx(3.6)
    assert setup.changed == ["COM_OBL_RC_ACT from 0 to 5", "MPC_Z_VEL_MAX_UP from 3 to 3.6",
                             "MPC_Z_VEL_MAX_DN from 1.5 to 3.6"]
    assert setup.unmet(attached.link.parameters, vital=True) == setup.unmet(attached.link.parameters, vital=False) == []
    copter = Attached(stub_on_pad(mission(), "ardupilot"))
    del copter.stub.parameters["GUID_TIMEOUT"]
    setup = copter.set_up(mission())
    assert copter.stub.parameters["WPNAV_SPEED_DN"][0] == pytest.approx(360.0)
    assert setup.over(copter.link.parameters)
    assert setup.unmet(copter.link.parameters, vital=True) == ["GUID_TIMEOUT"]


def test_only_its_own_system_is_listened_to() -> None:
    attached, other = Attached(stub_on_pad(mission(2), "px4", 1)), Attached(stub_on_pad(mission(2), "ardupilot", 2))
    other.stub.battery_percent = 3.0
    for n in range(1, 500):
        attached.pump(n * 0.02)
        for frame in other.stub.step(n * 0.02):
            attached.link.receive(frame, n * 0.02)
    assert attached.link.said.dialect is not None
    assert attached.link.said.dialect.name == "px4"
    assert attached.link.said.battery_percent == 100.0
    assert attached.link.strangers == {2}


def test_an_aircraft_beside_its_pad_is_refused() -> None:
    attached = Attached(stub_on_pad(mission(), "px4"))
    attached.set_up(mission())
    with pytest.raises(UserError, match=r"stands 5\.0 m from its take-off point"):
        aligned(attached.link, mission(), np.array([3.0, -18.0, 0.2]))
    assert np.allclose(aligned(attached.link, mission(), np.array([0.0, -14.0, 0.2])).enu(
        attached.link.said.position_ned_m), [0.0, -14.0, 0.2], atol=0.02)


def test_real_aircraft_fly_in_real_time() -> None:
    check_clock(mission(clock={"speed": 1.0}))
    for clock in ({}, {"speed": 4.0}, {"speed": 1.0, "tick_s": 0.5}):
        with pytest.raises(UserError, match="real time"):
            check_clock(mission(clock=clock))
