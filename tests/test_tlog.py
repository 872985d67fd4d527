"""Telemetry logs: read by pymavlink's own reader and by mavlogdump.py, also when the writer died."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mav

from missions.clock import SECOND_NS
from missions.mavlink import Endpoint
from missions.signing import Signing
from missions.tlog import Tlog

EPOCH, EPOCH_S = "2026-06-01T09:30:00+00:00", 1_780_306_200.0


def heartbeat(vehicle_id: int, signing: Signing | None = None) -> bytes:
    return Endpoint(vehicle_id, 1, signing).pack(mav.MAVLink_heartbeat_message(2, 12, 129, 50593792, 4, 3))


def text(words: str) -> bytes:
    return Endpoint(1, 1).pack(mav.MAVLink_statustext_message(6, words.encode()))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "flight.tlog"
    tlog = Tlog(path, EPOCH)
    tlog.write([heartbeat(1), heartbeat(2)], 0)
    tlog.write([], SECOND_NS // 2)
    tlog.write([text("armed"), heartbeat(2, Signing(bytes(32)))], 3 * SECOND_NS // 2)
    tlog.flush()
    return path


def read(path: Path) -> list[tuple[float, int, str]]:
    """(seconds since 1970, system, type) of every record, by pymavlink."""
    reader, out = mavutil.mavlink_connection(str(path), dialect="common"), []
    while (message := reader.recv_msg()) is not None:
        out.append((message._timestamp, message.get_srcSystem(), message.get_type()))
    reader.close()
    return out


def test_pymavlink_reads_every_frame_with_its_simulated_time(log: Path) -> None:
    assert read(log) == [(EPOCH_S, 1, "HEARTBEAT"), (EPOCH_S, 2, "HEARTBEAT"), (EPOCH_S + 1.5, 1, "STATUSTEXT"),
                         (EPOCH_S + 1.5, 2, "HEARTBEAT")]


def test_mavlogdump_reads_it(log: Path) -> None:
    tool = Path(sys.executable).parent / "mavlogdump.py"
    out = subprocess.run([sys.executable, str(tool), "--format", "json", "--types", "STATUSTEXT", str(log)],
                         capture_output=True, text=True, check=True).stdout
    assert [json.loads(line)["data"]["text"] for line in out.splitlines()] == ["armed"]


def test_what_was_written_before_a_crash_is_there(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    tlog = Tlog(path, EPOCH)
    for second in range(5):
        tlog.write([heartbeat(1)], second * SECOND_NS)
    assert len(read(path)) == 5
    half = path.read_bytes()[:-7]
    path.write_bytes(half)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert len(read(path)) == 4
