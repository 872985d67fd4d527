"""`python -m ground_station MISSION.toml --run RUN_DIR`: the ground station of one mission, as a process."""

from __future__ import annotations

import argparse
import logging
import signal
import sys
from typing import Any

from ground_station.director import Director
from ground_station.fleet import Fleet
from ground_station.ingest import Ingest
from ground_station.prior import open_prior
from ground_station.progress import Progress
from ground_station.recorder import Recorder
from ground_station.survey_views import check_survey
from missions import topics
from missions.bus import DEFAULT_ENDPOINT, Bus
from missions.clock import GROUND, SimClock
from missions.mission import Mission, without_scene
from missions.mission_file import find_mission, load_mission
from missions.process import process_parser, run_process, uninterrupted
from missions.run_folder import RunFolder

HEARD: tuple[topics.Topic[Any], ...] = (
    topics.MAVLINK_UP, topics.PLAN_VERDICT, topics.LEG_REPORT, topics.PICTURE_CHUNK, topics.RANGE_HITS,
    topics.VEHICLE_STATE)


def main(argv: list[str] | None = None) -> int:
    """Fly the mission. 2 for what the user can mend, 1 for what went wrong on the way."""
    options = _parse(argv)
    return run_process(lambda: _open(options))


def _open(options: argparse.Namespace) -> None:
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if options.quiet:
        logging.getLogger().setLevel(logging.WARNING)
    mission = without_scene(load_mission(find_mission(options.mission)))
    check_survey(mission)
    with Bus(GROUND, options.fleet, connect=options.connect) as bus, Progress(options.quiet) as progress:
        fly(mission, RunFolder(options.run), bus, progress)


def fly(mission: Mission, run: RunFolder, bus: Bus, progress: Progress) -> None:
    """Join the clock and run the mission to its end; whatever is known is written down, however it ends."""
    for topic in HEARD:
        bus.subscribe(topic)
    clock = SimClock(bus, mission.mission_hash)
    site = clock.join()
    anchor = mission.site.anchor
    mapped = ("explore", "survey") if mission.survey.refine else ("explore",)
    ingest, recorder = Ingest(run, anchor, mission.clock.epoch_utc, mapped), Recorder(run, mission, site)
    fleet = Fleet(mission, site, bus, ingest, recorder)
    try:
        director = Director(mission, site, fleet, bus, recorder, open_prior(mission, run, site))
        while True:
            turn = clock.next()
            fleet.receive(turn)
            director.step()
            wake_ns = fleet.send()
            if progress.due(director.phase):
                status = director.status()
                bus.publish(topics.STATUS, status)
                progress.show(status)
            if turn.stop or director.phase == "over":
                break
            clock.done(wake_ns)
        if turn.stop:
            recorder.note(turn.t_ns, "the clock was stopped before the mission was over")
        clock.leave()
    finally:
        with uninterrupted():
            recorder.write(fleet.t_ns)
            ingest.close()
            run.write_process_record(GROUND, messages_sent=bus.sent)


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = process_parser("ground-station", __doc__ or "")
    parser.add_argument("--connect", default=DEFAULT_ENDPOINT, help="where sim_bridge listens (default %(default)s)")
    parser.add_argument("--quiet", action="store_true", help="no progress display")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
