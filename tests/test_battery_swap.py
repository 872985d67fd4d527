"""A battery is changed on the pad, when asked for, and nowhere else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from missions import topics
from missions.messages import BatterySwap
from missions.mission import BatterySpec, FleetSpec, Mission
from tests.vehicle_world import World, open_map

MISSION = Mission(title="t", fleet=FleetSpec(vehicles=1),
                  battery=BatterySpec(start_percent=[15.0], swaps=1, swap_s=20.0))


@pytest.fixture
def world(tmp_path: Path) -> World:
    made = World(MISSION, tmp_path)
    made.share_map(open_map(MISSION))
    made.run(1.0)
    return made


def take_off(world: World) -> None:
    world.command(1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    height = float(world.vehicles[1].executor.hover[2]) + MISSION.site.origin_alt_m
    world.command(1, mav.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, float("nan"), float("nan"), float("nan"), height)


def test_after_a_swap_the_vehicle_is_full_and_flies_which_it_did_not_before_or_meanwhile(world: World) -> None:
    vehicle = world.vehicles[1]
    take_off(world)
    world.run(2.0)
    assert not vehicle.executor.flying
    asked_ns = world.t_ns
    world.send(1, topics.BATTERY_SWAP, BatterySwap(vehicle_id=1))
    world.run(10.0)
    take_off(world)
    told = world.states[1]
    assert world.run(30.0, lambda: told[-1].battery_percent == 100.0)
    assert 20.0 <= (world.t_ns - asked_ns) / 1e9 <= 22.0
    assert {s.mode for s in told if s.battery_percent == 15.0} == {"standby", "swap"}
    assert told[-1].mode == "standby"
    take_off(world)
    world.run(4.0)
    assert vehicle.executor.flying


def test_in_the_air_nothing_is_swapped(tmp_path: Path) -> None:
    world = World(Mission(title="t", fleet=FleetSpec(vehicles=1)), tmp_path)
    world.share_map(open_map(world.mission))
    world.run(1.0)
    take_off(world)
    world.run(2.0)
    world.send(1, topics.BATTERY_SWAP, BatterySwap(vehicle_id=1))
    world.run(200.0)
    levels = np.array([s.battery_percent for s in world.states[1]])
    assert world.vehicles[1].executor.flying
    assert (np.diff(levels) <= 0.0).all()
