"""`QGC WPL 110` files, as Mission Planner, MAVProxy and QGroundControl read them: a line per mission item.

Line 0 is home, as ArduPilot has it. The format has no geofence and no rally points.
"""

from __future__ import annotations

import math
from pathlib import Path

from pymavlink.dialects.v20 import common as mav

from missions.errors import UserError
from missions.flight_plan import (
    FILE_FRAMES,
    FlightPlan,
    check_count,
    check_places,
    home_item,
    item_from_params,
    params_of_item,
    read_plan_text,
)
from missions.mavlink import Item

HEADER = "QGC WPL 110"
COLUMNS = ("index", "current", "frame", "command", *(f"parameter {n}" for n in range(1, 8)), "autocontinue")
_HOME_COMMANDS = (0, mav.MAV_CMD_NAV_WAYPOINT)
"""Mission Planner writes 0 for the command of home."""


def write_waypoints(path: Path, home: Item, mission: list[Item]) -> None:
    """Write home and the mission's items; `read_waypoints` gives the same items back, bit for bit."""
    lines = [HEADER, *(_line(seq, item) for seq, item in enumerate([home, *mission]))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_waypoints(path: Path) -> FlightPlan:
    """The plan of a file, without fence and rally points. Raises UserError naming file, line and remedy."""
    lines = read_plan_text(path).splitlines()
    if not lines or lines[0].strip() != HEADER:
        raise UserError(f"{path}: line 1: is not {HEADER!r}; give a waypoint file of that version.")
    rows = [(n, line.split()) for n, line in enumerate(lines[1:], start=2) if line.strip() and line[0] != "#"]
    check_count(rows, str(path))
    items = [_item(fields, seq, f"{path}: line {n}") for seq, (n, fields) in enumerate(rows)]
    if not items or items[0].frame != mav.MAV_FRAME_GLOBAL_INT or items[0].command not in _HOME_COMMANDS:
        raise UserError(f"{path}: index 0 must be the home position (frame 0, command {mav.MAV_CMD_NAV_WAYPOINT}); "
                        "put it before the mission's items.")
    lat_deg, lon_deg, alt_m = params_of_item(items[0])[4:]
    home = home_item(lat_deg, lon_deg, alt_m, f"{path}: line {rows[0][0]}")
    return check_places(FlightPlan(home=home, mission=items[1:]), str(path))


def _line(seq: int, item: Item) -> str:
    numbers = ["nan" if math.isnan(p) else repr(p) for p in params_of_item(item)]
    return "\t".join([str(seq), str(int(seq == 0)), str(FILE_FRAMES[item.frame]), str(item.command), *numbers, "1"])


def _item(fields: list[str], seq: int, where: str) -> Item:
    if len(fields) != len(COLUMNS):
        raise UserError(f"{where}: has {len(fields)} columns; give {len(COLUMNS)}: {', '.join(COLUMNS)}.")
    index, _, frame, command = (_number(fields, n, where, int) for n in range(4))
    if index != seq:
        raise UserError(f"{where}: index is {index} where {seq} is due; number the lines from 0 without gaps.")
    if _number(fields, 11, where, int) != 1:
        raise UserError(f"{where}: autocontinue is not 1, and vehicles do not stop there; set it to 1.")
    params = [float(_number(fields, n, where, float)) for n in range(4, 11)]
    return item_from_params(int(frame), int(command), params, where)


def _number(fields: list[str], column: int, where: str, kind: type[int] | type[float]) -> float:
    try:
        return kind(fields[column])
    except ValueError as e:
        wanted = "a whole number" if kind is int else "a number"
        raise UserError(f"{where}: {COLUMNS[column]} is {fields[column]!r}; write {wanted}.") from e
