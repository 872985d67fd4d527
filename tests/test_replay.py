"""A run once more from its journal: the same decisions, as far as the journal is whole; where a changed one parts."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import msgspec
import pytest
from playwright.sync_api import expect

from ground_station import connect, replay
from ground_station.journal import Journal, journalled_mission, read_head, read_turns
from ground_station.live.playback import Playback
from ground_station.processes import free_endpoint
from ground_station.station import Station
from ground_station.voice import Voice
from missions import topics
from missions.bus import Bus, Delivery
from missions.clock import BRIDGE, Turn
from missions.errors import UserError
from missions.messages import PlanHash, SiteBrief, VehicleState
from missions.mission_file import load_mission
from missions.run_folder import RunFolder
from tests.live_browser import NEEDS_BROWSER, PATIENCE_MS, keep, tab_at
from tests.live_world import free_port
from tests.test_loopback import fly

SITE = SiteBrief(object_min_enu_m=(0.0, 0.0, 0.0), object_max_enu_m=(1.0, 1.0, 1.0), ground_up_m=0.0)
SHOWN = 300
"""Looks at what a watcher has, at most."""
FLIGHT = pytest.mark.xdist_group("live")


def state(t_ns: int) -> VehicleState:
    still = (0.0, 0.0, 0.0)
    return VehicleState(vehicle_id=1, t_ns=t_ns, position_enu_m=(0.0, 0.0, t_ns / 1e9), velocity_enu_m_s=still,
                        acceleration_enu_m_s2=still, yaw_enu_rad=0.0, gimbal_elevation_rad=0.0,
                        battery_percent=90.0, flying=True, mode="mission")


def written(path: Path, turns: int) -> list[tuple[Turn, bytes]]:
    journal, voice, out = Journal.begin(path, "hash", SITE), Voice(None), []
    for n in range(turns):
        t_ns = n * 100_000_000
        deliveries = [Delivery(topics.VEHICLE_STATE, "1", "uav1", t_ns, state(t_ns))]
        turn = Turn(n, t_ns, deliveries, frozenset({"ground", "uav1"}), stop=False)
        voice.publish(topics.PLAN_HASH, PlanHash(plan_id=n, count=0, sha256=""), 1)
        out.append((turn, voice.take_digest()))
        journal.write(turn, [], out[-1][1])
    journal.close()
    return out


def test_what_was_written_is_read_as_far_as_it_is_whole(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    turns = written(run.journal, 5)
    assert list(read_turns(run)) == turns
    assert read_head(run.journal).site == SITE
    data = run.journal.read_bytes()
    for cut in range(len(data) - 1, len(data) - 40, -7):
        run.journal.write_bytes(data[:cut])
        assert list(read_turns(run)) == turns[:4]
    run.journal.write_bytes(data[:-3] + bytes([data[-3] ^ 1]) + data[-2:])
    assert list(read_turns(run)) == turns[:4]


def test_what_is_no_journal_is_refused_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="give the folder of a run"):
        read_head(tmp_path / "journal.bin")
    (tmp_path / "journal.bin").write_bytes(b"")
    with pytest.raises(UserError, match="had not begun"):
        read_head(tmp_path / "journal.bin")
    head = msgspec.msgpack.encode(["other", "hash", SITE, False])
    (tmp_path / "journal.bin").write_bytes(struct.pack("<II", len(head), zlib.crc32(head)) + head)
    with pytest.raises(UserError, match="another version"):
        read_head(tmp_path / "journal.bin")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    run, complaints = fly(tmp_path_factory.mktemp("replay"), ["explore.max_views=4", "survey.max_views=6",
                                                              "survey.refine=2", "camera.position_sigma_m=0.02",
                                                              "camera.attitude_sigma_deg=0.3"])
    assert complaints == []
    record = json.loads(run.flight.read_text(encoding="utf-8"))
    assert [a["why"] for a in record["allocations"]][:2] == ["start", "refine"], "the second flight took place"
    return run


def copied(run: RunFolder, to: Path) -> RunFolder:
    shutil.copytree(run.root, to)
    return RunFolder(to)


@pytest.mark.loopback
@FLIGHT
def test_every_decision_is_made_again_and_nothing_in_the_run_is_touched(
        flown: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    before = {p: p.read_bytes() for p in flown.root.rglob("*") if p.is_file()}
    assert replay.main([str(flown.root), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["parted_at_turn"] is None
    assert result["turns"] > 100
    assert {p: p.read_bytes() for p in flown.root.rglob("*") if p.is_file()} == before


@pytest.mark.loopback
@FLIGHT
def test_a_run_that_broke_off_is_replayed_to_its_last_whole_turn(flown: RunFolder, tmp_path: Path,
                                                                 capsys: pytest.CaptureFixture[str]) -> None:
    run = copied(flown, tmp_path / "run")
    data = run.journal.read_bytes()
    run.journal.write_bytes(data[:len(data) * 2 // 3])
    assert replay.main([str(run.root), "--json"]) == 0
    assert 0 < json.loads(capsys.readouterr().out)["turns"] < sum(1 for _ in read_turns(flown))


@pytest.mark.loopback
@FLIGHT
def test_who_heard_something_else_decides_something_else(flown: RunFolder, tmp_path: Path,
                                                         capsys: pytest.CaptureFixture[str]) -> None:
    """Somebody rewrote the journal: the first report of vehicle 1's battery in the air says 15 %."""
    run = copied(flown, tmp_path / "run")
    mission = load_mission(run.mission)
    head = read_head(run.journal)
    entries = list(read_turns(run))
    changed = Journal.begin(run.journal, head.mission_hash, head.site)
    for turn, said in entries:
        deliveries = [_emptied(d) for d in turn.deliveries]
        changed.write(Turn(turn.tick, turn.t_ns, deliveries, turn.participants, turn.stop), turn.beside, said)
    changed.close()
    assert mission.battery.threshold_percent > 15.0
    assert replay.main([str(run.root), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["parted_at_turn"] is not None


def _emptied(delivery: Delivery) -> Delivery:
    message = delivery.message
    if isinstance(message, VehicleState) and message.vehicle_id == 1:
        message = msgspec.structs.replace(message, battery_percent=15.0)
    return Delivery(delivery.topic, delivery.who, delivery.sender, delivery.t_ns, message)


@pytest.mark.loopback
@FLIGHT
def test_another_mission_file_is_refused(flown: RunFolder, tmp_path: Path) -> None:
    run = copied(flown, tmp_path / "run")
    run.mission.write_text(run.mission.read_text().replace("max_views = 6", "max_views = 7"))
    with pytest.raises(UserError, match="put the file back"):
        replay.main([str(run.root)])


@pytest.mark.loopback
@FLIGHT
def test_watchers_see_the_vehicles_fly_again(flown: RunFolder, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    mission, head = journalled_mission(flown)
    with Bus(BRIDGE, replay.FLEET, listen=endpoint) as bus:
        station = Station(mission, head.site, flown, Voice(bus, steers=False),
                          writes=RunFolder(tmp_path))
        playback = Playback(station, bus, speed=0.0)
        with connect(endpoint=endpoint, fleet=replay.FLEET) as watcher:
            turns = [turn for turn, _ in read_turns(flown)]
            for turn in turns[:len(turns) // 2]:
                station.live_through(turn)
            places = {}
            for _ in range(SHOWN):
                playback.show(wait_s=0.1)
                with watcher.reading() as model:
                    places = {} if model.state is None else {v.vehicle_id: v for v in model.state.vehicles}
                if places:
                    break
        station.close()
    assert set(places) == {1, 2}


@pytest.mark.loopback
@FLIGHT
@NEEDS_BROWSER
def test_the_page_plays_a_recording_holds_it_and_plays_it_faster(flown: RunFolder, tmp_path: Path) -> None:
    port = free_port()
    command = [sys.executable, "-m", "ground_station.cli", "replay", str(flown.root), "--live", "--port", str(port)]
    player = subprocess.Popen([*command, "--speed", "2", "--wait"], stdout=subprocess.PIPE, text=True)
    try:
        with tab_at(port) as tab:
            expect(tab.locator("#beside")).to_have_text("recording, paused")
            expect(tab.locator('[data-vehicle="1"]')).to_have_text("on its pad")
            assert tab.get_by_role("button", name="Abort mission").count() == 0
            tab.get_by_role("button", name="Play").click()
            expect(tab.locator("#beside")).to_have_text("recording, 2 x")
            expect(tab.locator('[data-vehicle="1"]')).to_have_text("flying")
            tab.get_by_role("button", name="Pause").click()
            expect(tab.locator("#beside")).to_have_text("recording, paused")
            keep(tab, tmp_path, "replay")
            tab.get_by_label("Speed").click()
            tab.get_by_role("option", name="as fast as possible").click()
            tab.get_by_role("button", name="Play").click()
            assert "every decision is the same" in player.communicate(timeout=PATIENCE_MS / 1000.0)[0]
        assert player.returncode == 0
    finally:
        player.kill()
