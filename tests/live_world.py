"""A small real flight for tests that watch it and act on it."""

from __future__ import annotations

from pathlib import Path

import trimesh

from ground_station import launcher
from ground_station.mission_setup import prepare
from ground_station.processes import Flight, process_table
from missions.live import LiveState, LiveVehicle
from tests.loopback import free_endpoint

MISSION = Path(__file__).parent / "missions" / "house.toml"
FLEET = "test"


def free_port() -> int:
    """A TCP port on which nobody listens."""
    return int(free_endpoint().rsplit(":", 1)[1])


def flying(tmp_path: Path, *settings: str, live: tuple[str, ...] = ("--wait",)) -> tuple[Flight, str]:
    """The small mission over a box, eight times as fast as real, waiting for somebody to start it; and where its bus
    is."""
    scene = tmp_path / "house.ply"
    box = trimesh.creation.box(extents=(8.0, 6.0, 7.0))
    box.apply_translation((0.0, 0.0, 3.5))
    box.export(scene)
    sets = [part for s in ("clock.speed=8.0", "survey.max_views=6", *settings) for part in ("--set", s)]
    options = launcher._parse([str(MISSION), "--scene", str(scene), "--run", str(tmp_path / "run"), *sets])
    mission, run = prepare(options)
    endpoint = free_endpoint()
    return Flight(process_table(mission, run, endpoint, FLEET, quiet=True, live=live), run, keep={}), endpoint


def vehicle(state: LiveState, vehicle_id: int) -> LiveVehicle:
    """One of the vehicles."""
    return next(v for v in state.vehicles if v.vehicle_id == vehicle_id)
