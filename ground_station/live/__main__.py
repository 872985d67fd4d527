"""`swarmscan live`: the live page of a mission under way, as a process."""

from __future__ import annotations

import argparse
import logging
import sys
import time

from ground_station.live.client import connect
from ground_station.live.page import LivePage
from ground_station.live.start import DEFAULT_PORT
from missions.process import end_when_told, run_process

log = logging.getLogger(__name__)

LAST_LOOK_S = 2.0
"""The end of the mission is shown for a moment before the page goes with it."""


def main(argv: list[str] | None = None) -> int:
    """Serve on 127.0.0.1 until the mission is over."""
    parser = argparse.ArgumentParser(prog="swarmscan live", description=__doc__)
    parser.add_argument("run", nargs="?", default="", help="the run folder of a mission that flies on this machine")
    parser.add_argument("--connect", default="", help="or where its bus is, such as tcp/127.0.0.1:7447")
    parser.add_argument("--fleet", default="default", help="name of the fleet on the bus (default %(default)s)")
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help="where to serve (default %(default)s)")
    options = parser.parse_args(argv)
    return run_process(lambda: _serve(options))


def _serve(options: argparse.Namespace) -> None:
    end_when_told()
    with connect(options.run, endpoint=options.connect, fleet=options.fleet) as mission:
        page = LivePage(mission, options.port)
        log.info("live page: http://127.0.0.1:%d", page.port)
        page.serve()
        time.sleep(LAST_LOOK_S)
        page.close()


if __name__ == "__main__":
    sys.exit(main())
