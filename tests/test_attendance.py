"""Vehicles that vanish from the clock keep their views for a while, and say what they do when they are back."""

from __future__ import annotations

from pathlib import Path

import pytest

from ground_station.drone import Stage
from ground_station.fleet import Fleet
from ground_station.fleet_link import NO_ANSWER
from ground_station.ingest import Ingest
from ground_station.recorder import Recorder
from ground_station.voice import Voice
from missions import topics
from missions.bus import Delivery
from missions.clock import SECOND_NS, Turn
from missions.messages import VehicleState
from missions.mission import FleetSpec, Mission
from missions.run_folder import RunFolder
from tests.test_director import SITE
from tests.test_ground_ingest import HOMES

GRACE_S = 10.0


class Flown:
    """Two vehicles, and a clock that is turned by hand."""

    def __init__(self, folder: Path) -> None:
        mission, run = Mission(title="t", fleet=FleetSpec(vehicles=2, lost_after_s=GRACE_S)), RunFolder(folder)
        self.recorder = Recorder(run, mission, SITE)
        ingest = Ingest(run, mission.site.anchor, mission.clock.epoch_utc, HOMES)
        self.fleet = Fleet(mission, SITE, Voice(None), ingest, self.recorder)
        self.drone = self.fleet.drones[1]

    def turn(self, t_s: float, mode: str = "", flying: bool = True) -> None:
        """mode: what vehicle 1 says that it does; "" when it is not there."""
        t_ns, names = round(t_s * SECOND_NS), {"ground", "uav2"} | ({"uav1"} if mode else set())
        state = VehicleState(vehicle_id=1, t_ns=t_ns, position_enu_m=(3.0, 4.0, 5.0), velocity_enu_m_s=(0.0, 0.0, 0.0),
                             acceleration_enu_m_s2=(0.0, 0.0, 0.0), yaw_enu_rad=0.0, gimbal_elevation_rad=0.0,
                             battery_percent=50.0, flying=flying, mode=mode)
        said = [Delivery(topics.VEHICLE_STATE, "1", "uav1", t_ns, state)] if mode else []
        self.fleet.receive(Turn(0, t_ns, said, frozenset(names), stop=False))


def test_its_views_wait_and_then_go_to_the_others(tmp_path: Path) -> None:
    flown = Flown(tmp_path)
    flown.turn(1.0, "mission")
    flown.drone.stage, flown.drone.awaited = Stage.FLYING, [7]
    flown.turn(2.0)
    assert (flown.drone.stage, flown.drone.available, flown.drone.awaited) == (Stage.MISSING, True, [])
    flown.turn(2.0 + GRACE_S - 0.1)
    assert flown.drone.stage is Stage.MISSING
    flown.turn(2.0 + GRACE_S)
    assert (flown.drone.stage, flown.drone.available) == (Stage.LOST, False)
    flown.turn(500.0)
    assert [n.split(": ")[1] for n in flown.recorder.notes] == [
        "vehicle 1 has vanished; its views wait 10 s for it", "vehicle 1 is lost"]


@pytest.mark.parametrize("absent_s", [1.0, 100.0])
@pytest.mark.parametrize(("mode", "flying", "stage"), [
    ("hold", True, Stage.READY), ("wait", True, Stage.READY), ("takeoff", True, Stage.LAUNCHING),
    ("return", True, Stage.HOMING), ("land", True, Stage.HOMING), ("standby", False, Stage.PARKED),
    ("swap", False, Stage.SWAPPING)])
def test_it_is_back_doing_what_it_says(mode: str, flying: bool, stage: Stage, absent_s: float, tmp_path: Path) -> None:
    flown = Flown(tmp_path)
    flown.turn(1.0, "mission")
    flown.drone.stage = Stage.FLYING
    ordered = flown.fleet.pause(flown.drone)
    flown.turn(2.0)
    flown.turn(2.0 + absent_s)
    assert flown.fleet.attendance.returned == []
    flown.turn(3.0 + absent_s, mode, flying)
    assert flown.drone.stage is stage
    assert flown.fleet.attendance.returned == [flown.drone]
    assert ordered is not None
    assert ordered.result == NO_ANSWER
    assert flown.drone.held, "what an operator wants does not end with the vehicle's process"
    assert not flown.drone.link.busy
    flown.turn(4.0 + absent_s, mode, flying)
    assert flown.fleet.attendance.returned == []
