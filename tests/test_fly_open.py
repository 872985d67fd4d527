"""Clients of other makes beside a mission that our own ground station flies: they watch, pause it and let it go on."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path

import pytest
from mavsdk import ComponentType, Configuration
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.exceptions import MavsdkError

from tests.simulated_doors import free_udp_port
from tests.test_loopback import flight_of, fly

pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("doors")]

CLIENT_S = 300.0
ATTEMPTS = 60


async def insist(call: Callable[[], Awaitable[None]]) -> None:
    """As people do: MAVSDK gives an answer half a second, and a decision on a busy machine takes longer."""
    for _ in range(ATTEMPTS):
        with suppress(MavsdkError):
            return await call()
    return await call()


async def watch_and_pause(port: int) -> list[str]:
    """What MAVSDK could do with vehicle 1, in order."""
    done = []
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as client:
        await client.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await client.first_autopilot(timeout_s=CLIENT_S)
        assert system is not None
        telemetry, mission = TelemetryAsync(system), MissionAsync(system)
        async for mode in telemetry.subscribe_flight_mode():
            if mode.name == "MISSION":
                break
        done.append("seen in its mission")
        for forbidden in (mission.clear_mission, ActionAsync(system).takeoff):
            with pytest.raises(MavsdkError):
                await forbidden()
        done.append("refused to lead")
        await insist(ActionAsync(system).hold)
        async for mode in telemetry.subscribe_flight_mode():
            if mode.name == "HOLD":
                break
        async for velocity in telemetry.subscribe_velocity_ned():
            if abs(velocity.north_m_s) + abs(velocity.east_m_s) + abs(velocity.down_m_s) < 1e-6:
                break
        done.append("paused")
        await insist(mission.start_mission)
        async for mode in telemetry.subscribe_flight_mode():
            if mode.name == "MISSION":
                break
        done.append("goes on")
    return done


def test_mavsdk_pauses_a_mission_and_the_mission_is_flown_to_its_end_all_the_same(tmp_path: Path) -> None:
    port, done = free_udp_port(), list[str]()
    client = threading.Thread(target=lambda: done.extend(asyncio.run(watch_and_pause(port))))
    client.start()
    door = f'mavlink.open=["udp://127.0.0.1:{port}"]'
    run, complaints = fly(tmp_path, ["explore.max_views=4", "survey.max_views=6", "clock.speed=2.0",
                                     "clock.tick_s=0.05", door])
    client.join()
    assert done == ["seen in its mission", "refused to lead", "paused", "goes on"]
    assert complaints == []
    referee = json.loads(run.referee.read_text())
    assert referee["collisions"] == 0
    record = flight_of(run)
    assert record["fleet"]["views_flown"] == len(record["outcomes"]) == 6
