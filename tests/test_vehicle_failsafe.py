"""Everything that can be wrong, one vehicle at a time, from the fault to the ground."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from missions import topics
from missions.clock import vehicle_name
from missions.frames import Array
from missions.grid import OCCUPIED, UNKNOWN
from missions.messages import RangeScan, VehicleState
from missions.mission import Mission
from missions.pads import geofence, takeoff_points
from missions.simulation import FaultSpec
from planning.trajectories import State
from tests.vehicle_world import NS, SITE, Box, World, box_distance, open_map, route
from vehicle.failsafe_table import Trigger
from vehicle.geofence import FENCE_TOLERANCE_M, Circle, Geofence
from vehicle.health import HEALTHY
from vehicle.lease import OUR_GROUND
from vehicle.simulator import Kinematics, KinematicSimulator
from vehicle.vehicle import Vehicle

PLAN = [(-9.0, -10.0, 5.0), (9.0, -10.0, 5.0), (-9.0, -8.0, 7.0), (9.0, -8.0, 7.0)]
EVER = 1e9


def world_with(folder: Path, *faults: tuple[str, float, float, float], **sections: object) -> World:
    """One vehicle on its way along PLAN, with these faults (kind, from s, until s, amount)."""
    specs = [{"vehicle": 1, "kind": k, "at_s": a, "until_s": u, "amount": n} for k, a, u, n in faults]
    tree = {"title": "test", "fleet": {"vehicles": 1}, "faults": specs, **sections}
    world = World(msgspec.convert(tree, Mission), folder)
    world.share_map(open_map(world.mission))
    world.upload(route(PLAN, home_after=True), 1)
    return world


def texts(world: World) -> list[str]:
    return [m.text for m in world.mavlink[1] if m.get_type() == "STATUSTEXT"]


def modes(world: World) -> list[str]:
    """Modes of the flight, without repetitions."""
    told = [s.mode for s in world.states[1]]
    return [m for n, m in enumerate(told) if n == 0 or m != told[n - 1]]


def at(world: World, second: float) -> VehicleState:
    """The state told last before a time."""
    return next(s for s in reversed(world.states[1]) if s.t_ns <= second * NS)


def stood_still(world: World, from_s: float, until_s: float) -> bool:
    inside = [s for s in world.states[1] if from_s * NS <= s.t_ns <= until_s * NS]
    return len(inside) > 10 and all(np.linalg.norm(s.velocity_enu_m_s) < 1e-9 for s in inside)


def landed_at(world: World) -> Array:
    return np.array(world.states[1][-1].position_enu_m)


def on_its_pad(world: World) -> bool:
    return bool(np.linalg.norm(landed_at(world) - takeoff_points(world.mission, SITE)[0]) < 0.01)


def fly(world: World, seconds: float = 300.0) -> World:
    assert world.run(seconds, lambda: world.t_ns > 5 * NS and world.landed()), modes(world)
    return world


@pytest.mark.parametrize(("kind", "amount"), [("position_lost", 0.0), ("range_blind", 0.0), ("clock_jump", 2.0)])
def test_a_short_fault_is_waited_for_and_the_plan_goes_on(kind: str, amount: float, tmp_path: Path) -> None:
    world = fly(world_with(tmp_path, (kind, 12.0, 18.0, amount)))
    assert stood_still(world, 15.5, 16.8)
    assert world.views() == [100, 101, 102, 103]
    assert not world.reports
    assert on_its_pad(world)
    said = texts(world)
    begun, ended = said.index(f"simulated fault: {kind} begins"), said.index(f"simulated fault: {kind} ends")
    what = {"position_lost": "position lost", "range_blind": "range sensor blind", "clock_jump": "clock jumped"}[kind]
    assert f"{what}: holding" in said[begun:ended]
    assert f"{what}: over" in said[begun:]


def test_without_a_position_it_lands_where_it_is(tmp_path: Path) -> None:
    world = fly(world_with(tmp_path, ("position_lost", 12.0, EVER, 0.0)))
    assert stood_still(world, 16.0, 21.9)
    sinking = np.array([s.position_enu_m for s in world.states[1] if s.t_ns > 16 * NS])
    assert np.ptp(sinking[:, :2], axis=0).max() < 1e-6
    assert np.all(np.diff(sinking[:, 2]) <= 1e-9)
    assert modes(world)[-2:] == ["emergency", "standby"] or modes(world)[-1] == "emergency"
    assert [r.outcome for r in world.reports] == ["energy"] * len(world.reports)
    assert "position lost: landing here" in texts(world)


def test_a_blind_vehicle_holds_and_then_returns(tmp_path: Path) -> None:
    world = fly(world_with(tmp_path, ("range_blind", 12.0, EVER, 0.0)))
    assert stood_still(world, 16.0, 32.0)
    assert on_its_pad(world)
    assert "return" in modes(world)
    assert len(world.views()) + len(world.reports) == 4


def unknown_block(world: World, block: Box) -> None:
    """The ground takes back what it knew of a block."""
    grid = open_map(world.mission, [block])
    grid.state[grid.state == OCCUPIED] = UNKNOWN
    world.share_map(grid)


def test_a_blind_vehicle_does_not_return_through_what_is_unknown(tmp_path: Path) -> None:
    block = ((-7.0, -14.5, 0.0), (-4.0, -8.5, 8.0))
    world = world_with(tmp_path, ("range_blind", 7.8, EVER, 0.0), fleet={"vehicles": 1, "range_sensor_m": 0.3})
    world.run(14.0)
    east = world.path(1)[-1][0]
    assert east < -7.5, "the block lies between it and its pad"
    unknown_block(world, block)
    fly(world)
    after = np.array([s.position_enu_m for s in world.states[1] if s.t_ns > 14 * NS])
    assert box_distance(after, block).min() >= world.mission.fleet.clearance_m - 0.1
    assert on_its_pad(world)


def test_where_no_way_home_is_known_it_waits_for_one_and_lands_before_the_battery_is_empty(tmp_path: Path) -> None:
    world = world_with(tmp_path, ("range_blind", 7.8, EVER, 0.0), ("battery_sag", 60.0, EVER, 93.0),
                       fleet={"vehicles": 1, "range_sensor_m": 0.3})
    world.run(14.0)
    unknown_block(world, ((-7.0, -30.0, 0.0), (-4.0, 30.0, 40.0)))
    fly(world, 3000.0)
    assert world.path(1)[:, 0][-1] < -7.0
    assert not on_its_pad(world)
    assert world.vehicles[1].battery.level_percent > 0.0
    assert any("landing here" in t for t in texts(world))


@pytest.mark.parametrize(("sag", "said", "home"), [
    (82.0, "battery at threshold: returning", True), (94.0, "battery needed for the way home: returning", True),
    (97.5, "battery all but empty: landing here", False)])
def test_a_sagging_battery_sends_it_home_or_down(sag: float, said: str, home: bool, tmp_path: Path) -> None:
    world = fly(world_with(tmp_path, ("battery_sag", 14.0, EVER, sag)))
    assert said in texts(world)
    assert on_its_pad(world) is home
    assert world.reports


def test_a_battery_that_recovers_does_not_call_the_vehicle_back(tmp_path: Path) -> None:
    world = fly(world_with(tmp_path, ("battery_sag", 14.0, 16.0, 94.0)))
    flown = modes(world)
    assert flown[flown.index("return"):] == ["return", "land", "standby"][:len(flown) - flown.index("return")]
    assert on_its_pad(world)


def test_an_unknown_charge_is_warned_of_and_then_it_returns(tmp_path: Path) -> None:
    world = fly(world_with(tmp_path, ("battery_silent", 12.0, EVER, 0.0), battery={"percent_per_m": 0.0}))
    said = texts(world)
    assert "battery data missing: flying on" in said
    if "return" in modes(world) and "battery data missing: returning" in said:
        assert said.index("battery data missing: flying on") < said.index("battery data missing: returning")
    assert on_its_pad(world)


@pytest.mark.parametrize("kind", ["battery_silent", "position_lost"])
def test_what_is_not_known_keeps_it_on_the_ground(kind: str, tmp_path: Path) -> None:
    world = world_with(tmp_path, (kind, 0.0, 20.0, 0.0))
    world.run(19)
    assert not world.vehicles[1].executor.flying
    world.run(4)
    world.upload(route(PLAN, plan_id=2, home_after=True), 1)
    assert world.run(20, lambda: world.vehicles[1].executor.flying)


def test_a_lost_ground_station_lets_it_finish_its_plan(tmp_path: Path) -> None:
    world = world_with(tmp_path, ("ground_link_lost", 12.0, EVER, 0.0))
    world.upload(route([*PLAN, *PLAN], home_after=False), 1)
    fly(world)
    assert "ground silent: finishing the plan, then returning" in texts(world)
    assert sorted(set(world.views())) == list(range(100, 108))
    assert on_its_pad(world)


def test_whoever_hovers_on_the_word_of_a_ground_station_that_is_lost_comes_home(tmp_path: Path) -> None:
    world = world_with(tmp_path)
    assert world.run(60, lambda: bool(world.views()))
    world.vehicles[1].executor.hold(world.t_ns, OUR_GROUND)
    world.run(5)
    world.ground_alive = False
    assert world.run(60, world.landed)
    assert on_its_pad(world)


def test_people_who_tell_a_held_vehicle_to_hold_are_heeded_when_the_fault_is_over(tmp_path: Path) -> None:
    world = world_with(tmp_path, ("range_blind", 12.0, 16.0, 0.0))
    world.run(15)
    world.vehicles[1].executor.hold(world.t_ns, OUR_GROUND)
    world.run(30)
    assert stood_still(world, 20.0, 45.0)
    world.vehicles[1].executor.start()
    fly(world)
    assert world.views() == [100, 101, 102, 103]


def test_the_third_hold_in_a_minute_for_the_same_reason_is_the_last(tmp_path: Path) -> None:
    flicker = [("range_blind", s, s + 2.0, 0.0) for s in (12.0, 20.0, 28.0, 36.0, 44.0)]
    world = fly(world_with(tmp_path, *flicker))
    assert modes(world).count("hold") == 2
    assert "range sensor blind: returning" in texts(world)
    assert at(world, 31.5).mode == "return"
    assert on_its_pad(world)


def move_fence(world: World, fence: Geofence) -> float:
    """As an upload does; when that was, seconds."""
    vehicle = world.vehicles[1]
    vehicle.judge.fence = vehicle.lookout.fence = fence
    return world.t_ns / NS


def room(world: World, fence: Geofence, from_s: float) -> float:
    """The least room that the vehicle had inside a fence in the air, from a time on."""
    points = [s.position_enu_m for s in world.states[1] if s.t_ns >= from_s * NS and s.mode not in ("land", "standby")]
    return float(fence.room_m(np.array(points)).min())


@pytest.mark.parametrize("border_x_m", [1.0, 4.0, 6.5, 8.0])
def test_it_stops_before_a_fence_that_is_moved_across_its_way(border_x_m: float, tmp_path: Path) -> None:
    world = world_with(tmp_path)
    assert world.run(60, lambda: world.views() == [100])
    assert world.run(30, lambda: world.states[1][-1].position_enu_m[0] > -8.0)
    lower, upper = geofence(world.mission, SITE)
    fence = Geofence(lower, np.array([border_x_m, *upper[1:]]))
    moved_s = move_fence(world, fence)
    fly(world)
    assert room(world, fence, moved_s) >= -FENCE_TOLERANCE_M
    assert on_its_pad(world)
    assert 101 not in world.views()


@pytest.mark.parametrize("zone", [Circle(np.array([-4.0, -12.0]), 1.5), np.array([[-6.0, -13.5], [-2.0, -13.0],
                                                                                [-2.0, -11.5], [-6.0, -10.5]])])
def test_a_zone_to_stay_out_of_is_gone_around_on_the_way_home(zone: Circle | Array, tmp_path: Path) -> None:
    world = world_with(tmp_path)
    assert world.run(60, lambda: world.views() == [100])
    fence = Geofence(*geofence(world.mission, SITE), stay_out=(zone,))
    told_s = move_fence(world, fence)
    world.run(0.5)
    world.vehicles[1].executor.go_home(world.t_ns)
    fly(world)
    straight = np.linspace((-9.0, -10.0, 5.0), (0.0, -14.0, 3.0), 100)
    assert fence.room_m(straight).min() < -0.5
    assert room(world, fence, told_s) >= -FENCE_TOLERANCE_M
    assert on_its_pad(world)


def test_outside_of_a_fence_that_was_moved_over_it_comes_home(tmp_path: Path) -> None:
    world = world_with(tmp_path)
    assert world.run(60, lambda: len(world.views()) == 2)
    lower, upper = geofence(world.mission, SITE)
    move_fence(world, Geofence(lower, np.array([5.0, *upper[1:]])))
    world.run(0.5)
    assert world.states[1][-1].mode == "return"
    fly(world)
    assert "outside the geofence: returning" in texts(world)
    assert on_its_pad(world)


def test_a_plan_that_leaves_a_new_fence_is_held_until_another_one_comes(tmp_path: Path) -> None:
    world = world_with(tmp_path)
    assert world.run(60, lambda: world.views() == [100])
    lower, upper = geofence(world.mission, SITE)
    move_fence(world, Geofence(lower, np.array([5.0, *upper[1:]])))
    world.run(5)
    assert world.states[1][-1].mode == "hold"
    assert Trigger.PLAN_INVALID in world.vehicles[1].failsafe.active
    world.upload(route([(0.0, -9.0, 6.0)], plan_id=2, first_view=200, home_after=True), 1)
    fly(world)
    assert world.views() == [100, 200]


def stranger(world: World, position: Array, velocity: Array) -> None:
    """Vehicle 2 says where it is; it has announced nothing."""
    state = VehicleState(vehicle_id=2, t_ns=world.t_ns, position_enu_m=tuple(position.tolist()),
                         velocity_enu_m_s=tuple(velocity.tolist()), acceleration_enu_m_s2=(0.0, 0.0, 0.0),
                         yaw_enu_rad=0.0, gimbal_elevation_rad=0.0, battery_percent=50.0, flying=True, mode="mission")
    world.send(1, topics.VEHICLE_STATE, state, vehicle_name(2))


def test_it_stops_for_a_vehicle_that_comes_too_close_and_goes_on_when_that_one_is_gone(tmp_path: Path) -> None:
    world = world_with(tmp_path)
    assert world.run(60, lambda: world.views() == [100])
    world.run(2)
    beside, away = np.array([0.0, 1.7, 0.0]), np.array([0.0, 3.0, 0.0])
    for _ in range(60):
        stranger(world, world.path(1)[-1] + beside, np.zeros(3))
        world.tick()
    assert world.states[1][-1].mode == "hold"
    assert stood_still(world, world.t_ns / NS - 1.5, world.t_ns / NS)
    assert "vehicle too close: holding" in texts(world)
    near = world.path(1)[-1] + beside
    for n in range(60):
        stranger(world, near + 0.1 * n * away, away)
        world.tick()
    fly(world)
    assert world.views() == [100, 101, 102, 103]


def test_it_stops_in_its_climb_for_a_vehicle_above_its_pad(tmp_path: Path) -> None:
    world = world_with(tmp_path)
    assert world.run(5, lambda: world.path(1)[-1][2] > 0.3)
    above, away = world.vehicles[1].executor.hover.copy(), np.array([0.0, 3.0, 0.0])
    for _ in range(60):
        stranger(world, above, np.zeros(3))
        world.tick()
    assert world.states[1][-1].mode == "hold"
    assert stood_still(world, world.t_ns / NS - 1.5, world.t_ns / NS)
    assert world.path(1)[-1][2] < above[2] - 0.5
    for n in range(60):
        stranger(world, above + 0.1 * n * away, away)
        world.tick()
    fly(world)
    assert world.views() == [100, 101, 102, 103]
    assert on_its_pad(world)


class Nowhere(KinematicSimulator):
    """A body that measures no numbers from 12 s on."""

    def measured(self, t_ns: int) -> Kinematics:
        """As the body says."""
        now = super().measured(t_ns)
        nan = State(np.full(3, np.nan), np.zeros(3), np.zeros(3))
        return now if t_ns < 12 * NS else Kinematics(nan, now.yaw_enu_rad, now.gimbal_elevation_rad)


def test_a_position_that_is_no_number_is_none(tmp_path: Path) -> None:
    world = world_with(tmp_path)
    pad = np.array(takeoff_points(world.mission, SITE)[0])
    vehicle = world.vehicles[1] = Vehicle(world.mission, SITE, 1, tmp_path / "1", body=Nowhere(pad, 0.0))
    world.run(11.9)
    for n in range(130):
        vehicle.lookout.take_scan(RangeScan(vehicle_id=1, t_ns=12 * NS + n * NS // 10, position_enu_m=(0.0, 0.0, 1.0),
                                            ranges_m=[3.0] * 64))
        condition = vehicle.lookout.look(12 * NS + n * NS // 10, vehicle.failsafe.settings, HEALTHY, True)
        vehicle.failsafe.step(condition, vehicle.executor)
    assert vehicle.executor.mode == "emergency"
    assert vehicle.failsafe.decision.trigger is Trigger.POSITION_INVALID


faults = st.lists(st.tuples(
    st.sampled_from(["position_lost", "range_blind", "battery_sag", "battery_silent", "clock_jump",
                     "ground_link_lost"]), st.floats(5.0, 50.0), st.floats(0.5, 40.0)), min_size=1, max_size=4)
MILDER = {"takeoff": 0, "mission": 0, "hold": 0, "wait": 0, "return": 1, "land": 2, "emergency": 3, "standby": 4}


@settings(max_examples=8, phases=[Phase.explicit, Phase.generate],
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(faults)
def test_whatever_goes_wrong_it_comes_down_inside_the_fence_and_never_takes_a_decision_back(
        tmp_path_factory: pytest.TempPathFactory, wrong: list[tuple[str, float, float]]) -> None:
    amounts = {"battery_sag": 60.0, "clock_jump": 5.0}
    world = world_with(tmp_path_factory.mktemp("flight"),
                       *((k, a, a + d, amounts.get(k, 0.0)) for k, a, d in wrong))
    fly(world, 400.0)
    flown = [MILDER[s.mode] for s in world.states[1] if s.flying and s.mode != "wait"]
    assert flown == sorted(flown)
    fence = Geofence(*geofence(world.mission, SITE))
    assert fence.room_m(world.path(1)).min() >= 0.0


def test_faults_are_those_of_the_vehicle_that_the_mission_names(tmp_path: Path) -> None:
    spec = FaultSpec(vehicle=1, kind="position_lost", at_s=1.0)
    assert spec.until_s > 1e6
    world = world_with(tmp_path, ("position_lost", 1.0, EVER, 0.0))
    tree = {"title": "test", "fleet": {"vehicles": 2},
            "faults": [{"vehicle": 2, "kind": "position_lost", "at_s": 0.0}]}
    other = World(msgspec.convert(tree, Mission), tmp_path)
    other.run(2)
    assert not other.vehicles[1].faults.on("position_lost")
    assert other.vehicles[2].faults.on("position_lost")
    assert world.vehicles[1].executor.grounded_by == ""
