"""`swarmscan missions upload` and `download` over real sockets, through the lossy proxy."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mav

from ground_station.cli import main
from missions import mavlink_link
from missions.errors import LinkError, UserError
from missions.flight_plan import FlightPlan, home_item, item_from_params
from missions.mavlink import Item, plan_sha256
from missions.mavlink_link import MavlinkLink
from missions.qgc_plan import read_plan, write_plan
from missions.signing import Signing
from missions.waypoint_file import read_waypoints, write_waypoints
from sim_bridge.faults import Faults, LossyProxy
from tests.test_mission_transfer import VEHICLE, VehicleEnd, plan

CLEAN = Faults()
HOME = home_item(52.0, 6.0, 40.0)
FENCE = [item_from_params(0, 5001, (3, 0, 0, 0, 52 + n % 2 / 100, 6 + n / 100, 0), "made") for n in range(3)]
RALLY = [item_from_params(3, 5100, (0, 0, 0, 0, 52.001, 6.001, 20), "made")]
WHY = (b"plan refused: ".ljust(50, b"."), b"it is too far")


class Door:
    """Vehicles behind one UDP port, in a thread: heartbeats, home and the mission service to whoever spoke last."""

    def __init__(self, ends: list[VehicleEnd], autopilot: int) -> None:
        self.ends, self._autopilot = ends, autopilot
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.005)
        self.address: tuple[str, int] = self.socket.getsockname()
        self.closing = threading.Event()
        self.thread = threading.Thread(target=self._serve)

    def _serve(self) -> None:
        client, heartbeat_s = None, 0.0
        while not self.closing.is_set():
            frames = []
            try:
                data, client = self.socket.recvfrom(2000)
                frames.append(data)
            except TimeoutError:
                pass
            out = [f for end in self.ends for f in self._answers(end, frames)]
            if time.monotonic() >= heartbeat_s:
                heartbeat_s = time.monotonic() + 0.2
                out += [end.endpoint.pack(mav.MAVLink_heartbeat_message(2, self._autopilot, 1, 0, 4, 3))
                        for end in self.ends]
            for frame in out if client is not None else []:
                self.socket.sendto(frame, client)

    def _answers(self, end: VehicleEnd, frames: list[bytes]) -> list[bytes]:
        out: list[bytes] = []
        for message in end.endpoint.parse(frames):
            if getattr(message, "target_system", 0) != end.system:
                continue
            if message.get_type() == "COMMAND_LONG":
                home = mav.MAVLink_home_position_message(HOME.x, HOME.y, 40_000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
                out.append(end.endpoint.pack(home))
            else:
                answers = end.service.handle(message, time.monotonic_ns()) or []
                refused = any(a.get_type() == "MISSION_ACK" and a.type == mav.MAV_MISSION_DENIED for a in answers)
                texts = [mav.MAVLink_statustext_message(4, chunk) for chunk in WHY if refused]
                out += [end.endpoint.pack(a) for a in [*answers, *texts]]
        return out + [end.endpoint.pack(a) for a in end.service.poll(time.monotonic_ns())]


@contextmanager
def door(*ends: VehicleEnd, autopilot: int = mav.MAV_AUTOPILOT_PX4, faults: Faults = CLEAN) -> Iterator[str]:
    """The address of a door through a proxy."""
    served = Door(list(ends), autopilot)
    served.thread.start()
    try:
        with LossyProxy(served.address, faults) as proxy:
            yield "udpout://{}:{}".format(*proxy.address)
    finally:
        served.closing.set()
        served.thread.join()
        served.socket.close()


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mavlink_link, "DISCOVERY_S", 0.4)
    monkeypatch.setattr(mavlink_link, "LISTEN_S", 2.0)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.plan"
    write_plan(path, FlightPlan(home=HOME, mission=plan(12), fence=FENCE, rally=RALLY), 5.0)
    return path


def same(a: list[Item], b: list[Item]) -> bool:
    return plan_sha256(a) == plan_sha256(b)


def test_a_plan_goes_up_and_comes_back_through_20_percent_loss(
        file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    end = VehicleEnd()
    with door(end, faults=Faults(loss=0.2, duplicates=0.05, reordered=0.05, latency_s=0.001)) as url:
        assert main(["missions", "upload", str(file), "--to", url, "--json"]) == 0
        rows = json.loads(capsys.readouterr().out)
        assert main(["missions", "download", str(tmp_path / "back.plan"), "--from", url, "--json"]) == 0
    assert [(r["part"], r["items"], r["system"]) for r in rows] == [
        ("fence", 3, VEHICLE), ("rally", 1, VEHICLE), ("mission", 12, VEHICLE)]
    assert rows[2]["sha256"] == plan_sha256(plan(12))
    assert all(same(end.shelves[kind].items, items) for kind, items in enumerate((plan(12), FENCE, RALLY)))
    back = read_plan(tmp_path / "back.plan")
    assert back.home == HOME
    assert all(same(*pair) for pair in ((back.mission, plan(12)), (back.fence, FENCE), (back.rally, RALLY)))


def test_ardupilot_gets_home_first_and_gives_it_back(tmp_path: Path) -> None:
    end, path = VehicleEnd(), tmp_path / "a.waypoints"
    write_waypoints(path, HOME, plan(5))
    with door(end, autopilot=mav.MAV_AUTOPILOT_ARDUPILOTMEGA) as url:
        assert main(["missions", "upload", str(path), "--to", url]) == 0
        assert same(end.shelves[0].items, [HOME, *plan(5)])
        assert main(["missions", "download", str(tmp_path / "back.waypoints"), "--from", url]) == 0
    back = read_waypoints(tmp_path / "back.waypoints")
    assert same([back.home, *back.mission], [HOME, *plan(5)])


def test_of_several_vehicles_one_is_to_be_chosen(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = VehicleEnd(system=8)
    first = VehicleEnd()
    with door(first, other) as url:
        assert main(["missions", "upload", str(file), "--to", url]) == 2
        assert "--system: vehicles 7, 8 are there; choose one of them." in capsys.readouterr().err
        assert main(["missions", "upload", str(file), "--to", url, "--system", "9"]) == 2
        assert main(["missions", "upload", str(file), "--to", url, "--system", "8"]) == 0
    assert same(other.shelves[0].items, plan(12))
    assert first.shelves[0].items == []


def test_a_refused_plan_and_a_dead_link_fail_closed(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    refusing = VehicleEnd(mav.MAV_MISSION_DENIED)
    with door(refusing) as url:
        assert main(["missions", "upload", str(file), "--to", url]) == 1
    assert "vehicle 7 did not take the fence (3 items): denied; it says: plan refused: ....." in caplog.text
    assert "....it is too far." in caplog.text
    with door(VehicleEnd(), faults=Faults(loss=1.0)) as url:
        assert main(["missions", "upload", str(file), "--to", url]) == 1
    assert "no vehicle was heard within" in caplog.text


def test_a_signed_link_hears_only_who_has_the_key(file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    key = tmp_path / "key"
    key.write_text("5e" * 32)
    key.chmod(0o600)
    end = VehicleEnd(signing=Signing(bytes([0x5E] * 32)))
    with door(end) as url:
        assert main(["missions", "upload", str(file), "--to", url, "--timeout-s", "1"]) == 1
        assert "no proof that it arrived" in caplog.text
        assert main(["missions", "upload", str(file), "--to", url, "--signing-key", str(key)]) == 0
    assert same(end.shelves[0].items, plan(12))
    assert "5e5e" not in caplog.text


@pytest.mark.parametrize(("arguments", "told"), [
    (["upload", "a.kml", "--to", "udpout://127.0.0.1:1"], "a.kml: is no plan file by its name"),
    (["download", "a.kml", "--from", "udpout://127.0.0.1:1"], "a.kml: is no plan file by its name"),
    (["upload", "FILE", "--to", "carrier-pigeon"], "carrier-pigeon: is no MAVLink address; give udpout://HOST:PORT")])
def test_bad_arguments_are_refused(arguments: list[str], told: str, file: Path,
                                   capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["missions", *(str(file) if a == "FILE" else a for a in arguments)]) == 2
    assert told in capsys.readouterr().err


def test_what_cannot_be_opened_is_a_link_error() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as closed:
        closed.bind(("127.0.0.1", 0))
        port = closed.getsockname()[1]
    for url in (f"tcp://127.0.0.1:{port}", "serial:///dev/none:57600"):
        with pytest.raises(LinkError, match="cannot be opened"):
            MavlinkLink(url)
    with pytest.raises(UserError, match="is no MAVLink address"):
        MavlinkLink("udpout://127.0.0.1")

