"""A ground station is killed and another takes its place: nothing lost, nothing twice, nobody armed in the air."""

from __future__ import annotations

import csv
import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
import trimesh

from ground_station import checkpoint, replay, resume
from ground_station.after_flight import in_charge
from ground_station.bench.mishaps import wrong
from ground_station.checkpoint import Checkpoints
from ground_station.drone import Drone, Stage
from ground_station.fleet import Fleet
from ground_station.fleet_link import ARM
from ground_station.ingest import Ingest
from ground_station.journal import Journal, read_head, read_turns
from ground_station.recorder import Recorder
from ground_station.station import Station
from ground_station.voice import Voice
from missions import topics
from missions.bus import Bus, Delivery
from missions.clock import Turn
from missions.errors import UserError
from missions.mavlink import GROUND_COMPONENT, GROUND_SYSTEM, Endpoint, Waypoint
from missions.messages import LegReport, MavlinkFrames, SiteBrief, Status, VehicleState
from missions.mission import BatterySpec, Mission, without_scene
from missions.mission_file import load_mission
from missions.run_folder import RunFolder
from tests.test_loopback import flight_of, small_mission

SITE = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)
MISSION = Mission(title="t", battery=BatterySpec(threshold_percent=30.0))
FLIGHT = pytest.mark.xdist_group("live")
LATENCY_NS = 10_000_000


class World:
    """A fleet of the ground station, and what it says to vehicle 1."""

    def __init__(self, folder: Path) -> None:
        run = RunFolder(folder)
        self.said: list[Any] = []
        self.recorder = Recorder(run, MISSION, SITE)
        ingest = Ingest(run, MISSION.site.anchor, MISSION.clock.epoch_utc, [(0.0, 0.0, 0.0)] * 2)
        self.fleet = Fleet(MISSION, SITE, self, ingest, self.recorder)  # type: ignore[arg-type]
        self.drone: Drone = self.fleet.drones[1]
        self._ears = Endpoint(GROUND_SYSTEM, GROUND_COMPONENT)

    def publish(self, topic: Any, message: Any, who: int | str = "") -> None:
        """As a voice."""
        if who == 1:
            self.said += self._ears.parse(message.frames) if isinstance(message, MavlinkFrames) else [message]

    def turn(self, t_ns: int, *messages: Any) -> list[Any]:
        """One turn of the clock; what is said to vehicle 1 in it, but for heartbeats."""
        of = {VehicleState: topics.VEHICLE_STATE, LegReport: topics.LEG_REPORT}
        deliveries = [Delivery(of[type(m)], "1", "uav1", t_ns, m) for m in messages]
        self.said.clear()
        self.fleet.receive(Turn(0, t_ns, deliveries, frozenset({"uav1", "uav2"}), stop=False))
        self.fleet.send()
        return [m for m in self.said if getattr(m, "get_type", lambda: "")() != "HEARTBEAT"]


def state(t_ns: int, mode: str, flying: bool, battery_percent: float = 80.0) -> VehicleState:
    still = (0.0, 0.0, 0.0)
    return VehicleState(vehicle_id=1, t_ns=t_ns, position_enu_m=(0.0, 0.0, 3.0 * flying), velocity_enu_m_s=still,
                        acceleration_enu_m_s2=still, yaw_enu_rad=0.0, gimbal_elevation_rad=0.0,
                        battery_percent=battery_percent, flying=flying, mode=mode)


def commands(said: list[Any]) -> list[int]:
    return [m.command for m in said if hasattr(m, "get_type") and m.get_type() == "COMMAND_LONG"]


VIEW = Waypoint(position_enu_m=(3.0, 0.0, 4.0), yaw_enu_rad=0.0, view_id=5)
AWAY_NS = 60_000_000_000


def test_nothing_is_asked_of_a_vehicle_before_it_is_heard_and_one_in_the_air_is_not_armed(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.turn(0, state(0, "standby", False))
    world.fleet.launch(world.drone)
    assert ARM in commands(world.turn(LATENCY_NS))
    world.fleet.meet_again(AWAY_NS)
    assert world.turn(AWAY_NS, state(AWAY_NS - 1, "standby", False)) == []
    later = AWAY_NS + LATENCY_NS
    said = commands(world.turn(later, state(later, "takeoff", True)))
    assert said
    assert ARM not in said
    assert world.drone.stage is Stage.LAUNCHING
    assert world.drone.link.failure == ""


@pytest.mark.parametrize(("mode", "flying", "stage"), [("return", True, Stage.HOMING),
                                                       ("standby", False, Stage.PARKED)])
@pytest.mark.parametrize(("battery_percent", "spent"), [(80.0, False), (29.0, True)])
def test_who_has_gone_home_meanwhile_is_found_there_and_flies_again_if_it_can(
        tmp_path: Path, mode: str, flying: bool, stage: Stage, battery_percent: float, spent: bool) -> None:
    world = World(tmp_path)
    world.turn(0, state(0, "mission", True))
    world.drone.stage = Stage.READY
    world.fleet.meet_again(AWAY_NS)
    world.turn(AWAY_NS, state(AWAY_NS, mode, flying, battery_percent))
    assert (world.drone.stage, world.drone.spent) == (stage, spent)


def test_a_plan_that_was_on_its_way_is_sent_again_from_the_beginning(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.turn(0, state(0, "mission", True))
    world.fleet.fly(world.drone, "survey", [VIEW])
    first = [str(m) for m in world.turn(LATENCY_NS)]
    world.fleet.meet_again(AWAY_NS)
    assert [str(m) for m in world.turn(AWAY_NS, state(AWAY_NS, "hold", True))] == first
    assert world.drone.awaited == [5]


def test_a_report_that_is_repeated_counts_once(tmp_path: Path) -> None:
    world = World(tmp_path)
    report = LegReport(plan_id=1, view_id=5, outcome="blocked")
    world.turn(0, report)
    world.turn(LATENCY_NS, report)
    assert world.drone.reports == [report]


def test_a_mission_with_a_model_of_the_structure_is_kept_and_read(tmp_path: Path) -> None:
    trimesh.creation.box(extents=(8.0, 6.0, 7.0)).apply_translation((0.0, 0.0, 3.5)).export(tmp_path / "prior.ply")
    mission = Mission(title="t", knowledge="mesh", prior_path=str(tmp_path / "prior.ply"))
    run = RunFolder(tmp_path)
    station = Station(mission, SITE, run, Voice(None))
    Checkpoints(run, mission, SITE).spent(1.0, station, 123)
    found = Checkpoints(run, mission, SITE).read(Voice(None))
    assert found is not None
    again, begin = found
    assert begin == 123
    assert again.prior is not None
    assert again.prior is not station.prior
    assert again.director.phase == station.director.phase


def test_without_a_mission_under_way_there_is_nothing_to_take_up(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no mission\.toml"):
        resume._take_up(resume._parse([str(tmp_path)]))


class Killer:
    """Kills the ground station of a flight as soon as the next condition holds, and has another take its place; with
    the last one goes the launcher."""

    def __init__(self, flight: psutil.Popen, run: RunFolder, *when: Callable[[Status], bool]) -> None:
        self.flight, self.run, self.when = flight, run, list(when)
        self.heirs: list[subprocess.Popen[bytes]] = []

    def __call__(self, status: Status) -> None:
        """A status was told."""
        if not self.when or not self.when[0](status):
            return
        self.when.pop(0)
        if not self.when:
            self.flight.kill()
        self.ground.kill()
        self.heirs.append(subprocess.Popen([sys.executable, "-m", "ground_station.resume", str(self.run.root),
                                            "--quiet"]))

    @property
    def ground(self) -> Any:
        """The process that commands."""
        if self.heirs:
            return self.heirs[-1]
        return next(child for child in self.flight.children() if "ground_station" in child.cmdline())

    @property
    def flying(self) -> bool:
        """Whether the mission is under way."""
        return self.heirs[-1].poll() is None if self.heirs else self.flight.poll() is None


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[RunFolder, Killer]]:
    """`swarmscan fly`, whose ground station is killed, and then the next one and the launcher."""
    folder = tmp_path_factory.mktemp("resume")
    run = RunFolder(folder / "run0")
    arguments = small_mission(folder, ["explore.max_views=4", "survey.max_views=8", "reconstruct.enabled=false"])
    flight = psutil.Popen([sys.executable, "-m", "ground_station.launcher", *arguments])
    killer = Killer(flight, run, lambda s: s.phase == "explore" and s.pictures > 12,
                    lambda s: s.phase == "survey" and any(v.mode == "flying" and v.views_left for v in s.vehicles))
    while not (run.endpoint.is_file() and run.endpoint.read_text()):
        with pytest.raises(psutil.TimeoutExpired):
            flight.wait(0.05)
    with Bus("observer", "default", connect=run.endpoint.read_text()) as bus:
        bus.subscribe(topics.STATUS)
        others = flight.children()
        while killer.flying:
            for delivery in bus.poll(timeout_s=0.2):
                killer(delivery.message)
    yield run, killer
    for process in (flight, *others):
        with suppress(psutil.NoSuchProcess):
            process.kill()
    for process in (flight, *killer.heirs):
        process.wait()


@pytest.mark.loopback
@FLIGHT
def test_a_mission_whose_ground_station_is_killed_twice_and_its_launcher_is_flown_to_its_end(
        flown: tuple[RunFolder, Killer]) -> None:
    run, killer = flown
    assert killer.when == []
    assert killer.flight.wait() == -signal.SIGKILL
    assert [heir.wait() for heir in killer.heirs] == [-signal.SIGKILL, 0]
    record = flight_of(run)
    assert {what: found for what, found in wrong(load_mission(run.mission), run).items() if found} == {}
    assert set(record["outcomes"].values()) == {"flown"}
    assert len(record["outcomes"]) == 8
    assert [n.endswith("takes the mission up again") for n in record["notes"]].count(True) == 2
    with run.views_csv.open() as f:
        assert sorted(int(r["view_id"]) for r in csv.DictReader(f)) == sorted(
            v for tour in record["tours"].values() for v in tour)


@pytest.mark.loopback
@FLIGHT
def test_who_takes_it_up_makes_the_report_when_nobody_else_is_there_for_it(
        flown: tuple[RunFolder, Killer]) -> None:
    run, _ = flown
    assert run.report.is_file()
    assert json.loads(run.metrics.read_text())["collisions"] == 0
    assert not (run.root / "checkpoint").exists()


@pytest.mark.loopback
@FLIGHT
def test_every_decision_before_between_and_after_is_made_again(
        flown: tuple[RunFolder, Killer], capsys: pytest.CaptureFixture[str]) -> None:
    run, _ = flown
    assert [turn.resumed for turn, _ in read_turns(run)].count(True) == 2
    assert replay.main([str(run.root), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["parted_at_turn"] is None


@pytest.mark.loopback
@FLIGHT
@pytest.mark.parametrize("share", [0.3, 0.8])
def test_a_station_read_from_disk_goes_on_to_the_bit(flown: tuple[RunFolder, Killer], tmp_path: Path,
                                                    monkeypatch: pytest.MonkeyPatch, share: float) -> None:
    monkeypatch.setattr(checkpoint, "AGAIN_S", 0.05)
    work = RunFolder(tmp_path)
    shutil.copytree(flown[0].pictures, work.pictures, dirs_exist_ok=True)
    shutil.copy(flown[0].mission, work.mission)
    mission, site = without_scene(load_mission(flown[0].mission)), read_head(flown[0].journal).site
    turns = list(read_turns(flown[0]))
    station, kept = Station(mission, site, work, Voice(None)), Checkpoints(work, mission, site)
    journal = Journal.begin(work.journal, mission.mission_hash, site)
    for turn, said in turns[:round(share * len(turns))]:
        assert station.live_through(turn) == said
        journal.write(turn, turn.beside, said)
        kept.spent(0.01, station, journal.size)
    journal.close()
    assert not kept._cannot
    with work.journal.open("ab") as f:
        f.write(b"torn")
    heir = resume.revive(Checkpoints(work, mission, site), read_head(work.journal), Voice(None))
    assert heir.fleet.t_ns == station.fleet.t_ns
    assert [turn.tick for turn, said in turns[round(share * len(turns)):] if heir.live_through(turn) != said] == []
    assert list(read_turns(work)) == turns[:round(share * len(turns))]


def test_a_journal_is_kept_by_one_process_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "journal.bin"
    first = Journal.begin(path, "hash", SITE)
    with pytest.raises(UserError, match="still there"):
        Journal(path)
    first.close()
    Journal(path).close()
    assert read_head(path).site == SITE


def test_one_process_is_in_charge_of_what_follows(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    with in_charge(run) as first, in_charge(run) as second:
        assert (first, second) == (True, False)
    with in_charge(run) as third:
        assert third
