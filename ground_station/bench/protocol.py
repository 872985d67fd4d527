"""`swarmscan bench protocol`: what other ground stations get from vehicles behind a door, on this machine.

Uploads: a mission sent to one vehicle through a link that loses, repeats (5 %), reorders (5 %) and delays (10 ms each
way), proven by reading it back. Fleets: seconds until a client that has just come knows all vehicles, and afterwards
messages, bytes and processor time per vehicle and second. Simulated time runs at the pace of the wall's.
"""

from __future__ import annotations

import argparse
import logging
import math
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
import trimesh
from pymavlink.dialects.v20 import common as mav
from rich.console import Console, Group
from rich.progress import track
from rich.table import Table

from ground_station.processes import Flight, free_endpoint, process_table
from missions.console import print_result
from missions.errors import LinkError
from missions.mavlink import AUTOPILOT_COMPONENT, Item, Route, Waypoint, items_from_route
from missions.mavlink_link import MavlinkLink, run
from missions.mission import FleetSpec, MavlinkSpec, Mission
from missions.mission_file import write_mission
from missions.mission_transfer import VerifiedUpload
from missions.run_folder import RunFolder
from missions.simulation import ClockSpec, SceneSpec

LOSSES, VEHICLES, ITEMS, REPEATS = (0.0, 0.05, 0.1, 0.2, 0.3), (1, 10, 50), 100, 3
LATENCY_MS, ODD = 10.0, 0.05
UPLOAD_S, START_S, WATCH_S = 180.0, 300.0, 10.0
HOUSE_M, RING_M, RING_UP_M = (6.0, 6.0, 5.0), 9.0, 5.0
PADS_PER_ROW, PAD_SPACING_M, FIRST_PAD_M = 10, 3.0, (0.0, -9.0, 0.15)


@dataclass(frozen=True)
class UploadRow:
    """Uploads over one kind of link: seconds until proven, the shortest, the middle and the longest."""

    loss: float
    items: int
    proven: int
    tried: int
    least_s: float
    median_s: float
    most_s: float


@dataclass(frozen=True)
class FleetRow:
    """So many vehicles behind one door. Processor time in percent of one core; simulated_s per second of the wall."""

    vehicles: int
    discovery_s: float
    simulated_s: float
    messages_per_vehicle_s: float
    kilobytes_per_vehicle_s: float
    cpu_per_vehicle_percent: float
    cpu_bridge_percent: float


def main(argv: list[str] | None = None) -> int:
    """The benchmark."""
    options = _parser().parse_args(argv)
    logging.getLogger("ground_station").setLevel(logging.ERROR)
    console = Console(stderr=True, quiet=options.json)
    fleets = [_fleet(n) for n in track(options.vehicles, "fleets", console=console)]
    uploads = _uploads(options, console)
    document = {"uploads": uploads, "fleets": fleets}
    print_result(document, Group(_table("uploads", uploads), _table("fleets", fleets)), options.json)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="swarmscan bench protocol", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loss", type=float, nargs="*", default=LOSSES, help="shares of datagrams lost each way")
    parser.add_argument("--vehicles", type=int, nargs="*", default=VEHICLES, help="fleets to look at")
    parser.add_argument("--items", type=int, default=ITEMS, help="items of the mission (default %(default)s)")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="uploads per link (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")
    return parser


def _uploads(options: argparse.Namespace, console: Console) -> list[UploadRow]:
    if not options.loss:
        return []
    items = ring(options.items, Mission(title="bench"))
    with _behind_a_door(1) as (port, _):
        with _client(port) as link:
            _know(link, 1, START_S)
        rows = []
        for loss in track(options.loss, "uploads", console=console):
            took_s = [_upload(port, loss, seed, items) for seed in range(options.repeats)]
            proven = [s for s in took_s if s is not None]
            of_them = proven or [math.nan]
            rows.append(UploadRow(loss, len(items), len(proven), len(took_s), round(min(of_them), 2),
                                  round(statistics.median(of_them), 2), round(max(of_them), 2)))
    return rows


def ring(count: int, mission: Mission) -> list[Item]:
    """A mission of so many items: waypoints around the house, to be passed."""
    angles = [2.0 * math.pi * n / max(1, count - 1) for n in range(count - 1)]
    corners = [Waypoint(position_enu_m=(RING_M * math.cos(a), RING_M * math.sin(a), RING_UP_M), yaw_enu_rad=0.0,
                        stop=False, pass_m=0.5) for a in angles]
    items = [i for i in items_from_route(Route(plan_id=1, phase="survey", waypoints=corners), mission.site.anchor)
             if i.command != mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW]
    return items[:count]


def _upload(port: int, loss: float, seed: int, items: list[Item]) -> float | None:
    """Seconds until the mission is proven to be there; None when it was not."""
    with _lossy(port, loss, seed) as near, _client(near) as link:
        begin_s = time.monotonic()
        transfer = VerifiedUpload(items, 1, begin_s + UPLOAD_S)
        run(link, transfer)
        if transfer.outcome == "refused":
            raise LinkError(f"the mission of the benchmark was refused: {transfer.reason}.")
        return time.monotonic() - begin_s if transfer.outcome == "done" else None


def _fleet(vehicles: int) -> FleetRow:
    with _behind_a_door(vehicles) as (port, flight):
        with _client(port) as first:
            _know(first, vehicles, START_S)
        with _client(port) as link:
            discovery_s = _know(link, vehicles, START_S)
            processes = {name: psutil.Process(child.pid) for name, child in flight.running.items()}
            before = {name: _cpu_s(p) for name, p in processes.items()}
            messages, size, simulated_s, seconds = _watch(link)
            used = {name: (_cpu_s(p) - before[name]) / seconds * 100.0 for name, p in processes.items()}
    bridge = used.pop("bridge")
    return FleetRow(vehicles, round(discovery_s, 2), round(simulated_s / seconds, 2),
                    round(messages / seconds / vehicles, 1), round(size / 1000 / seconds / vehicles, 2),
                    round(statistics.mean(used.values()), 1), round(bridge, 1))


def _know(link: MavlinkLink, vehicles: int, within_s: float) -> float:
    """Seconds until the heartbeats of all vehicles have been heard. Raises LinkError."""
    begin_s = time.monotonic()
    known: set[int] = set()
    while len(known) < vehicles:
        if time.monotonic() > begin_s + within_s:
            raise LinkError(f"{link.url}: {len(known)} of {vehicles} vehicles were heard within {within_s:.0f} s.")
        known |= {m.get_srcSystem() for m in link.receive()
                  if m.get_type() == "HEARTBEAT" and m.get_srcComponent() == AUTOPILOT_COMPONENT}
    return time.monotonic() - begin_s


def _watch(link: MavlinkLink) -> tuple[int, int, float, float]:
    """Messages, their bytes, simulated seconds and seconds that have gone by."""
    begin_s, messages, size, boot_ms = time.monotonic(), 0, 0, []
    while time.monotonic() < begin_s + WATCH_S:
        for m in link.receive():
            messages, size = messages + 1, size + len(m.get_msgbuf())
            if m.get_type() == "ATTITUDE":
                boot_ms.append(m.time_boot_ms)
    return messages, size, (max(boot_ms) - min(boot_ms)) / 1000.0, time.monotonic() - begin_s


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


@contextmanager
def _behind_a_door(vehicles: int) -> Iterator[tuple[int, Flight]]:
    """A house, so many vehicles beside it, and the port of their door."""
    port = _free_port()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "house.ply"
        house = trimesh.creation.box(HOUSE_M)
        house.apply_translation((0.0, 0.0, HOUSE_M[2] / 2.0))
        house.export(path)
        x, y, z = FIRST_PAD_M
        pads = [(x + PAD_SPACING_M * (n % PADS_PER_ROW), y - PAD_SPACING_M * (n // PADS_PER_ROW), z)
                for n in range(vehicles)]
        mission = Mission(title="bench", knowledge="mesh", scene=SceneSpec(path=str(path), surroundings=False),
                          fleet=FleetSpec(vehicles=vehicles, takeoff_enu_m=pads), clock=ClockSpec(speed=1.0),
                          mavlink=MavlinkSpec(open=[f"udpin://127.0.0.1:{port}"]))
        folder_of_run = RunFolder(Path(folder) / "run")
        folder_of_run.root.mkdir()
        write_mission(mission, folder_of_run.mission)
        flight = Flight(process_table(mission, folder_of_run, free_endpoint(), "bench", ground=False), folder_of_run,
                        keep={})
        try:
            yield port, flight
        finally:
            flight.stop()


@contextmanager
def _lossy(port: int, loss: float, seed: int) -> Iterator[int]:
    """The port of a bad link to the door."""
    near = _free_port()
    command = [sys.executable, "-m", "sim_bridge.faults", "--listen", f"127.0.0.1:{near}", "--to", f"127.0.0.1:{port}",
               "--loss", str(loss), "--duplicates", str(ODD), "--reordered", str(ODD), "--latency-ms", str(LATENCY_MS),
               "--seed", str(seed)]
    proxy = subprocess.Popen(command, stderr=subprocess.PIPE)
    try:
        assert proxy.stderr is not None, "it was asked for"
        proxy.stderr.readline()  # says where it listens, once it does
        yield near
    finally:
        proxy.terminate()
        proxy.communicate()


def _client(port: int) -> MavlinkLink:
    return MavlinkLink(f"udpout://127.0.0.1:{port}")


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def _table(title: str, rows: Sequence[UploadRow | FleetRow]) -> Table:
    table = Table(title=title)
    for name in vars(rows[0]) if rows else ():
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(*(str(v) for v in vars(row).values()))
    return table
