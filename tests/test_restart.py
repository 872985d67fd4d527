"""Processes that are killed in flight and started again, on loopback."""

from __future__ import annotations

import csv
import io
import json
import resource
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest

from ground_station import replay
from ground_station.processes import Flight
from missions.clock import SECOND_NS
from missions.messages import Status
from missions.mission_file import load_mission
from missions.run_folder import RunFolder
from missions.tlog import read_tlog
from tests.killed_vehicle import KILL_AT_S
from tests.test_loopback import fly

pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("doors")]

ARM = 400
KILLED_S = 27.0
SMALL = ["explore.max_views=4", "survey.max_views=6"]


def rows_of(run: RunFolder) -> list[dict[str, str]]:
    with run.views_csv.open() as f:
        return list(csv.DictReader(f))


def killing(name: str, due: list[Callable[[Status], bool]]) -> tuple[Callable[[Flight, Status], None], list[float]]:
    """Kills the process each time that the next of the conditions holds; and when it did."""
    killed: list[float] = []

    def watch(flight: Flight, status: Status) -> None:
        if len(killed) < len(due) and due[len(killed)](status) and name in flight.running:
            killed.append(status.t_ns / 1e9)
            flight.running[name].kill()

    return watch, killed


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunFolder, Path]:
    folder = tmp_path_factory.mktemp("undisturbed")
    run, complaints = fly(folder, SMALL)
    assert complaints == []
    return run, folder


def test_a_killed_bridge_is_replaced_and_the_flight_is_the_same(undisturbed: tuple[RunFolder, Path],
                                                                tmp_path: Path) -> None:
    """Time stands still without a bridge, and its successor knows all that it knew: not a bit is different."""
    first, folder = undisturbed
    (tmp_path / "very_secret_house.ply").write_bytes((folder / "very_secret_house.ply").read_bytes())
    watch, killed = killing("bridge", [lambda s: s.pictures >= 2, lambda s: s.phase == "survey" and s.pictures >= 6])
    second, complaints = fly(tmp_path, [*SMALL, "clock.speed=3.0"], watch=watch)
    assert complaints == []
    assert len(killed) == 2
    assert "takes the place of a bridge that died" in (second.logs / "bridge.log").read_text()
    with np.load(first.trajectories) as a, np.load(second.trajectories) as b:
        assert [name for name in a.files if not np.array_equal(a[name], b[name])] == []
    for path in ("views.csv", "flight.tlog", "truth/views.csv"):
        assert (first.root / path).read_bytes() == (second.root / path).read_bytes()
    verdicts = [json.loads(run.referee.read_text()) for run in (first, second)]
    assert verdicts[0] == verdicts[1]
    assert verdicts[0]["collisions"] == 0


def test_a_killed_vehicle_comes_back_where_it_was_and_nothing_is_lost_or_flown_twice(tmp_path: Path) -> None:
    run, complaints = fly(tmp_path, [*SMALL, "survey.max_views=12", "clock.speed=2.0", "fleet.lost_after_s=120.0"],
                          environment={KILL_AT_S: str(KILLED_S)}, modules={"uav1": "tests.killed_vehicle"})
    assert complaints == []
    record = json.loads(run.flight.read_text())
    assert json.loads(run.referee.read_text())["collisions"] == 0
    assert set(record["outcomes"].values()) == {"flown"}
    # while it is away a teammate with nothing left to do may help out, but nobody takes it for lost
    assert {r["reason"] for r in record["reassignments"]} <= {"balance"}
    assert [n.split(": ")[1] for n in record["notes"] if n.endswith(("is back", "for it"))] == [
        "vehicle 1 has vanished; its views wait 120 s for it", "vehicle 1 is back"]
    rows = rows_of(run)
    assert len({r["view_id"] for r in rows}) == len(rows)
    on_the_card = {int(p.stem.split("_")[1]) for p in run.sd_card(1).glob("*.json")}
    assert on_the_card == {int(r["view_id"]) for r in rows if r["vehicle_id"] == "1"}
    assert on_the_card == {int(p.stem.split("_")[1]) for p in run.sd_card(1).glob("*.ack")}
    with np.load(run.trajectories) as tracks:
        t_s, path = tracks["uav1_t_s"], tracks["uav1_position_enu_m"]
    around = np.abs(t_s - KILLED_S) < 60.0
    assert np.linalg.norm(np.diff(path[around], axis=0), axis=1).max() < 0.4  # it flies on from where it was
    epoch = load_mission(run.mission).clock.epoch_utc
    arms = [m for _, m in read_tlog(run.tlog, epoch) if m.get_type() == "COMMAND_LONG" and m.command == ARM
            and m.target_system == 1]
    assert len(arms) == 1


def test_a_run_folder_that_takes_no_more_holds_the_fleet_until_it_does(tmp_path: Path) -> None:
    """The ground station may write no byte more for a while; no picture is lost for that, and no turn."""
    limited: list[int] = []
    holding: list[int] = []

    def watch(flight: Flight, status: Status) -> None:
        pid, t_s = flight.running["ground"].pid, status.t_ns // SECOND_NS
        if not limited and status.phase == "survey" and status.pictures >= 6:
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (1, resource.RLIM_INFINITY))
            limited.append(t_s)
        elif limited and "vehicles hold" in status.note and not holding:
            holding.append(t_s)
        elif holding and t_s > holding[0] + 20:
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))

    run, complaints = fly(tmp_path, [*SMALL, "survey.max_views=12", "clock.speed=8.0"], watch=watch)
    assert complaints == []
    assert holding
    record = json.loads(run.flight.read_text())
    assert [n.split(": ", 1)[1] for n in record["notes"] if "disk" in n] == [
        "the disk of the run folder takes no files of this size: vehicles hold, no new views",
        "the disk of the run folder takes pictures again"]
    assert set(record["outcomes"].values()) == {"flown"}
    rows = rows_of(run)
    assert len({r["view_id"] for r in rows}) == len(rows) == json.loads(run.referee.read_text())["pictures"]
    assert all((run.root / r["path"]).stat().st_size > 1000 for r in rows)
    with redirect_stdout(io.StringIO()) as told:
        assert replay.main([str(run.root), "--json"]) == 0
    assert json.loads(told.getvalue())["simulated_s"] > holding[0] + 20
