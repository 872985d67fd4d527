"""`swarmscan fly`: every process of a mission on this machine, then the model, the measurements and the report."""

from __future__ import annotations

import argparse
import json
import logging
import sys

import msgspec

from ground_station.after_flight import in_charge, run_stages
from ground_station.autopilots import add_autopilot_option, autopilots_of
from ground_station.live.start import add_live_options, live_options
from ground_station.mission_setup import add_mission_options, prepare
from ground_station.processes import fly, free_endpoint, process_table
from missions.run_folder import RunFolder

log = logging.getLogger(__name__)


def main(argv: list[str] | None = None) -> int:
    """The command: 0 when the mission flew and was measured, 1 when something went wrong, 2 for bad input."""
    options = _parse(argv)
    mission, run = prepare(options)
    if not logging.getLogger().handlers:
        logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(name)s %(message)s")
    log.info("run folder %s", run.root)
    endpoint = free_endpoint()
    run.endpoint.write_text(endpoint, encoding="ascii")
    table = process_table(mission, run, endpoint, "default", live=live_options(options),
                          autopilots=autopilots_of(options.autopilot, mission))
    with in_charge(run):
        complaints = fly(table, run)
        if any(c.startswith(("ground ", "bridge ")) for c in complaints):
            log.error("the mission was cut short; what was received is kept in %s", run.root)
            return 1
        succeeded = run_stages(run, mission, options.keep_depth)
    _print_result(run, options.json)
    return 0 if succeeded else 1


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="swarmscan fly", description=__doc__)
    add_mission_options(parser)
    parser.add_argument("--views", default="", metavar="FILE", help="survey these views (CSV) without exploring")
    add_live_options(parser)
    add_autopilot_option(parser)
    parser.add_argument("--json", action="store_true", help="print metrics.json on stdout")
    parser.add_argument("--keep-depth", action="store_true", help="keep the depth maps of the reconstruction")
    return parser.parse_args(argv)


def _print_result(run: RunFolder, as_json: bool) -> None:
    metrics = msgspec.json.decode(run.metrics.read_bytes()) if run.metrics.is_file() else {}
    if as_json:
        sys.stdout.write(json.dumps(metrics, indent=2) + "\n")
        return
    coverage, c2c = metrics.get("coverage", {}), metrics.get("c2c", {}).get("completeness", {})
    fleet = metrics.get("fleet", {})
    lines = [f"collisions {metrics.get('collisions', 'unknown')}",
             f"coverage {coverage.get('final', 'unknown')} of a ceiling of {coverage.get('ceiling', 'unknown')}",
             f"C2C completeness at 0.25 m {c2c.get('0.25', 'unknown')}",
             f"makespan {fleet.get('makespan_s', 'unknown')} s, views flown {fleet.get('views_flown', 'unknown')}, "
             f"reassigned {fleet.get('views_reassigned', 'unknown')}",
             f"report {run.report}" if run.report.is_file() else f"run folder {run.root} (no report was written)"]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    sys.exit(main())
