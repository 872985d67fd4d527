"""A real autopilot does what our companion expects of it. Each test leaves it on the ground, disarmed."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from missions.mission import FleetSpec
from tests.external.sitl import Sitl
from tests.mixed_fleet import fly_mixed
from vehicle.external.goals import Goal
from vehicle.external.link import Setpoint
from vehicle.external.parameters import Setup, wishes_for

CLIMB_M, SPEED_M_S = 4.0, 2.0


def take_off(sitl: Sitl) -> None:
    """To a hover under set-points."""
    ground = sitl.said.position_ned_m
    assert ground is not None
    sitl.link.pursue(Goal.CLIMB, CLIMB_M)
    assert sitl.wait(lambda: height(sitl, float(ground[2])) > CLIMB_M - 0.9, 200.0), sitl.link.let_go
    point = np.array([ground[0], ground[1], ground[2] - CLIMB_M])
    lead(sitl, lambda t_s: (point, np.zeros(3)))
    assert sitl.wait(lambda: sitl.link.held, 20.0), sitl.link.let_go


def lead(sitl: Sitl, path: object) -> None:
    """Have it follow (position, velocity) of the time."""
    def aim(t_s: float) -> Setpoint:
        position, velocity = path(t_s)  # type: ignore[operator]
        return Setpoint(position, velocity, np.zeros(3), 0.0)
    sitl.link.aim = aim
    sitl.link.pursue(Goal.FOLLOW)


def height(sitl: Sitl, ground_down_m: float) -> float:
    return ground_down_m - float(position(sitl)[2])


def position(sitl: Sitl) -> np.ndarray:
    assert sitl.said.position_ned_m is not None
    return sitl.said.position_ned_m


def test_its_failsafe_is_set_up(sitl: Sitl) -> None:
    assert sitl.said.dialect is not None
    setup = Setup(sitl.link.system, sitl.said.dialect, wishes_for(sitl.said.dialect, FleetSpec()))
    sitl.link.setup = setup
    sitl.wait(lambda: setup.over(sitl.link.parameters), 20.0)
    assert setup.unmet(sitl.link.parameters, vital=True) == []
    assert setup.unmet(sitl.link.parameters, vital=False) == []


def test_it_takes_off_follows_a_moving_set_point_and_lands(sitl: Sitl) -> None:
    take_off(sitl)
    begin_s, start = time.monotonic(), position(sitl).copy()

    def eastwards(t_s: float) -> tuple[np.ndarray, np.ndarray]:
        along = min(SPEED_M_S * max(0.0, t_s - begin_s), 20.0)
        moving = np.array([0.0, SPEED_M_S if 0.0 < along < 20.0 else 0.0, 0.0])
        return start + np.array([0.0, along, 0.0]), moving
    lead(sitl, eastwards)
    assert sitl.wait(lambda: float(position(sitl)[1] - start[1]) > 19.5, 30.0), sitl.link.let_go
    sitl.wait(lambda: False, 3.0)
    assert np.linalg.norm(position(sitl) - start - np.array([0.0, 20.0, 0.0])) < 0.5
    sitl.link.pursue(Goal.LAND)
    assert sitl.wait(lambda: sitl.said.armed is False, 60.0), sitl.link.let_go
    sitl.link.regain()


def test_it_stops_by_itself_when_the_set_points_stop(sitl: Sitl) -> None:
    take_off(sitl)
    begin_s, start = time.monotonic(), position(sitl).copy()
    lead(sitl, lambda t_s: (start + np.array([SPEED_M_S * (t_s - begin_s), 0.0, 0.0]), np.array([SPEED_M_S, 0.0, 0.0])))
    sitl.wait(lambda: False, 4.0)
    assert np.linalg.norm(sitl.said.velocity_ned_m_s) > 0.5 * SPEED_M_S
    sitl.wait(lambda: False, 7.0, mute=True)
    assert np.linalg.norm(sitl.said.velocity_ned_m_s) < 0.3
    assert sitl.said.armed


def test_it_flies_a_mission_beside_a_simulated_vehicle(sitl: Sitl, tmp_path: Path) -> None:
    if sitl.link.system > 2:
        pytest.skip(f"the mission has vehicles 1 and 2; start the autopilot with one of these system ids, not "
                    f"{sitl.link.system}")
    k, at = sitl.link.system, sitl.said.geodetic
    assert at is not None
    sitl.close()
    run, complaints, verdict = fly_mixed(tmp_path, f"mavlink:{sitl.url}", external=k, at=at)
    assert complaints == []
    assert verdict["collisions"] == 0
    record = json.loads(run.flight.read_text(encoding="utf-8"))
    assert set(record["outcomes"].values()) == {"flown"}
    assert len(list((run.root / "pictures").glob(f"UAV_{k}_*.jpg"))) == len(record["tours"][str(k)]) >= 1
