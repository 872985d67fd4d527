"""`swarmscan missions export`: what the vehicles of a run flew, for QGroundControl, Mission Planner and globes.

One file per vehicle and sortie: every picture with the gimbal's pitch, the ways between as they were flown, the
geofence (not in waypoint files) and the return. Take off before starting the mission. Altitudes are above the
sea if the mission's site.origin_alt_m is. With --format mcap one recording of the whole run, for Foxglove.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ground_station.flown_plan import FlownPlan, flown_plans
from ground_station.mcap_export import write_recording
from ground_station.report.run_data import RunData, read_run
from missions.console import print_rows
from missions.errors import UserError
from missions.kml import write_kml
from missions.qgc_plan import write_plan
from missions.run_folder import RunFolder
from missions.waypoint_file import write_waypoints

PHASES = ("survey", "explore")
FORMATS = ("plan", "waypoints", "kml", "mcap")


def main(argv: list[str] | None = None) -> int:
    """The command; says what it wrote."""
    options = _parser().parse_args(argv)
    data = read_run(RunFolder(options.run))
    if options.format == "mcap":
        print_rows(_recording(data, options.out or data.run.recording), options.json)
        return 0
    phase = options.phase or next((p for p in PHASES if any(v.phase == p for v in data.views)), PHASES[0])
    rows: list[dict[str, object]] = []
    for flown, path in _targets(options, _chosen(options, data, phase), phase):
        _write(path, flown, options.format, data)
        rows.append({"file": str(path), "vehicle": flown.vehicle_id, "sortie": flown.sortie, "phase": phase,
                     "pictures": flown.pictures, "items": len(flown.plan.mission)})
    print_rows(rows, options.json)
    return 0


def _recording(data: RunData, path: Path) -> list[dict[str, object]]:
    """Topics of the recording and how many messages went out on each."""
    try:
        counts = write_recording(data, path)
    except OSError as e:
        raise _unwritable(path, e) from e
    return [{"file": str(path), "topic": topic, "messages": count} for topic, count in counts.items()]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="swarmscan missions export", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="a run folder")
    parser.add_argument("--format", choices=FORMATS, default=FORMATS[0], help="default %(default)s")
    parser.add_argument("--phase", choices=PHASES, help="whose pictures; default: the survey's, if there are any")
    parser.add_argument("--vehicle", type=int, metavar="N", help="this vehicle alone")
    parser.add_argument("--out", type=Path, metavar="FILE",
                        help="where one vehicle's plan goes; default RUN/plans/uavN_PHASE.FORMAT for each, "
                             "RUN/run.mcap for a recording")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")
    return parser


def _chosen(options: argparse.Namespace, data: RunData, phase: str) -> list[FlownPlan]:
    vehicles = data.mission.fleet.vehicles
    if options.vehicle is not None and not 1 <= options.vehicle <= vehicles:
        raise UserError(f"--vehicle {options.vehicle}: the run's vehicles are 1 to {vehicles}; give one of these.")
    plans = [p for p in flown_plans(data, phase) if options.vehicle in (None, p.vehicle_id)]
    if not plans:
        whose = "" if options.vehicle is None else f" of vehicle {options.vehicle}"
        raise UserError(f"{data.run.views_csv}: holds no picture{whose} in phase {phase!r}; give another --phase or "
                        "--vehicle.")
    return plans


def _targets(options: argparse.Namespace, plans: list[FlownPlan], phase: str) -> list[tuple[FlownPlan, Path]]:
    """Each plan with its file."""
    if options.out is not None:
        if len(plans) > 1:
            raise UserError(f"--out {options.out}: there are {len(plans)} plans (one per vehicle and sortie); choose "
                            "a vehicle with --vehicle, or leave --out out.")
        return [(plans[0], options.out)]
    folder = RunFolder(options.run).plans
    return [(p, folder / f"uav{p.vehicle_id}_{phase}{f'_sortie{p.sortie}' if p.sortie > 1 else ''}.{options.format}")
            for p in plans]


def _write(path: Path, flown: FlownPlan, kind: str, data: RunData) -> None:
    try:
        if kind == "plan":
            write_plan(path, flown.plan, data.mission.fleet.speed_m_s)
        elif kind == "waypoints":
            write_waypoints(path, flown.plan.home, flown.plan.mission)
        else:
            write_kml(path, flown.plan, f"{data.mission.title}: vehicle {flown.vehicle_id}")
    except OSError as e:
        raise _unwritable(path, e) from e


def _unwritable(path: Path, error: OSError) -> UserError:
    return UserError(f"{path}: cannot be written ({error}); give a path in a folder that exists with --out.")
