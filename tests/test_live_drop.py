"""A program takes a vehicle out of a real flight, adds it again, and adds one that was in reserve."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

from ground_station import connect_async
from ground_station.live.client import AsyncLiveMission
from missions.live import Add, Drop, MoveFence, SetGoal, Start
from tests.live_world import FLEET, flying, vehicle

pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("live")]


def test_a_dropped_vehicle_leaves_its_views_to_the_others_and_the_reserve_takes_over(tmp_path: Path) -> None:
    flight, endpoint = flying(tmp_path, "explore.max_views=3", "survey.max_views=10", "fleet.vehicles=3",
                              "fleet.reserve=1", "site.geofence_room_m=5.0", "clock.speed=2.0")
    try:
        asyncio.run(_drop_and_add(endpoint))
        assert flight.wait() == []
    finally:
        flight.stop()
    told = json.loads((tmp_path / "run" / "flight.json").read_text())
    assert set(told["outcomes"].values()) == {"flown"}
    assert told["tours"]["3"]


async def _drop_and_add(endpoint: str) -> None:
    async with connect_async(endpoint=endpoint, fleet=FLEET) as mission:
        await mission.do(Start())
        async for state in mission.states():
            if vehicle(state, 2).flying:
                break
        wider = await mission.do(_fence_moved_out(mission))
        assert wider.accepted
        assert [(v.vehicle_id, v.text) for v in wider.vehicles] == [(k, "accepted") for k in (1, 2, 3)]
        assert (await mission.do(Drop(vehicle_id=2))).accepted
        assert not (await mission.do(Add(vehicle_id=4))).accepted
        assert (vehicle(state, 3).reserve, vehicle(state, 3).stage) == (True, "parked")
        async for state in mission.states():
            if not vehicle(state, 2).flying:
                break
        assert vehicle(state, 2).dropped
        assert (await mission.do(Add(vehicle_id=2))).accepted
        assert (await mission.do(SetGoal(coverage=2.0))).text.startswith("the goal is a share")
        assert (await mission.do(Add(vehicle_id=3))).accepted
        flown = set()
        async for state in mission.states():
            flown |= {v.vehicle_id for v in state.vehicles if v.flying}
        assert flown == {1, 2, 3}


def _fence_moved_out(mission: AsyncLiveMission) -> MoveFence:
    with mission.mission.reading() as model:
        assert model.site is not None
        return MoveFence(lower_enu_m=model.site.limit_lower_enu_m, upper_enu_m=model.site.limit_upper_enu_m)
