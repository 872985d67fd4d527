"""`swarmscan resume RUN`: takes up a mission whose ground station was killed, while bridge and vehicles go on.

The station as it was is read from the newest checkpoint, lives through the turns that the journal has after it, and
takes part in the clock again. Vehicles fly the plans that they have accepted meanwhile.
"""

from __future__ import annotations

import argparse
import logging
import signal
import sys
import time
from contextlib import nullcontext
from pathlib import Path

from ground_station.after_flight import in_charge, run_stages
from ground_station.checkpoint import Checkpoints
from ground_station.duty import Duty, take_part
from ground_station.journal import Head, Journal, journalled_mission, read_turns
from ground_station.live.start import DEFAULT_PORT, live_page
from ground_station.progress import Progress
from ground_station.station import Station
from ground_station.voice import Voice
from missions.bus import Bus
from missions.clock import BRIDGE, GROUND, SECOND_NS, vehicle_name
from missions.errors import LinkError, UserError
from missions.mission import Mission
from missions.process import run_process
from missions.run_folder import RunFolder

log = logging.getLogger(__name__)

OTHERS_END_S, POLL_S = 60.0, 0.1
"""After the flight; a vehicle that was lost is waited for in vain."""


def main(argv: list[str] | None = None) -> int:
    """The command: 0 when the mission flew to its end and was measured, 1 when something went wrong, 2 for bad
    input."""
    options = _parse(argv)
    return run_process(lambda: _take_up(options))


def _take_up(options: argparse.Namespace) -> int:
    begin = time.monotonic()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if options.quiet:
        logging.getLogger().setLevel(logging.WARNING)
    run = RunFolder(Path(options.run).resolve())
    mission, head = journalled_mission(run)
    endpoint = options.connect or _endpoint(run)
    with in_charge(run) as mine:
        page = live_page(endpoint, options.fleet, options.port) if options.live else nullcontext()
        with _bus(run, endpoint, options.fleet) as bus, page, Progress(options.quiet) as progress:
            journal, voice = Journal(run.journal), Voice(None)
            checkpoints = Checkpoints(run, mission, head.site)
            station = revive(checkpoints, head, voice)
            clock, _ = take_part(bus, mission)
            voice.bus = bus
            log.info("took the mission up again at %.1f s after %.2f s", station.fleet.t_ns / SECOND_NS,
                     time.monotonic() - begin)
            Duty(clock, station, bus, journal, checkpoints, run).serve(progress)
        if mine:
            _await_records(run, mission)
            return 0 if run_stages(run, mission, options.keep_depth) else 1
    log.info("swarmscan fly, which is still there, makes model and report")
    return 0


def revive(checkpoints: Checkpoints, head: Head, voice: Voice) -> Station:
    """The station as it was after the last turn that the journal has. Raises UserError."""
    run, mission = checkpoints.run, checkpoints.mission
    station, begin = checkpoints.read(voice) or (Station(mission, head.site, run, voice, head.waits), 0)
    parted_s = [turn.t_ns / SECOND_NS for turn, said in read_turns(run, begin) if station.live_through(turn) != said]
    if parted_s:
        log.warning("decisions part at %.1f s from those that were made; going on with the new ones", parted_s[0])
    return station


def _endpoint(run: RunFolder) -> str:
    if not run.endpoint.is_file():
        raise UserError(f"{run.endpoint}: missing; say where sim_bridge listens with --connect.")
    return run.endpoint.read_text(encoding="ascii").strip()


def _bus(run: RunFolder, endpoint: str, fleet: str) -> Bus:
    """Raises UserError where nothing flies any more."""
    try:
        return Bus(GROUND, fleet, connect=endpoint)
    except LinkError as e:
        raise UserError(f"{run.root}: nothing of this mission runs any more; what was received is kept, "
                        f"'swarmscan reconstruct {run.root}' makes the model of it.") from e


def _await_records(run: RunFolder, mission: Mission) -> None:
    """The bridge writes what is true after the flight; the model is measured against that."""
    names = [BRIDGE, *(vehicle_name(k) for k in range(1, mission.fleet.vehicles + 1))]
    end = time.monotonic() + OTHERS_END_S
    while time.monotonic() < end and not all(map(run.has_process_record, names)):
        time.sleep(POLL_S)


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="swarmscan resume", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", help="run folder")
    parser.add_argument("--connect", default="", help="where sim_bridge listens (default: as the run folder says)")
    parser.add_argument("--fleet", default="default", help="name of the fleet on the bus (default %(default)s)")
    parser.add_argument("--live", action="store_true", help="serve a live page on 127.0.0.1")
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help="of the live page (default %(default)s)")
    parser.add_argument("--quiet", action="store_true", help="no progress display")
    parser.add_argument("--keep-depth", action="store_true", help="keep the depth maps of the reconstruction")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
