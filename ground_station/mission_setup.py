"""What the command line makes of a mission file: the merged mission in a fresh run folder."""

from __future__ import annotations

import argparse
import json
from datetime import UTC, datetime
from pathlib import Path

from msgspec import structs

from ground_station.autopilots import autopilots_of
from missions.errors import UserError
from missions.mission import Mission
from missions.mission_file import find_mission, load_mission, write_mission
from missions.prior_file import load_prior
from missions.run_folder import RunFolder
from missions.scene_names import BUILT_IN, check_scene_name, is_scene_name
from missions.signing import read_key
from planning.trajectories.power import fit


def prepare(options: argparse.Namespace) -> tuple[Mission, RunFolder]:
    """The merged mission, written into a fresh run folder; what cannot be flown is refused before anything starts."""
    path = find_mission(options.mission)
    mission = _paced(load_mission(path, overrides(options)), options)
    if options.scene and not is_scene_name(options.scene) and not Path(options.scene).exists():
        raise UserError(f"--scene {options.scene}: neither a file or folder, nor one of {', '.join(BUILT_IN)}, nor a "
                        "family's scene such as family:girder_bridge:1; check the name.")
    if not mission.scene.path:
        check_scene_name(mission.scene.name)
    autopilots_of(getattr(options, "autopilot", []), mission)
    if mission.prior_path:
        load_prior(Path(mission.prior_path))
    if mission.mavlink.signing_key:
        read_key(Path(mission.mavlink.signing_key))
    fit(mission.airframe)
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    root = Path(options.run) if options.run else Path("runs") / f"{stamp}-{path.stem}"
    if root.exists() and any(root.iterdir()):
        raise UserError(f"--run {root}: the folder is not empty; give a fresh one.")
    root.mkdir(parents=True, exist_ok=True)
    run = RunFolder(root.resolve())
    write_mission(mission, run.mission)
    return mission, run


def _paced(mission: Mission, options: argparse.Namespace) -> Mission:
    """In real time where nobody says otherwise and somebody watches, or flies with an autopilot of its own."""
    watched = options.open or getattr(options, "live", False) or getattr(options, "autopilot", [])
    if mission.clock.speed > 0 or options.speed is not None or not watched:
        return mission
    return structs.replace(mission, clock=structs.replace(mission.clock, speed=1.0))


def overrides(options: argparse.Namespace) -> dict[str, str]:
    """Dotted field names and TOML values that the command line asks for."""
    out: dict[str, str] = {}
    for pair in options.set:
        key, equals, value = pair.partition("=")
        if not equals:
            raise UserError(f"--set {pair}: no '='; write --set section.field=value.")
        out[key.strip()] = value.strip()
    if options.scene:
        named = is_scene_name(options.scene)
        out["scene.path"] = json.dumps("" if named else str(Path(options.scene).resolve()))
        if named:
            out["scene.name"] = json.dumps(options.scene)
    if getattr(options, "views", ""):
        out |= {"explore.enabled": "false", "survey.enabled": "true", "survey.views": '"file"',
                "survey.views_path": json.dumps(str(Path(options.views).resolve()))}
    if options.open:
        out["mavlink.open"] = json.dumps(options.open)
    if options.identity:
        out["mavlink.identity"] = json.dumps(options.identity)
    if options.vehicles is not None:
        out["fleet.vehicles"] = str(options.vehicles)
    if options.speed is not None:
        out["clock.speed"] = str(options.speed)
    return out


def add_mission_options(parser: argparse.ArgumentParser) -> None:
    """What every command that runs a mission has."""
    parser.add_argument("mission", help="a mission file, or the name of one in missions/")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.FIELD=VALUE", help="override a field")
    parser.add_argument("--scene", default="",
                        help="a built-in structure, family:NAME:SEED, or a mesh file or scene folder")
    parser.add_argument("--run", default="", help="run folder (default runs/<UTC time>-<mission>)")
    parser.add_argument("--vehicles", type=int, help="number of vehicles")
    parser.add_argument("--speed", type=float, help="simulated seconds per wall second; 0 is as fast as possible "
                        "(where somebody watches or a real autopilot flies, 1 unless told otherwise)")
    parser.add_argument("--open", action="append", default=[], metavar="URL",
                        help="a door for other ground stations: udp://127.0.0.1:14550 speaks to who listens there, "
                        "udpin://127.0.0.1:14540 waits there; may be repeated")
    parser.add_argument("--identity", choices=("px4", "ardupilot"), help="which autopilot vehicles speak like there")
