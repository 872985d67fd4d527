"""A plan as ground stations keep it in files: home, and MAVLink's three mission types as items.

Files hold an item as frame, command and seven parameters with degrees among them; the wire holds degE7 and float32.
`item_from_params` and `params_of_item` are the one place where the two meet: what is read is what would be uploaded,
and to write and read it again changes no bit. Altitudes stay in the frame in which they are given.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from pathlib import Path

import msgspec
from pymavlink.dialects.v20 import common as mav

from missions.errors import UserError
from missions.mavlink import Item

FILE_FRAMES = {mav.MAV_FRAME_GLOBAL_INT: mav.MAV_FRAME_GLOBAL,
               mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: mav.MAV_FRAME_GLOBAL_RELATIVE_ALT,
               mav.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: mav.MAV_FRAME_GLOBAL_TERRAIN_ALT,
               mav.MAV_FRAME_MISSION: mav.MAV_FRAME_MISSION}
"""Frame of an item to the frame that stands in files, which know no degE7."""
_WIRE_FRAMES = {file: wire for wire, file in FILE_FRAMES.items()} | {wire: wire for wire in FILE_FRAMES}
UNSET = 2**31 - 1
"""Latitude or longitude that is left to the vehicle (NaN in files), as MISSION_ITEM_INT says it."""
MAX_ITEMS = 65535
MAX_FILE_BYTES = 64 * 2**20
PARAMS = 7
FARTHEST_M, EARTH_RADIUS_M = 100_000.0, 6_371_000.0
"""Nothing that a camera drone does is farther from its home."""


class FlightPlan(msgspec.Struct, frozen=True, kw_only=True):
    """What one vehicle is to do (`mission`), where it may be (`fence`) and may land (`rally`); each a list of mission
    items of that type. `home` is a waypoint with an altitude above the sea."""

    home: Item
    mission: list[Item]
    fence: list[Item] = []
    rally: list[Item] = []


def home_item(lat_deg: float, lon_deg: float, alt_m: float, where: str = "home") -> Item:
    """The item that stands for a home position. Raises UserError, beginning with `where`, when it is no place."""
    params = (0, 0, 0, 0, lat_deg, lon_deg, alt_m)
    home = item_from_params(mav.MAV_FRAME_GLOBAL, mav.MAV_CMD_NAV_WAYPOINT, params, where)
    if UNSET in (home.x, home.y) or not math.isfinite(home.z):
        raise UserError(f"{where}: the home position is not finite; give latitude, longitude and altitude.")
    return home


def item_from_params(frame: int, command: int, params: Sequence[float | None], where: str) -> Item:
    """The item of a file's frame, command and seven parameters; None and NaN both mean "not set".

    Raises UserError, beginning with `where`, when a vehicle could not be told so.
    """
    if frame not in _WIRE_FRAMES:
        raise UserError(f"{where}: frame {frame} is not supported; use 0 (above the sea), 3 (above home), 10 (above "
                        "terrain) or 2 (no place).")
    if not 0 <= command < 2**16:
        raise UserError(f"{where}: command {command} is no MAVLink command; give a number in 0..65535.")
    if len(params) != PARAMS:
        raise UserError(f"{where}: {len(params)} parameters; give {PARAMS}.")
    p1, p2, p3, p4, x, y, z = (math.nan if p is None else p for p in params)
    p1, p2, p3, p4, z = (_single(value, where) for value in (p1, p2, p3, p4, z))
    wire = _WIRE_FRAMES[frame]
    if wire == mav.MAV_FRAME_MISSION:
        place = _whole(x, where), _whole(y, where)
    else:
        place = _deg_e7(x, 90, "latitude", where), _deg_e7(y, 180, "longitude", where)
    return Item(wire, command, (p1, p2, p3, p4), *place, z)


def params_of_item(item: Item) -> list[float]:
    """The seven parameters of an item as files hold them: degrees where the frame has places, NaN for what is unset."""
    scale = 1.0 if item.frame == mav.MAV_FRAME_MISSION else 1e7
    return [*item.params, *(math.nan if v == UNSET else v / scale for v in (item.x, item.y)), item.z]


def with_wire_frames(items: list[Item]) -> list[Item]:
    """The same items, where a frame has two numbers with the one for degE7, whichever an autopilot gave back."""
    return [msgspec.structs.replace(item, frame=_WIRE_FRAMES.get(item.frame, item.frame)) for item in items]


def has_place(item: Item) -> bool:
    """Whether the vehicle is to go to the item's latitude and longitude, or they mean a place in another way."""
    return item.frame != mav.MAV_FRAME_MISSION and UNSET not in (item.x, item.y) and (item.x, item.y) != (0, 0)


def read_plan_text(path: Path) -> str:
    """The text of a plan file. Raises UserError when it cannot be read or cannot be a plan for its size."""
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise UserError(f"{path}: {size / 2**20:.0f} MiB are no plan; give a file of at most "
                            f"{MAX_FILE_BYTES // 2**20} MiB.")
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as e:
        raise UserError(f"{path}: cannot be read ({e}); give a readable UTF-8 file.") from e


def check_count(items: Sequence[object], where: str) -> None:
    """Raises UserError when there are more items than MAVLink can count."""
    if len(items) > MAX_ITEMS:
        raise UserError(f"{where}: {len(items)} items are more than MAVLink can count; give at most {MAX_ITEMS}.")


def check_places(plan: FlightPlan, where: str) -> FlightPlan:
    """The plan, when all its places can belong together. Raises UserError: far from home means swapped or mistyped."""
    home_lat_deg, home_lon_deg = plan.home.x / 1e7, plan.home.y / 1e7
    for part in ("mission", "fence", "rally"):
        for n, item in enumerate(getattr(plan, part)):
            if not has_place(item):
                continue
            lat_deg, lon_deg = item.x / 1e7, item.y / 1e7
            away_m = _distance_m(home_lat_deg, home_lon_deg, lat_deg, lon_deg)
            if away_m > FARTHEST_M:
                raise UserError(f"{where}: {part} item {n} at latitude {lat_deg:.4f}, longitude {lon_deg:.4f} is "
                                f"{away_m / 1000:.0f} km from home; latitude comes first, so swap them or move home.")
    return plan


def _distance_m(lat_deg: float, lon_deg: float, other_lat_deg: float, other_lon_deg: float) -> float:
    """Along the great circle of a sphere."""
    a, b = math.radians(lat_deg), math.radians(other_lat_deg)
    half_lat, half_lon = (b - a) / 2.0, math.radians(other_lon_deg - lon_deg) / 2.0
    chord = math.sin(half_lat) ** 2 + math.cos(a) * math.cos(b) * math.sin(half_lon) ** 2
    return 2.0 * EARTH_RADIUS_M * math.asin(min(1.0, math.sqrt(chord)))


def _single(value: float, where: str) -> float:
    if math.isnan(value):
        return math.nan  # of many bit patterns the one that files stand for
    try:
        out = float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        out = math.inf
    if math.isinf(out):
        raise UserError(f"{where}: a parameter is {value}, beyond what MAVLink can carry; correct it.")
    return out


def _whole(value: float, where: str) -> int:
    if math.isnan(value):
        return UNSET
    if not -(2**31) <= value < UNSET or value != int(value):
        raise UserError(f"{where}: parameter 5 or 6 is {value}; in frame 2 they are whole numbers, so round it.")
    return int(value)


def _deg_e7(value: float, limit_deg: int, name: str, where: str) -> int:
    if math.isnan(value):
        return UNSET
    if not abs(value) <= limit_deg:
        raise UserError(f"{where}: {name} is {value}, outside ±{limit_deg} degrees; correct it (latitude comes first).")
    return round(value * 1e7)
