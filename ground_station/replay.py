"""`swarmscan replay RUN`: a finished or broken run once more, from its journal: the same decisions, or where they part.

The ground station hears again what it heard, and decides again; what it says is compared with what it said then. With
--live the page shows it, at any speed. Nothing in the run's folder is touched.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from rich.progress import Progress as Bar

from ground_station.journal import count_turns, journalled_mission, read_turns
from ground_station.live.playback import Playback
from ground_station.live.start import add_live_options, live_page
from ground_station.processes import free_endpoint
from ground_station.station import Station
from ground_station.voice import Voice
from missions.bus import Bus
from missions.clock import BRIDGE, SECOND_NS
from missions.messages import SiteBrief
from missions.mission import Mission
from missions.run_folder import RunFolder

FLEET = "replay"


def main(argv: list[str] | None = None) -> int:
    """The command: 0 when all decisions are the same, 1 when they part, 2 for bad input."""
    options = _parse(argv)
    run = RunFolder(Path(options.run))
    mission, head = journalled_mission(run)
    with _station(run, mission, head.site, options) as (station, playback), Bar(disable=options.json) as bar:
        task = bar.add_task("replay", total=count_turns(run.journal))
        result = _compare(run, station, playback, lambda: bar.advance(task))
    if options.json:
        sys.stdout.write(json.dumps(result, indent=2) + "\n")
    elif result["parted_at_turn"] is None:
        sys.stdout.write(f"{result['turns']} turns, {result['simulated_s']} s: every decision is the same\n")
    else:
        sys.stdout.write(f"decisions part at {result['simulated_s']} s, in turn {result['parted_at_turn']}\n")
    return 0 if result["parted_at_turn"] is None else 1


def _compare(run: RunFolder, station: Station, playback: Playback, advance: Any) -> dict[str, Any]:
    """Turn by turn, as fast as those who watch want it, until the end or until decisions part: what was heard after
    that answers to what this station has not said."""
    turns, t_ns, parted = 0, 0, None
    for turn, said in read_turns(run):
        t_ns = turn.t_ns
        playback.wait_for(t_ns)
        turns += 1
        if station.live_through(turn) != said:
            parted = turn.tick
            break
        advance()
    return {"turns": turns, "simulated_s": t_ns / SECOND_NS, "parted_at_turn": parted}


@contextmanager
def _station(run: RunFolder, mission: Mission, site: SiteBrief,
             options: argparse.Namespace) -> Iterator[tuple[Station, Playback]]:
    endpoint = free_endpoint()
    with tempfile.TemporaryDirectory() as scratch, Bus(BRIDGE, FLEET, listen=endpoint) as bus:
        station = Station(mission, site, run, Voice(bus, steers=False), writes=RunFolder(Path(scratch)))
        playback = Playback(station, bus, options.speed if options.live else 0.0, options.live and options.wait)
        with closing(station), live_page(endpoint, FLEET, options.port) if options.live else nullcontext():
            yield station, playback


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="swarmscan replay", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", help="run folder")
    add_live_options(parser)
    parser.add_argument("--speed", type=float, default=4.0,
                        help="with --live, simulated seconds per wall second; 0 is as fast as possible "
                        "(default %(default)s)")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")
    return parser.parse_args(argv)
