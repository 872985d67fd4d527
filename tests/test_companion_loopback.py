"""Real processes in real time: a simulated vehicle and a stub autopilot on a UDP port fly one mission together."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from pathlib import Path

import numpy as np
import pytest

from ground_station.autopilots import autopilots_of
from ground_station.processes import Flight, process_table
from missions.errors import UserError
from missions.mission_file import load_mission
from missions.pads import hover_points, takeoff_points
from missions.run_folder import RunFolder
from planning.trajectories import Limits, State, Via, fly_run
from tests.autopilot_stub import AutopilotStub
from tests.autopilot_world import stub_on_pad
from tests.mixed_fleet import PADS, fly_mixed, free_port
from tests.serve_autopilot import served, served_on
from tests.vehicle_world import NS, SITE
from vehicle.dialects import ARDUPILOT, PX4
from vehicle.external.companion import Companion

pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("loopback")]
HERE = Path(__file__).parent
EXTERNAL = 2


def test_a_fleet_of_both_kinds_flies_one_mission(tmp_path: Path) -> None:
    port = free_port()
    stub = AutopilotStub("px4", EXTERNAL)
    with served(stub, port):
        run, complaints, verdict = fly_mixed(tmp_path, f"mavlink:udpin://127.0.0.1:{port}", EXTERNAL, stub.home)
    assert complaints == []
    assert verdict["collisions"] == 0
    record = json.loads(run.flight.read_text(encoding="utf-8"))
    assert set(record["outcomes"].values()) == {"flown"}
    assert all(len(record["tours"][k]) >= 2 for k in ("1", "2"))
    assert len(list((run.root / "pictures").glob(f"UAV_{EXTERNAL}_*.jpg"))) == len(record["tours"]["2"])
    assert stub.armings == 1
    assert not stub.armed
    assert stub.history == ["HOLD", "TAKEOFF", "HOLD", "OFFBOARD", "LAND"]
    with np.load(run.trajectories) as tracks:
        track = tracks[f"uav{EXTERNAL}_position_enu_m"]
        assert np.linalg.norm(track[-1] - PADS[EXTERNAL - 1]) < 0.5


def test_without_ground_station_and_bridge_the_aircraft_comes_home_by_its_vehicles_own_ways(tmp_path: Path) -> None:
    port, stub, pause = free_port(), AutopilotStub("px4", EXTERNAL), threading.Event()

    def kill_ground(flight: Flight) -> None:
        while np.linalg.norm(stub.air.position) < 7.0:
            pause.wait(0.1)
        flight.running["ground"].kill()
        flight.running["bridge"].send_signal(signal.SIGINT)
    with served(stub, port):
        run, complaints, _ = fly_mixed(tmp_path, f"mavlink:udpin://127.0.0.1:{port}", EXTERNAL, stub.home,
                                       watch=kill_ground)
    assert [c.split()[0] for c in complaints] == ["ground"]
    assert stub.history == ["HOLD", "TAKEOFF", "HOLD", "OFFBOARD", "LAND"], "not the autopilot's straight way"
    assert not stub.armed
    assert np.linalg.norm(stub.air.position) < 0.5
    assert "comes home alone" in (run.logs / f"uav{EXTERNAL}.log").read_text()


def test_an_autopilot_is_met_over_tcp() -> None:
    mission, accepted = load_mission(HERE / "missions" / "realtime.toml"), list[socket.socket]()
    with socket.create_server(("127.0.0.1", 0)) as server:
        begun = threading.Thread(target=lambda: accepted.append(server.accept()[0]))
        begun.start()
        companion = Companion(f"mavlink:tcp://127.0.0.1:{server.getsockname()[1]}", 1, mission)
        begun.join()
    stub = stub_on_pad(mission, "ardupilot", ready_s=0.0)
    with accepted[0] as connection, served_on(stub, connection.fileno()), companion:
        assert companion.link.said.dialect is ARDUPILOT


def test_an_autopilot_is_met_over_a_serial_line() -> None:
    mission = load_mission(HERE / "missions" / "realtime.toml")
    near, far = os.openpty()
    tty.setraw(far)
    address = f"mavlink:serial://{os.ttyname(far)}:57600"
    with served_on(stub_on_pad(mission, "px4", ready_s=0.0), near), Companion(address, 1, mission) as companion:
        assert companion.link.said.dialect is PX4
    os.close(near)
    os.close(far)


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_a_process_that_leaves_an_aircraft_in_the_air_sends_it_home(kind: str) -> None:
    mission = load_mission(HERE / "missions" / "realtime.toml")
    port, stub, tick = free_port(), stub_on_pad(mission, kind, ready_s=0.0), threading.Event()
    pad, hover = takeoff_points(mission, SITE)[0], hover_points(mission, SITE)[0]
    climb = fly_run(State.at_rest(np.array(pad)), 0.0, 0.0, [Via(np.array(hover), 0.0)], Limits.of_fleet(mission.fleet))
    with served(stub, port), Companion(f"mavlink:udpin://127.0.0.1:{port}", 1, mission) as companion:
        body, battery = companion.aircraft(SITE)
        battery.step(0)
        assert battery.level_percent == 100.0
        begin_s, t_ns = time.monotonic(), 0
        while body.end_ns > t_ns or body.flight is not climb:
            t_ns = round((time.monotonic() - begin_s) * NS)
            body.step(t_ns)
            if body.flight is not climb:
                body.fly(climb, t_ns)
            assert not body.surrendered, companion.link.let_go
            tick.wait(0.05)
        assert np.linalg.norm(body.measured(t_ns).state.position - hover) < 0.35
    assert stub.mode == "RTL"


def test_the_ground_station_is_started_the_same_whoever_flies(tmp_path: Path) -> None:
    mission = load_mission(HERE / "missions" / "house.toml")
    tables = [process_table(mission, RunFolder(tmp_path), "tcp/127.0.0.1:1", "test", autopilots=autopilots)
              for autopilots in ({}, {2: "mavlink:udpin://127.0.0.1:14541"})]
    differ = [a.name for a, b in zip(*tables, strict=True) if a != b]
    assert differ == ["uav2"]


@pytest.mark.parametrize(("pair", "said"), [
    ("mavlink:udpin://127.0.0.1:1", "write K=URL"), ("3=mavlink:udpin://127.0.0.1:1", "vehicles 1 to 2"),
    ("1=mavlink:udpin://127.0.0.1:1 1=mavlink:udpin://127.0.0.1:2", "given twice"),
    ("1=mavlink:udpin://127.0.0.1:1 2=mavlink:udpin://127.0.0.1:1", "given twice")])
def test_an_autopilot_that_cannot_be_given_is_refused_with_a_remedy(pair: str, said: str) -> None:
    mission = load_mission(HERE / "missions" / "house.toml", {"clock.speed": "1.0"})
    with pytest.raises(UserError, match=said):
        autopilots_of(pair.split(), mission)
    with pytest.raises(UserError, match="real time"):
        autopilots_of(["1=mavlink:udpin://127.0.0.1:1"], load_mission(HERE / "missions" / "house.toml"))


@pytest.mark.parametrize(("url", "said"), [
    ("mavlink:udpin://127.0.0.1", "is no MAVLink address"), ("mavlink:tcp://127.0.0.1:1", "cannot be opened")])
def test_a_bad_address_ends_with_one_sentence_and_code_2(url: str, said: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "vehicle", str(HERE / "missions" / "realtime.toml"), "--id", "1"]
    done = subprocess.run([*command, "--run", str(tmp_path), "--autopilot", url], capture_output=True, text=True,
                          timeout=300, check=False)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
