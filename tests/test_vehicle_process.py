"""A real vehicle process on loopback: joins, reports, leaves quickly when told, and outlives nobody's bridge."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from missions import topics
from missions.bus import Bus
from missions.messages import Tick, VehicleState
from missions.mission import without_scene
from missions.mission_file import find_mission, load_mission, write_mission
from missions.run_folder import RunFolder
from sim_bridge.clock_server import ClockServer
from tests.loopback import free_endpoint
from tests.vehicle_world import SITE

BRIDGE_MISSION = load_mission(find_mission("bridge"))
MISSION = msgspec.structs.replace(
    BRIDGE_MISSION, clock=msgspec.structs.replace(BRIDGE_MISSION.clock, world_wait_s=0.5))
pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("loopback")]


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def vehicle(endpoint: str, tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    write_mission(MISSION, tmp_path / "mission.toml")
    command = [sys.executable, "-m", "vehicle", str(tmp_path / "mission.toml"), "--id", "1",
               "--run", str(tmp_path), "--connect", endpoint,
               "--fleet", "test"]
    process = subprocess.Popen(command)
    yield process
    process.kill()
    process.wait(60)


def serve(bus: Bus) -> ClockServer:
    """Admit the vehicle."""
    server = ClockServer(bus, MISSION.clock, without_scene(MISSION).mission_hash, SITE)
    bus.subscribe(topics.VEHICLE_STATE)
    server.admit({"uav1"}, 240.0)
    return server


def test_joins_tells_its_state_and_leaves_when_told(endpoint: str, vehicle: subprocess.Popen[bytes],
                                                    tmp_path: Path) -> None:
    with Bus("bridge", "test", listen=endpoint) as bus:
        server = serve(bus)
        told = [d.message for _ in range(12) for d in server.run_tick().deliveries]
        states = [m for m in told if isinstance(m, VehicleState)]
        assert [s.t_ns for s in states] == [0, 1_000_000_000]
        assert not states[0].flying
        vehicle.send_signal(signal.SIGTERM)
        assert vehicle.wait(240) == 0
    assert [r["name"] for r in RunFolder(tmp_path).process_records()] == ["uav1"]


def test_stops_with_the_clock(endpoint: str, vehicle: subprocess.Popen[bytes]) -> None:
    with Bus("bridge", "test", listen=endpoint) as bus:
        server = serve(bus)
        server.run_tick()
        bus.publish(topics.TICK, Tick(tick=1, t_ns=100_000_000, counts={}, participants=["uav1"], stop=True))
        assert vehicle.wait(240) == 0


def test_leaves_in_peace_when_the_bridge_vanishes(endpoint: str, vehicle: subprocess.Popen[bytes],
                                                  tmp_path: Path) -> None:
    with Bus("bridge", "test", listen=endpoint) as bus:
        serve(bus).run_tick()
    assert vehicle.wait(240) == 0
    record = RunFolder(tmp_path).process_records()[0]
    assert record["peak_memory_mib"] < 400


@pytest.mark.parametrize(("arguments", "said"), [
    (["nowhere"], "no such mission file"), (["bridge", "--id", "9"], "--id 9")])
def test_bad_input_ends_with_one_sentence_and_code_2(arguments: list[str], said: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "vehicle", *arguments, *([] if "--id" in arguments else ["--id", "1"]),
               "--run", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_no_heavy_library_is_imported() -> None:
    code = "import sys, vehicle.__main__; print([m for m in ('torch', 'open3d', 'cv2', 'trimesh') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout.strip() == "[]"
