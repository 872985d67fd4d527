"""MAVProxy 1.8, a ground station that we did not write, on a simulated vehicle through its door."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.simulated_doors import MISSION, free_udp_port, house, simulated

pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("doors")]

MAVPROXY = Path(sys.executable).with_name("mavproxy.py")
MODULES = "link,log,wp,rally,fence,param,mode,arm,cmdlong,misc,battery"
"""Without those that load maps and terrain from the network."""
PATIENCE_S = 400.0
ASK_AGAIN_S = 5.0
HOME = "52.2203652\t6.8861000"
PLAN = "\n".join(["QGC WPL 110",
                  f"0\t1\t0\t16\t0\t0\t0\t0\t{HOME}\t40.2\t1",
                  f"1\t0\t3\t22\t0\t0\t0\t0\t{HOME}\t5\t1",
                  "2\t0\t3\t16\t60\t0\t0\t0\t52.2203650\t6.8861500\t6\t1",
                  "3\t0\t3\t16\t60\t0\t0\t0\t52.2203650\t6.8860500\t6\t1",
                  "4\t0\t0\t20\t0\t0\t0\t0\t0\t0\t0\t1", ""])
PX4_PLAN = "\n".join(["QGC WPL 110", *(f"{n}\t{row[2:]}" for n, row in enumerate(PLAN.splitlines()[2:])), ""])
"""Item 0 is flown."""
FENCE = "\n".join(["QGC WPL 110", *(f"{n}\t0\t0\t5001\t4\t0\t0\t0\t{lat}\t{lon}\t0\t1" for n, (lat, lon) in enumerate(
    ((52.22025, 6.8857), (52.22025, 6.8865), (52.2208, 6.8865), (52.2208, 6.8857)))), ""])
RALLY = f"QGC WPL 110\n0\t0\t3\t5100\t0\t0\t0\t0\t{HOME}\t8\t1\n"


class MavProxy:
    """A running MAVProxy: what it prints, and commands to it."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._printed = ""
        self._read = 0
        self._news = threading.Condition()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for character in iter(lambda: self._process.stdout.read(1) if self._process.stdout else "", ""):
            with self._news:
                self._printed += character
                self._news.notify_all()

    def expect(self, *patterns: str) -> None:
        """Wait until these are printed after what was expected before: an answer may come after its effect."""
        with self._news:
            assert self._news.wait_for(lambda: self._all_seen(patterns), PATIENCE_S), \
                f"not all of {patterns} in {self._printed[self._read:]!r}"

    def _all_seen(self, patterns: tuple[str, ...]) -> bool:
        seen = [re.compile(pattern).search(self._printed, self._read) for pattern in patterns]
        found = [match.end() for match in seen if match]
        if len(found) < len(patterns):
            return False
        self._read = max(found)
        return True

    def _type(self, command: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()

    def see(self, command: str, pattern: str) -> None:
        """Type a command that only shows something, until it shows this: MAVProxy may not have heard of it yet."""
        with self._news:
            for _ in range(round(PATIENCE_S / ASK_AGAIN_S)):
                self._type(command)
                if self._news.wait_for(lambda: re.search(pattern, self._printed[self._read:]), ASK_AGAIN_S):
                    return
        raise AssertionError(f"no {pattern!r} in {self._printed[self._read:]!r}")

    def do(self, command: str, *patterns: str) -> None:
        """Type a command; its answer and its effects must be printed."""
        self._type(command)
        self.expect(*patterns)


@contextmanager
def mavproxy_at(port: int, folder: Path) -> Iterator[MavProxy]:
    """MAVProxy that listens here, as soon as it has met a vehicle; unbuffered, or what it prints stays in its pipe."""
    command = [sys.executable, "-u", str(MAVPROXY), f"--master=udpin:127.0.0.1:{port}", f"--default-modules={MODULES}",
               f"--state-basedir={folder}", "--target-system=1"]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                               text=True, bufsize=1, cwd=folder)
    try:
        client = MavProxy(process)
        client.expect("Detected vehicle 1:1")
        yield client
    finally:
        process.kill()
        process.communicate()


@contextmanager
def mavproxy(folder: Path, identity: str) -> Iterator[MavProxy]:
    """MAVProxy beside one simulated vehicle."""
    port = free_udp_port()
    plan = PLAN if identity == "ardupilot" else PX4_PLAN
    for name, text in (("plan.txt", plan), ("fence.txt", FENCE), ("rally.txt", RALLY)):
        (folder / name).write_text(text)
    with (simulated(folder, "--open", f"udp://127.0.0.1:{port}", "--identity", identity),
          mavproxy_at(port, folder) as client):
        yield client


def test_as_ardupilot_it_is_flown_by_mode_and_mission(tmp_path: Path) -> None:
    with mavproxy(tmp_path, "ardupilot") as client:
        client.see("param show WPNAV_SPEED", r"WPNAV_SPEED\s+500")
        client.do("param set WPNAV_SPEED 450", "")
        client.do("wp load plan.txt", "MISSION_ACK: TYPE_MISSION: ACCEPTED")
        client.do("wp list", "Requesting 5 waypoints", r"22 3 52\.\d+ 6\.\d+ 5\.0+ ", "Saved 5 waypoints")
        client.do("fence load fence.txt", "MISSION_ACK: TYPE_FENCE: ACCEPTED")
        client.do("fence list", "Requesting 4 fence items")
        client.do("rally load rally.txt", "MISSION_ACK: TYPE_RALLY: ACCEPTED")
        client.do("rally list", "Requesting 1 rally items")
        client.do("mode AUTO", "DO_SET_MODE: ACCEPTED", "Mode AUTO")
        client.do("arm throttle", "COMPONENT_ARM_DISARM: DENIED")
        client.do("mode GUIDED", "DO_SET_MODE: ACCEPTED", "Mode GUIDED")
        client.do("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED", "ARMED")
        client.do("takeoff 5", "NAV_TAKEOFF: ACCEPTED")
        client.do("disarm", "COMPONENT_ARM_DISARM: DENIED")
        client.do("guided 52.220365 6.88615 6", "DO_REPOSITION: ACCEPTED")
        client.do("mode BRAKE", "DO_SET_MODE: ACCEPTED", "Mode BRAKE")
        client.do("mode AUTO", "DO_SET_MODE: ACCEPTED", "waypoint 2")
        client.do("wp set 3", "DO_SET_MISSION_CURRENT: ACCEPTED", "waypoint 3")
        client.do("mode RTL", "DO_SET_MODE: ACCEPTED", "DISARMED")
        client.do("fence clear", "")
        client.do("wp clear", "MISSION_ACK: TYPE_MISSION: ACCEPTED")


def test_as_px4_it_is_flown_by_commands(tmp_path: Path) -> None:
    """MAVProxy's `mode` does not know how to change PX4's modes; its other commands work."""
    with mavproxy(tmp_path, "px4") as client:
        client.see("param show MPC_XY_CRUISE", r"MPC_XY_CRUISE\s+5")
        client.do("wp load plan.txt", "MISSION_ACK: TYPE_MISSION: ACCEPTED")
        client.do("wp list", "Requesting 4 waypoints", "Saved 4 waypoints")
        client.do("fence load fence.txt", "MISSION_ACK: TYPE_FENCE: ACCEPTED")
        client.do("rally load rally.txt", "MISSION_ACK: TYPE_RALLY: ACCEPTED")
        client.do("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED", "ARMED")
        client.do("long MISSION_START 0 0 0 0 0 0 0", "MISSION_START: ACCEPTED", "Mode MISSION", "waypoint 2")
        client.do("long NAV_RETURN_TO_LAUNCH 0 0 0 0 0 0 0", "NAV_RETURN_TO_LAUNCH: ACCEPTED", "RTL> ", "DISARMED")


def test_it_holds_a_vehicle_of_a_mission_that_we_fly_and_lets_it_go_on(tmp_path: Path) -> None:
    port, run = free_udp_port(), tmp_path / "run"
    scene = house(tmp_path)
    command = [sys.executable, "-m", "ground_station.cli", "fly", str(MISSION), "--scene", str(scene), "--run",
               str(run), "--open", f"udp://127.0.0.1:{port}", "--identity", "ardupilot", "--set",
               "explore.max_views=2", "--set", "survey.max_views=6", "--set", "reconstruct.enabled=false"]
    with (tmp_path / "fly.log").open("wb") as log:
        flight = subprocess.Popen(command, stdout=log, stderr=log, cwd=tmp_path)
    try:
        with mavproxy_at(port, tmp_path) as client:
            client.expect("Mode AUTO")
            client.do("wp clear", "MISSION_ACK: TYPE_MISSION: DENIED")
            client.do("mode BRAKE", "DO_SET_MODE: ACCEPTED", "Mode BRAKE")
            client.do("mode AUTO", "DO_SET_MODE: ACCEPTED", "Mode AUTO")
        assert flight.wait(PATIENCE_S) == 0
    finally:
        flight.kill()
        flight.wait()
    assert json.loads((run / "truth" / "referee.json").read_text())["collisions"] == 0
    record = json.loads((run / "flight.json").read_text())
    assert record["fleet"]["views_flown"] == len(record["outcomes"])
