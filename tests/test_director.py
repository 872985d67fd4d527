"""What the mission does with a vehicle around which the map has closed."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import numpy as np

from ground_station.control import MAX_RESCUES, Control
from ground_station.explore import MAX_FALLBACKS
from ground_station.explore_phase import ExplorePhase
from ground_station.fleet import Drone, Fleet, Stage
from ground_station.recorder import Recorder
from missions.messages import SiteBrief, VehicleState
from missions.mission import Mission
from missions.run_folder import RunFolder

SITE = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)
MISSION = Mission(title="t")


def hovering_at(drone: Drone, x: float, y: float, z: float, battery_percent: float = 100.0) -> None:
    drone.stage = Stage.READY
    drone.link.on_state(VehicleState(
        vehicle_id=drone.vehicle_id, t_ns=0, position_enu_m=(x, y, z), velocity_enu_m_s=(0.0, 0.0, 0.0),
        acceleration_enu_m_s2=(0.0, 0.0, 0.0), yaw_enu_rad=0.0, gimbal_elevation_rad=0.0,
        battery_percent=battery_percent, flying=True, mode="mission"))


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
    recorder = Recorder(RunFolder(tmp_path), MISSION, SITE)
    fleet = Fleet(MISSION, SITE, Mock(), Mock(), recorder)
    phase, first, second = ExplorePhase(Control(MISSION, SITE, fleet, Mock(), recorder)), *fleet.drones.values()
    for drone in (first, second):
        hovering_at(drone, *(float(c) for c in drone.hover_enu_m))
    phase._give_views()
    assert {d.stage for d in fleet.drones.values()} == {Stage.FLYING}
    hovering_at(second, 12.0, 9.0, 4.0, battery_percent=60.0)
    phase._give_views()
    assert (first.stage, second.stage) == (Stage.FLYING, Stage.HOMING)
    second.stage = Stage.PARKED
    phase.step()
    assert second.stage is Stage.PARKED
    assert not phase.over
