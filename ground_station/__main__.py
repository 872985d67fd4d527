"""`python -m ground_station MISSION.toml --run RUN_DIR`: the ground station of one mission, as a process."""

from __future__ import annotations

import argparse
import logging
import sys
from contextlib import nullcontext

from ground_station.checkpoint import Checkpoints
from ground_station.duty import Duty, take_part
from ground_station.journal import Journal
from ground_station.live.start import add_live_options, live_page
from ground_station.progress import Progress
from ground_station.station import Station
from ground_station.survey_views import check_survey
from ground_station.voice import Voice
from missions.bus import DEFAULT_ENDPOINT, Bus
from missions.clock import GROUND
from missions.mission import Mission, without_scene
from missions.mission_file import find_mission, load_mission
from missions.process import end_when_told, process_parser, run_process
from missions.run_folder import RunFolder


def main(argv: list[str] | None = None) -> int:
    """Fly the mission. 2 for what the user can mend, 1 for what went wrong on the way."""
    options = _parse(argv)
    return run_process(lambda: _open(options))


def _open(options: argparse.Namespace) -> None:
    end_when_told()
    if options.quiet:
        logging.getLogger().setLevel(logging.WARNING)
    mission = without_scene(load_mission(find_mission(options.mission)))
    check_survey(mission)
    page = live_page(options.connect, options.fleet, options.port) if options.live else nullcontext()
    with Bus(GROUND, options.fleet, connect=options.connect) as bus, page, Progress(options.quiet) as progress:
        fly(mission, RunFolder(options.run), bus, progress, options.wait)


def fly(mission: Mission, run: RunFolder, bus: Bus, progress: Progress, wait: bool = False) -> None:
    """Join the clock and run the mission to its end; whatever is known is written down, however it ends. wait: time
    begins when an operator says so."""
    clock, site = take_part(bus, mission)
    station = Station(mission, site, run, Voice(bus), wait)
    journal = Journal.begin(run.journal, mission.mission_hash, site, wait)
    Duty(clock, station, bus, journal, Checkpoints(run, mission, site), run).serve(progress)


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = process_parser("ground-station", __doc__ or "")
    parser.add_argument("--connect", default=DEFAULT_ENDPOINT, help="where sim_bridge listens (default %(default)s)")
    add_live_options(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress display")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
