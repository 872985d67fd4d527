"""Which vehicles of a mission have a real autopilot: an option of the launcher, which starts the vehicle processes."""

from __future__ import annotations

import argparse

from missions.errors import UserError
from missions.mission import Mission


def add_autopilot_option(parser: argparse.ArgumentParser) -> None:
    """Of `swarmscan fly`."""
    parser.add_argument("--autopilot", action="append", default=[], metavar="K=URL",
                        help="vehicle K is the real autopilot (PX4, ArduPilot) at mavlink:udpin://127.0.0.1:14540 or "
                             "the like; the mission then flies in real time")


def autopilots_of(pairs: list[str], mission: Mission) -> dict[int, str]:
    """Addresses by vehicle. Raises UserError."""
    out: dict[int, str] = {}
    vehicles, speed = mission.fleet.vehicles, mission.clock.speed
    if pairs and speed != 1.0:
        raise UserError(f"--autopilot {pairs[0]}: real aircraft fly in real time, not at clock.speed = {speed:g}; "
                        "leave that out.")
    for pair in pairs:
        number, equals, url = pair.partition("=")
        if not equals or not number.isdigit() or not url:
            raise UserError(f"--autopilot {pair}: write K=URL, such as 1=mavlink:udpin://127.0.0.1:14540.")
        if not 1 <= int(number) <= vehicles:
            raise UserError(f"--autopilot {pair}: this mission has vehicles 1 to {vehicles}; give one of them.")
        if int(number) in out or url in out.values():
            raise UserError(f"--autopilot {pair}: vehicle or address is given twice; each has one of its own.")
        out[int(number)] = url
    return out
