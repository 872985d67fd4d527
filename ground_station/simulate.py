"""`swarmscan simulate`: a world and its vehicles without a ground station of ours, for those of others.

Like the simulators that come with autopilots: MAVProxy, QGroundControl and MAVSDK programs find the vehicles at the
doors that are given, arm them, fly them and take pictures, until the command is interrupted.
"""

from __future__ import annotations

import argparse
import logging
import sys

from ground_station.mission_setup import add_mission_options, prepare
from ground_station.processes import fly, free_endpoint, process_table

log = logging.getLogger(__name__)

DEFAULT_DOOR = "udp://127.0.0.1:14550"
"""Where ground stations listen by custom."""


def main(argv: list[str] | None = None) -> int:
    """The command: 0 when it was told to stop, 1 when a process failed, 2 for bad input."""
    parser = argparse.ArgumentParser(prog="swarmscan simulate", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    add_mission_options(parser)
    options = parser.parse_args(argv)
    options.open = options.open or [DEFAULT_DOOR]
    mission, run = prepare(options)
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(name)s %(message)s")
    table = process_table(mission, run, free_endpoint(), "default", ground=False)
    log.info("%d vehicles (%s) at %s; Ctrl-C ends them; logs in %s", mission.fleet.vehicles, mission.mavlink.identity,
             ", ".join(mission.mavlink.open), run.logs)
    try:
        complaints = fly(table, run)
    except KeyboardInterrupt:
        return 0
    return 1 if complaints else 0
