"""Disks that are full, gone or stuck, with the system's own errors: pictures wait on board, vehicles hold and go on."""

from __future__ import annotations

import csv
import os
import resource
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pytest

from ground_station.checkpoint import Checkpoints
from ground_station.ingest import Ingest
from ground_station.station import Station
from ground_station.voice import Voice
from missions import topics
from missions.clock import SECOND_NS
from missions.disk import Disk
from missions.errors import DiskError
from missions.messages import PictureAck, SiteBrief
from missions.mission import Mission
from missions.process import run_process
from missions.records import RecordFile, read_records
from missions.run_folder import RunFolder
from tests.test_ground_ingest import HOMES, SITE, a_jpeg, chunks_of
from tests.test_vehicle_flight import mission, open_map, route
from tests.vehicle_world import World

BOX = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)
EPOCH = "2026-06-01T10:00:00Z"


@contextmanager
def files_of_at_most(size_bytes: int) -> Iterator[None]:
    """No file of this process may grow beyond this, as with a quota."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_says_so() -> None:
    disk = Disk(Path("/dev"))
    assert not disk.append(Path("/dev/full"), b"x")
    assert disk.trouble == "is full"


def test_what_does_not_fit_leaves_nothing_behind_and_fits_later(tmp_path: Path) -> None:
    disk, path, rows = Disk(tmp_path), tmp_path / "a.jpg", tmp_path / "rows.csv"
    rows.write_bytes(b"one")
    with files_of_at_most(1000):
        assert not disk.write(path, bytes(5000))
        assert not disk.append(rows, bytes(5000))
        assert disk.trouble == "takes no files of this size"
        disk.check()
        assert disk.trouble
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rows.csv"]
    assert rows.read_bytes() == b"one"
    disk.check()
    assert disk.trouble == ""
    assert disk.write(path, bytes(5000))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.jpg", "rows.csv"]


def test_a_disk_that_hangs_is_waited_for_once_and_not_for_long(tmp_path: Path) -> None:
    disk, stuck = Disk(tmp_path, patience_s=0.05), tmp_path / "stuck"
    os.mkfifo(stuck)  # opening it for writing lasts until somebody reads
    assert not disk.append(stuck, b"late")
    assert disk.trouble == "has not answered for 0.05 s"
    assert not disk.write(tmp_path / "other", b"x")
    reader = threading.Thread(target=stuck.read_bytes)
    reader.start()
    reader.join()
    while disk.trouble:
        disk.check()
    assert disk.write(tmp_path / "other", b"x")


def test_a_disk_that_is_slow_time_after_time_keeps_what_it_took_and_is_troubled_until_it_is_not(tmp_path: Path) -> None:
    disk, rows = Disk(tmp_path, slow_s=0.0), tmp_path / "rows.csv"
    for number in range(3):
        assert disk.trouble == ""
        assert disk.write(tmp_path / f"{number}.jpg", bytes(5000))
        disk.slow_s = 3600.0
        assert disk.append(rows, b"small ones go into the system's memory at once")
        disk.slow_s = 0.0
    assert disk.trouble == "is slow (more than 0 s for a write)"
    disk.check()
    assert disk.trouble
    disk.slow_s = 3600.0
    disk.check()
    assert disk.trouble == ""
    for slow_s in (0.0, 0.0, 3600.0, 0.0, 0.0):
        disk.slow_s = slow_s
        assert disk.write(tmp_path / "3.jpg", bytes(5000))
    assert disk.trouble == "", "not in a row"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["0.jpg", "1.jpg", "2.jpg", "3.jpg", "rows.csv"]


def test_what_a_disk_has_answered_is_answered_again(tmp_path: Path) -> None:
    disk, path = Disk(tmp_path), tmp_path / "a.jpg"

    def a_turn() -> list[tuple[bool, str]]:
        answers = []
        for _ in range(2):
            answers.append((disk.write(path, bytes(5000)), disk.trouble))
            disk.check()
            answers.append((False, disk.trouble))
        return answers

    with files_of_at_most(1000):
        first = a_turn()
    told = disk.take_answers()
    second = a_turn()
    told_then = disk.take_answers()
    assert (bool(told), first[-1], second[-1]) == (True, (False, "takes no files of this size"), (False, ""))
    for past, then in ((told, first), (told_then, second)):
        disk.relive(past)
        assert a_turn() == then
    disk.relive(None)
    assert disk.write(path, b"x")
    assert disk.take_answers()[-1] == (True, "")
    assert disk.write(path, b"x")
    assert disk.take_answers() == []


def test_records_that_a_disk_does_not_take_wait_for_it_and_none_is_torn(tmp_path: Path) -> None:
    path = tmp_path / "journal.bin"
    records = [bytes([n]) * 300 for n in range(60)]
    file = RecordFile(path)
    for n, record in enumerate(records):
        with files_of_at_most(2000) if 10 <= n < 45 else nullcontext():
            file.put(record)
        if n == 40:
            assert file.error
            assert [r for r, _ in read_records(path)] == records[:len(list(read_records(path)))]
    assert file.error == ""
    with pytest.raises(BlockingIOError):
        RecordFile(path)
    file.close()
    assert [r for r, _ in read_records(path)] == records
    assert RecordFile(path).size_bytes == path.stat().st_size


def test_a_flight_whose_last_words_find_no_room_says_so_and_keeps_what_there_was(tmp_path: Path) -> None:
    run, jpeg = RunFolder(tmp_path / "run"), a_jpeg()
    run.root.mkdir()
    station = Station(Mission(title="t"), BOX, run, Voice(None))
    for chunk in chunks_of(jpeg, 1000):
        station.ingest.receive(2, chunk, SECOND_NS)
    before = run.views_csv.read_bytes()
    with files_of_at_most(10), pytest.raises(DiskError) as told:
        station.close()
    assert "takes no files of this size, and trajectories.npz, flight.json could not be written" in str(told.value)
    assert run.views_csv.read_bytes() == before
    assert not run.flight.exists()
    station.recorder.write(0)
    assert run.flight.is_file()


def test_a_full_disk_ends_a_process_in_one_sentence(caplog: pytest.LogCaptureFixture) -> None:
    def body() -> None:
        with open("/dev/full", "w") as file:
            file.write("x")

    def told() -> None:
        try:
            body()
        except OSError as e:
            raise OSError(e.errno, e.strerror, "/run/truth/referee.json") from e

    assert run_process(told) == 1
    assert caplog.messages == ["/run/truth/referee.json: the disk is full; make space or mend it."]


def test_checkpoints_go_on_once_there_is_room(tmp_path: Path) -> None:
    run, mission = RunFolder(tmp_path), Mission(title="t")
    station, kept = Station(mission, BOX, run, Voice(None)), Checkpoints(run, mission, BOX)
    with files_of_at_most(1000):
        kept.spent(1.0, station, 123)
    assert kept.read(Voice(None)) is None
    kept.spent(100.0, station, 124)
    found = Checkpoints(run, mission, BOX).read(Voice(None))
    assert found is not None
    assert found[1] == 124
    assert not list(run.checkpoint.glob("*.part"))


def test_what_the_run_folder_cannot_keep_is_not_acknowledged_and_asked_for_again(tmp_path: Path) -> None:
    run, jpeg = RunFolder(tmp_path / "run"), a_jpeg()
    run.root.mkdir()
    ingest = Ingest(run, SITE, EPOCH, HOMES)
    ingest.overdue(SECOND_NS)
    with files_of_at_most(100):
        for chunk in chunks_of(jpeg, 1000):
            assert ingest.receive(2, chunk, SECOND_NS) == (None, None)
        assert ingest.trouble == "takes no files of this size"
        assert ingest.overdue(3 * SECOND_NS) == []
    count = len(chunks_of(jpeg, 1000))
    [(vehicle_id, ack)] = ingest.overdue(5 * SECOND_NS)
    assert (vehicle_id, ack.missing, ingest.trouble) == (2, list(range(count)), "")
    answers = [ingest.receive(2, chunk, 5 * SECOND_NS) for chunk in chunks_of(jpeg, 1000)]
    assert answers[-1][0] == PictureAck(view_id=5, sha256=ack.sha256)
    ingest.close()
    with run.views_csv.open() as f:
        assert [r["view_id"] for r in csv.DictReader(f)] == ["5"]


def test_a_vehicle_whose_card_is_gone_holds_keeps_its_picture_and_goes_on_with_another_card(tmp_path: Path) -> None:
    world = World(mission(), tmp_path, acknowledge=False)
    world.share_map(open_map(world.mission))
    vehicle, card = world.vehicles[1], tmp_path / "1"
    world.upload(route([(0, -10, 5), (4, -10, 5), (8, -10, 5)]), 1)
    shutil.rmtree(card)
    assert world.run(60, lambda: world.views() == [100])
    assert world.run(3, lambda: vehicle.executor.mode == "hold")
    world.run(10)
    assert world.views() == [100]
    assert vehicle.camera.owed == 1
    assert {c.meta.view_id for c in world.chunks} == {100}
    card.mkdir()
    assert world.run(60, lambda: len(world.views()) == 3)
    world.run(1)
    assert sorted(p.name for p in card.glob("*.jpg")) == ["explore_100.jpg", "explore_101.jpg", "explore_102.jpg"]
    meta = world.chunks[0].meta
    world.send(1, topics.PICTURE_ACK, PictureAck(view_id=100, sha256=meta.sha256))
    world.run(1)
    assert (card / "explore_100.ack").exists()
