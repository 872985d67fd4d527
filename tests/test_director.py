"""What the mission does with a vehicle around which the map has closed."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import msgspec
import numpy as np
import pytest

from ground_station.control import MAX_RESCUES, Control
from ground_station.drone import Drone, Stage
from ground_station.explore import MAX_FALLBACKS
from ground_station.explore_phase import ExplorePhase
from ground_station.fleet import Fleet
from ground_station.recorder import Recorder
from missions.messages import SiteBrief, VehicleState
from missions.mission import BatterySpec, Mission
from missions.pads import geofence
from missions.run_folder import RunFolder

SITE = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)
MISSION = Mission(title="t")


def hovering_at(drone: Drone, x: float, y: float, z: float, battery_percent: float = 100.0) -> None:
    drone.stage = Stage.READY
    drone.link.on_state(VehicleState(
        vehicle_id=drone.vehicle_id, t_ns=0, position_enu_m=(x, y, z), velocity_enu_m_s=(0.0, 0.0, 0.0),
        acceleration_enu_m_s2=(0.0, 0.0, 0.0), yaw_enu_rad=0.0, gimbal_elevation_rad=0.0,
        battery_percent=battery_percent, flying=True, mode="mission"))


def two_with_views(tmp_path: Path, mission: Mission = MISSION) -> tuple[ExplorePhase, Drone, Drone]:
    """An exploration that has given both of its vehicles, over their pads, views to fly."""
    recorder = Recorder(RunFolder(tmp_path), mission, SITE)
    fleet = Fleet(mission, SITE, Mock(), Mock(), recorder)
    phase, first, second = ExplorePhase(Control(mission, SITE, fleet, Mock(), recorder)), *fleet.drones.values()
    for drone in (first, second):
        hovering_at(drone, *(float(c) for c in drone.hover_enu_m))
    phase._give_views()
    return phase, first, second


def test_a_shut_in_vehicle_looks_around_then_starts_anew_from_its_pad_then_waits(tmp_path: Path) -> None:
    recorder = Recorder(RunFolder(tmp_path), MISSION, SITE)
    fleet = Fleet(MISSION, SITE, Mock(), Mock(), recorder)
    phase, drone = ExplorePhase(Control(MISSION, SITE, fleet, Mock(), recorder)), fleet.drones[1]
    for _ in range(MAX_RESCUES):
        for _ in range(MAX_FALLBACKS):
            hovering_at(drone, 12.0, 9.0, 4.0)
            phase._decide([drone])
            assert drone.stage is Stage.FLYING
        hovering_at(drone, 12.0, 9.0, 4.0)
        phase._decide([drone])
        assert drone.stage is Stage.HOMING
        assert recorder.notes[-1].endswith("vehicle 1 is shut in by the map and is called home")
    for _ in range(MAX_FALLBACKS + 1):
        hovering_at(drone, *(float(c) for c in drone.hover_enu_m + np.array([0.0, 0.0, 0.5])))
        phase._decide([drone])
    assert drone.stage is Stage.READY


def test_who_has_used_its_share_of_the_energy_waits_on_its_pad(tmp_path: Path) -> None:
    phase, first, second = two_with_views(tmp_path)
    assert {d.stage for d in (first, second)} == {Stage.FLYING}
    hovering_at(second, 12.0, 9.0, 4.0, battery_percent=60.0)
    phase._give_views()
    assert (first.stage, second.stage) == (Stage.FLYING, Stage.HOMING)
    second.stage = Stage.PARKED
    phase.step()
    assert second.stage is Stage.PARKED
    assert not phase.over


def on_its_pad(drone: Drone) -> None:
    drone.stage = Stage.PARKED
    drone.link.on_state(msgspec.structs.replace(drone.state, flying=False, mode="standby"))


@pytest.mark.parametrize("by_itself", [False, True])
def test_who_has_used_its_battery_gets_a_fresh_one_and_explores_on(tmp_path: Path, by_itself: bool) -> None:
    mission = Mission(title="t", battery=BatterySpec(swaps=1))
    phase, first, second = two_with_views(tmp_path, mission)
    hovering_at(second, 12.0, 9.0, 4.0, battery_percent=60.0)
    phase._give_views()
    assert second.stage is not Stage.HOMING, "it keeps nothing of this battery for the survey"
    hovering_at(second, 12.0, 9.0, 4.0, battery_percent=mission.battery.threshold_percent)
    if by_itself:
        second.stage, second.spent = Stage.HOMING, True
    else:
        phase._give_views()
    assert second.stage is Stage.HOMING
    on_its_pad(second)
    first.stage = Stage.LOST
    assert not phase.over
    phase.step()
    assert (second.stage, second.swaps_left, second.available) == (Stage.SWAPPING, 0, True)
    assert not phase.over
    on_its_pad(second)
    phase.step()
    assert second.stage is Stage.LAUNCHING
    hovering_at(second, 12.0, 9.0, 4.0, battery_percent=60.0)
    phase._give_views()
    assert second.stage is Stage.HOMING, "with the last battery it keeps its share for the survey"
    on_its_pad(second)
    assert phase.over


def test_who_is_alone_and_has_energy_for_no_view_explores_on_with_a_fresh_battery(tmp_path: Path) -> None:
    mission = Mission(title="t", battery=BatterySpec(swaps=1))
    phase, first, second = two_with_views(tmp_path, mission)
    lower, upper = geofence(mission, SITE)
    phase.explorer.map.mark_free(lower, np.array([upper[0], SITE.object_min_enu_m[1] - 1.0, upper[2]]))
    phase.explorer.pictures_new = 1
    first.stage = Stage.LOST
    hovering_at(second, *(float(c) for c in second.hover_enu_m),
                battery_percent=mission.battery.threshold_percent + 0.01)
    phase._give_views()
    assert (second.stage, phase.over) == (Stage.HOMING, False)
    on_its_pad(second)
    phase.step()
    assert (second.stage, phase.over) == (Stage.SWAPPING, False)


def test_no_battery_is_spent_on_exploring_while_another_hovers_that_finds_nothing(tmp_path: Path) -> None:
    phase, first, second = two_with_views(tmp_path, Mission(title="t", battery=BatterySpec(swaps=1)))
    second.stage, second.spent = Stage.HOMING, True
    on_its_pad(second)
    hovering_at(first, *(float(c) for c in first.hover_enu_m))
    phase._asked.add(1)
    phase.step()
    assert (second.stage, second.swaps_left) == (Stage.PARKED, 1)
    assert phase.over


def test_who_has_energy_for_no_view_waits_on_its_pad_too(tmp_path: Path) -> None:
    phase, first, second = two_with_views(tmp_path)
    lower, upper = geofence(MISSION, SITE)
    phase.explorer.map.mark_free(lower, np.array([upper[0], SITE.object_min_enu_m[1] - 1.0, upper[2]]))
    phase.explorer.pictures_new = 1
    hovering_at(second, *(float(c) for c in second.hover_enu_m), battery_percent=60.01)
    phase._give_views()
    assert (first.stage, second.stage) == (Stage.FLYING, Stage.HOMING)


def test_nobody_stops_exploring_while_another_comes_home_to_start_anew(tmp_path: Path) -> None:
    phase, first, second = two_with_views(tmp_path)
    first.stage = Stage.HOMING
    hovering_at(second, *(float(c) for c in second.hover_enu_m))
    phase._asked.add(2)
    phase._give_views()
    assert second.stage is Stage.READY
    phase.think_again()
    phase._give_views()
    assert second.stage is Stage.FLYING
