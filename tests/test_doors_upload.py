"""`swarmscan missions upload` and `download` against a vehicle behind a door, through a bad link."""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path

import pytest

from ground_station.cli import main
from missions.errors import LinkError
from missions.flight_plan import FlightPlan, home_item, item_from_params
from missions.mavlink import Item
from missions.mavlink_link import MavlinkLink, vehicles
from missions.mission_file import load_mission
from missions.mission_transfer import canonical_sha256
from missions.qgc_plan import read_plan, write_plan
from missions.tlog import read_tlog
from sim_bridge.faults import Faults, LossyProxy
from tests.simulated_doors import MISSION, free_udp_port, simulated

pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("loopback")]
ANCHOR = load_mission(MISSION).site.anchor
LINK = Faults(loss=0.2, duplicates=0.05, reordered=0.05, latency_s=0.005)


def placed(command: int, p1: float, east_m: float, north_m: float, up_m: float, frame: int = 3) -> Item:
    lat, lon = (ANCHOR.lat_deg + north_m / 111_320.0,
                ANCHOR.lon_deg + east_m / 111_320.0 / math.cos(math.radians(ANCHOR.lat_deg)))
    return item_from_params(frame, command, (p1, 0, 0, 0, lat, lon, up_m), "made")


PLAN = FlightPlan(
    home=home_item(ANCHOR.lat_deg, ANCHOR.lon_deg, ANCHOR.alt_m),
    mission=[placed(22, 0, 0, 0, 6), *(placed(16, 0, 9 * math.cos(a), 9 * math.sin(a), 6) for a in range(6)),
             item_from_params(2, 20, (0, 0, 0, 0, 0, 0, 0), "made")],
    fence=[placed(5001, 4, x, y, 0, 0) for x, y in ((-17, -17), (17, -17), (17, 17), (-17, 17))],
    rally=[placed(5100, 0, 8, -10, 5)])


def wait_for_vehicles(url: str) -> None:
    """Until the simulation is up."""
    with MavlinkLink(url) as link:
        for _ in range(60):
            with contextlib.suppress(LinkError):
                assert vehicles(link)
                return
    pytest.fail("the simulation did not come up")


def test_a_plan_goes_up_and_comes_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In the dialect where home comes first and requests are the old ones."""
    sent, back, port = tmp_path / "sent.plan", tmp_path / "back.plan", free_udp_port()
    write_plan(sent, PLAN, 5.0)
    with (simulated(tmp_path, "--open", f"udpin://127.0.0.1:{port}", "--identity", "ardupilot", "--speed", "1"),
          LossyProxy(("127.0.0.1", port), LINK) as proxy):
        url = "udpout://{}:{}".format(*proxy.address)
        wait_for_vehicles(url)
        assert main(["missions", "upload", str(sent), "--to", url, "--json"]) == 0
        rows = json.loads(capsys.readouterr().out)
        assert main(["missions", "download", str(back), "--from", url, "--json"]) == 0
    assert [(r["part"], r["system"]) for r in rows] == [("fence", 1), ("rally", 1), ("mission", 1)]
    held = read_plan(back)
    for ours, theirs in ((PLAN.mission, held.mission), (PLAN.fence, held.fence), (PLAN.rally, held.rally)):
        assert canonical_sha256(ours) == canonical_sha256(theirs)
    log = tmp_path / "run" / "doors.tlog"
    kinds = {m.get_type() for _, m in read_tlog(log, load_mission(MISSION).clock.epoch_utc)}
    assert kinds >= {"HEARTBEAT", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK", "HOME_POSITION"}
