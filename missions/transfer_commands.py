"""`swarmscan missions upload FILE --to URL` and `missions download FILE --from URL`: plans to and from vehicles.

An upload is proven by reading it back. The link may lose, repeat and reorder packets; what is not proven in time has
failed, and a vehicle never flies a part of a plan that it did not get whole.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pymavlink.dialects.v20 import common as mav
from rich.console import Console
from rich.progress import Progress

from missions.console import print_rows
from missions.errors import LinkError, UserError
from missions.flight_plan import FlightPlan, home_item, with_wire_frames
from missions.mavlink import Item
from missions.mavlink_link import MavlinkLink, home_position, run, vehicles
from missions.mission_transfer import Download, VerifiedUpload, as_ardupilot_keeps, canonical_sha256, exactly
from missions.qgc_plan import read_plan, write_plan
from missions.signing import Signing, read_key
from missions.waypoint_file import read_waypoints, write_waypoints

TYPES = {"fence": mav.MAV_MISSION_TYPE_FENCE, "rally": mav.MAV_MISSION_TYPE_RALLY,
         "mission": mav.MAV_MISSION_TYPE_MISSION}
"""In the order in which they are sent: where a vehicle may fly, before what it flies."""
LINK_HELP = "udpout://HOST:PORT, udpin://HOST:PORT, tcp://HOST:PORT or serial://DEVICE:BAUD"
EXPLAIN_S = 0.5
SPEED_M_S = 5.0
"""Hover speed in a .plan that was downloaded; nothing over the wire says it."""


def upload(argv: list[str] | None = None) -> int:
    """Send a plan file to one vehicle and read it back."""
    parser = _parser("upload", upload.__doc__ or "")
    parser.add_argument("--to", dest="link", required=True, metavar="URL", help=LINK_HELP)
    options = parser.parse_args(argv)
    plan = read_file(options.file)
    parts = {name: items for name in TYPES if (items := getattr(plan, name))}
    if not parts:
        raise UserError(f"{options.file}: holds neither mission nor fence nor rally points; there is nothing to send.")
    with MavlinkLink(options.link, _signing(options)) as link, _progress(options.json) as bar:
        system, autopilot = _chosen(vehicles(link), options.system)
        ardupilot = autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA
        rows = [_send(link, bar(name), name, items, plan.home, system, ardupilot, options.timeout_s)
                for name, items in parts.items()]
    print_rows(rows, options.json)
    return 0


def download(argv: list[str] | None = None) -> int:
    """Write what one vehicle holds to a plan file."""
    parser = _parser("download", download.__doc__ or "")
    parser.add_argument("--from", dest="link", required=True, metavar="URL", help=LINK_HELP)
    options = parser.parse_args(argv)
    write = _writer(options.file)
    with MavlinkLink(options.link, _signing(options)) as link, _progress(options.json) as bar:
        system, autopilot = _chosen(vehicles(link), options.system)
        parts = {name: _fetch(link, bar(name), name, system, options.timeout_s) for name in TYPES}
        home = home_item(*home_position(link, system), where=f"{options.link}: home of vehicle {system}")
    if autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA:
        parts["mission"] = parts["mission"][1:]  # item 0 is home
    write(FlightPlan(home=home, **parts))
    rows = [{"part": name, "items": len(items), "system": system, "sha256": canonical_sha256(items)}
            for name, items in parts.items()]
    print_rows(rows, options.json)
    return 0


def read_file(path: Path) -> FlightPlan:
    """The plan of a .plan or waypoint file. Raises UserError."""
    if path.suffix == ".plan":
        return read_plan(path)
    if path.suffix in (".waypoints", ".txt"):
        return read_waypoints(path)
    raise UserError(f"{path}: is no plan file by its name; give a .plan or .waypoints file.")


def _send(link: MavlinkLink, progress: Callable[[float], None], name: str, items: list[Item], home: Item, system: int,
          ardupilot: bool, timeout_s: float) -> dict[str, object]:
    """One part of the plan, proven to be there. Raises LinkError otherwise."""
    home_first = ardupilot and name == "mission"
    sent = [home, *items] if home_first else items
    begin_s = time.monotonic()
    transfer = VerifiedUpload(sent, system, begin_s + timeout_s, TYPES[name],
                              as_ardupilot_keeps if home_first else exactly)
    link.take_texts(system)
    run(link, transfer, progress)
    if transfer.outcome != "done":
        raise LinkError(f"{link.url}: vehicle {system} did not take the {name} ({len(sent)} items): {transfer.reason}"
                        f"{_explanation(link, system)}.")
    return {"part": name, "items": len(sent), "system": system, "seconds": round(time.monotonic() - begin_s, 2),
            "attempts": transfer.attempts, "sha256": canonical_sha256(items)}


def _explanation(link: MavlinkLink, system: int) -> str:
    """What the vehicle says beside its acknowledgement."""
    until_s = time.monotonic() + EXPLAIN_S
    while time.monotonic() < until_s:
        link.receive()
    said = link.take_texts(system)
    return f"; it says: {said}" if said else ""


def _fetch(link: MavlinkLink, progress: Callable[[float], None], name: str, system: int,
           timeout_s: float) -> list[Item]:
    """One part of what the vehicle holds. Raises LinkError when it does not come whole in time."""
    transfer = Download(system, TYPES[name], time.monotonic() + timeout_s)
    run(link, transfer, progress)
    if transfer.outcome == "refused" and name != "mission":
        return []  # autopilots without fence or rally points say so
    if transfer.outcome != "done":
        raise LinkError(f"{link.url}: the {name} of vehicle {system} could not be read: {transfer.reason}.")
    return with_wire_frames(transfer.items)


def _chosen(found: dict[int, int], wanted: int | None) -> tuple[int, int]:
    """System id and MAV_AUTOPILOT of the vehicle that is meant. Raises UserError."""
    ids = ", ".join(map(str, sorted(found)))
    if wanted is None and len(found) > 1:
        raise UserError(f"--system: vehicles {ids} are there; choose one of them.")
    if wanted is not None and wanted not in found:
        raise UserError(f"--system {wanted}: is not there, but {ids}; choose one of them.")
    return next((system, kind) for system, kind in found.items() if wanted in (None, system))


def _writer(path: Path) -> Callable[[FlightPlan], None]:
    if path.suffix == ".plan":
        return lambda plan: write_plan(path, plan, SPEED_M_S)
    if path.suffix == ".waypoints":
        return lambda plan: write_waypoints(path, plan.home, plan.mission)
    raise UserError(f"{path}: is no plan file by its name; give a .plan or .waypoints file.")


def _signing(options: argparse.Namespace) -> Signing | None:
    return None if options.signing_key is None else Signing(read_key(options.signing_key))


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[str], Callable[[float], None]]]:
    """Gives a bar per part, on stderr."""
    with Progress(console=Console(stderr=True, quiet=quiet)) as progress:
        def bar(name: str) -> Callable[[float], None]:
            task = progress.add_task(name, total=1.0)
            return lambda share: progress.update(task, completed=share)

        yield bar


def _parser(verb: str, description: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=f"swarmscan missions {verb}", description=description,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="a .plan or .waypoints file")
    parser.add_argument("--system", type=int, metavar="K", help="MAVLink system id; not needed where only one is heard")
    parser.add_argument("--timeout-s", type=float, default=120.0, help="for each part (default %(default)s)")
    parser.add_argument("--signing-key", type=Path, metavar="FILE", help="sign, and hear only who does, with this key")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")
    return parser
