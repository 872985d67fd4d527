"""A vehicle process: `python -m vehicle MISSION.toml --id K --run RUN_DIR [--connect ENDPOINT] [--fleet NAME]`; with
`--autopilot mavlink:udpin://127.0.0.1:14540` it is the companion computer of a real autopilot."""

from __future__ import annotations

import argparse
import contextlib
import logging
import signal
import sys
from types import FrameType
from typing import Any

from missions import topics
from missions.bus import DEFAULT_ENDPOINT, Bus
from missions.clock import SimClock, vehicle_name
from missions.errors import LinkError, UserError
from missions.messages import SiteBrief
from missions.mission import Mission, without_scene
from missions.mission_file import find_mission, load_mission
from missions.pads import geofence
from missions.prior_file import load_prior, prior_file
from missions.process import process_parser, run_process
from missions.run_folder import RunFolder
from missions.topics import Topic
from planning.paths import MeshField, voxelised
from vehicle.aircraft_file import AircraftFile
from vehicle.external.companion import Companion
from vehicle.on_board import OnBoardFile, recall
from vehicle.sensor_memory import SensorMemory
from vehicle.vehicle import Vehicle

OWN: tuple[Topic[Any], ...] = (topics.MAVLINK_DOWN, topics.PLAN_HASH, topics.PICTURE_ACK, topics.BATTERY_SWAP,
                               topics.FENCE_ORDER, topics.SENSOR_PICTURE, topics.RANGE_SCAN, topics.DOOR_DOWN)
SHARED: tuple[Topic[Any], ...] = (topics.MAP_SNAPSHOT, topics.VEHICLE_STATE, topics.ANNOUNCED)
log = logging.getLogger("vehicle")


def main(argv: list[str] | None = None) -> int:
    """Fly until the clock says stop or the bridge is gone. Returns the exit code."""
    args = _parse(argv)
    return run_process(lambda: _open(args))


def _open(args: argparse.Namespace) -> None:
    signal.signal(signal.SIGTERM, _leave)
    signal.signal(signal.SIGINT, _leave)
    folder, name = RunFolder(args.run), vehicle_name(args.id)
    mission = without_scene(load_mission(find_mission(args.mission)))
    if not 1 <= args.id <= mission.fleet.vehicles:
        raise UserError(f"--id {args.id}: this mission has vehicles 1 to {mission.fleet.vehicles}; give one.")
    sent = 0
    try:
        with _companion(args, mission) as companion, Bus(name, args.fleet, connect=args.connect) as bus:
            try:
                _fly(bus, mission, args.id, folder, companion)
            finally:
                sent = bus.sent
    except LinkError as e:
        log.warning("%s", e)
    except _Leave:
        log.info("%s: told to leave", name)
    finally:
        folder.write_process_record(name, messages_sent=sent)


def _companion(args: argparse.Namespace, mission: Mission) -> contextlib.AbstractContextManager[Companion | None]:
    return Companion(args.autopilot, args.id, mission) if args.autopilot else contextlib.nullcontext()


def _fly(bus: Bus, mission: Mission, vehicle_id: int, folder: RunFolder, companion: Companion | None) -> None:
    for topic in OWN:
        bus.subscribe(topic, vehicle_id)
    for topic in SHARED:
        bus.subscribe(topic)
    patience_s = 0.0 if companion is not None else mission.clock.world_wait_s  # a real aircraft comes home instead
    clock = SimClock(bus, mission.mission_hash, patience_s)
    site = clock.join()
    memory = SensorMemory.of(mission, site, open_prior(mission, folder, site))
    aircraft = companion.aircraft(site) if companion is not None else (None, None)
    vehicle = Vehicle(mission, site, vehicle_id, folder.sd_card(vehicle_id), memory, *aircraft)
    vehicle.camera.remember()
    if companion is not None:
        companion.carries(vehicle)
        _serve(bus, clock, vehicle)
        return
    on_board = OnBoardFile(folder.on_board(vehicle_id), mission.mission_hash)
    with contextlib.closing(AircraftFile(folder.aircraft(vehicle_id), mission.mission_hash)) as aircraft_file:
        _serve(bus, clock, vehicle, aircraft_file, on_board)


def _serve(bus: Bus, clock: SimClock, vehicle: Vehicle, aircraft_file: AircraftFile | None = None,
           on_board: OnBoardFile | None = None) -> None:
    """Turn after turn. aircraft_file: stands for a simulated aircraft while no process flies it, as on_board does for
    what it knew."""
    found = aircraft_file.found if aircraft_file is not None else None
    while not (turn := clock.next()).stop:
        if found is not None:
            if on_board is not None and on_board.found is not None:
                recall(vehicle, on_board.found)
            vehicle.find(found, turn.t_ns)
            found = None
        for topic, message, who in vehicle.step(turn.t_ns, turn.deliveries, turn.participants):
            bus.publish(topic, message, who)
        clock.done(vehicle.wake_ns)
        if aircraft_file is not None:
            aircraft_file.write(vehicle.aircraft)
        if on_board is not None:
            on_board.keep(vehicle, turn.t_ns)


def open_prior(mission: Mission, folder: RunFolder, site: SiteBrief) -> MeshField | None:
    """The operator's model in the geofence; None where nothing is known before. Raises UserError."""
    path = prior_file(mission, folder)
    if path is None:
        return None
    mesh = load_prior(path)
    voxels = voxelised(mesh.vertices, mesh.faces, *geofence(mission, site), mission.explore.voxel_m)
    return MeshField.from_mesh(mesh.vertices, mesh.faces, voxels)


class _Leave(Exception):  # noqa: N818 - a request, not an error
    pass


def _leave(number: int, frame: FrameType | None) -> None:
    for told_once in (signal.SIGTERM, signal.SIGINT):
        signal.signal(told_once, signal.SIG_IGN)
    raise _Leave


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = process_parser("vehicle", "One drone.")
    parser.add_argument("--id", type=int, required=True, help="1 to fleet.vehicles")
    parser.add_argument("--connect", default=DEFAULT_ENDPOINT, help="where sim_bridge listens (default %(default)s)")
    parser.add_argument("--autopilot", default="", metavar="URL",
                        help="fly the real autopilot at mavlink:udpin://HOST:PORT, mavlink:udpout://HOST:PORT, "
                             "mavlink:tcp://HOST:PORT or mavlink:serial://DEVICE:BAUD")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
