"""QGroundControl's `.plan` files: mission, geofence and rally points as JSON.

Written are SimpleItems alone, which QGroundControl, MAVSDK and we read. Read are these and the commands inside surveys
and corridor scans; other complex items keep their geometry to QGroundControl and are refused.
Format: docs.qgroundcontrol.com, "Plan File Format"; fences and rally points are MAVLink's mission types 1 and 2.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta
from pymavlink.dialects.v20 import common as mav

from missions.errors import ProtocolError, UserError
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
from missions.mavlink import Item, plan_sha256

_VERTEX = {True: mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, False: mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION}
_CIRCLE = {True: mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, False: mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION}
_ABOVE_HOME, _ABOVE_SEA = mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, mav.MAV_FRAME_GLOBAL

_Place = tuple[float, float]
_PlaceAlt = tuple[float, float, float]


class _SimpleItem(msgspec.Struct, tag_field="type", tag="SimpleItem", rename="camel", kw_only=True):
    command: int
    frame: int
    params: Annotated[list[float | None], Meta(min_length=7, max_length=7)]
    auto_continue: bool = True
    do_jump_id: int = 0


class _Transect(msgspec.Struct):
    items: list[_SimpleItem] = msgspec.field(name="Items")


class _ComplexItem(msgspec.Struct, tag_field="type", tag="ComplexItem", rename="camel"):
    complex_item_type: str = "complex item"
    transect: _Transect | None = msgspec.field(name="TransectStyleComplexItem", default=None)


class _Mission(msgspec.Struct, rename="camel", kw_only=True):
    planned_home_position: _PlaceAlt
    items: list[_SimpleItem | _ComplexItem]
    version: Literal[2] = 2
    firmware_type: int = mav.MAV_AUTOPILOT_PX4
    vehicle_type: int = mav.MAV_TYPE_QUADROTOR
    cruise_speed: float = 15.0
    hover_speed: float = 5.0


class _Polygon(msgspec.Struct):
    inclusion: bool
    polygon: Annotated[list[_Place], Meta(min_length=3)]
    version: Literal[1] = 1


class _Disc(msgspec.Struct):
    center: _Place
    radius: Annotated[float, Meta(gt=0)]


class _Circle(msgspec.Struct):
    inclusion: bool
    circle: _Disc
    version: Literal[1] = 1


class _Fence(msgspec.Struct, rename="camel"):
    circles: list[_Circle] = []
    polygons: list[_Polygon] = []
    version: Literal[2] = 2
    breach_return: _PlaceAlt | msgspec.UnsetType = msgspec.UNSET


class _Rally(msgspec.Struct):
    points: list[_PlaceAlt] = []
    version: Literal[2] = 2


class _File(msgspec.Struct, rename="camel", kw_only=True):
    file_type: Literal["Plan"]
    version: Literal[1] = 1
    ground_station: str = "QGroundControl"
    mission: _Mission
    geo_fence: _Fence = msgspec.field(default_factory=_Fence)
    rally_points: _Rally = msgspec.field(default_factory=_Rally)


def write_plan(path: Path, plan: FlightPlan, speed_m_s: float = 5.0) -> None:
    """Write a plan; `read_plan` gives the same items back, bit for bit. speed_m_s: what QGroundControl reckons the
    flight's duration with.

    Raises ProtocolError for what the format cannot say: fences other than polygons, circles and a return point in this
    order, rally points with an altitude that is not above home.
    """
    items: list[_SimpleItem | _ComplexItem] = [_simple(item, n) for n, item in enumerate(plan.mission, start=1)]
    home, fence, rally = _place_alt(plan.home), _fence(plan.fence), _Rally([_place_alt(item) for item in plan.rally])
    said = [home_item(*home), *_fence_items(path, fence), *_rally_items(path, rally)]
    if plan_sha256(said) != plan_sha256([plan.home, *plan.fence, *plan.rally]):
        raise ProtocolError("home, fence or rally: there is more in these items, or another order, than a .plan holds")
    file = _File(file_type="Plan", mission=_Mission(planned_home_position=home, items=items, hover_speed=speed_m_s),
                 geo_fence=fence, rally_points=rally)
    path.write_bytes(msgspec.json.format(msgspec.json.encode(file), indent=4) + b"\n")


def read_plan(path: Path) -> FlightPlan:
    """The plan of a file. Raises UserError naming file, field and remedy."""
    try:
        file = msgspec.json.decode(read_plan_text(path), type=_File)
    except msgspec.ValidationError as e:
        raise UserError(_explain(path, str(e))) from e
    except (msgspec.DecodeError, RecursionError) as e:
        raise UserError(f"{path}: not valid JSON ({e}); save the plan again.") from e
    mission = [item_from_params(item.frame, item.command, item.params, where)
               for where, item in _commands(path, file.mission.items)]
    check_count(mission, f"{path}: mission.items")
    home = home_item(*file.mission.planned_home_position, where=f"{path}: mission.plannedHomePosition")
    return check_places(FlightPlan(home=home, mission=mission, fence=_fence_items(path, file.geo_fence),
                                   rally=_rally_items(path, file.rally_points)), str(path))


def _commands(path: Path, items: list[_SimpleItem | _ComplexItem]) -> Iterator[tuple[str, _SimpleItem]]:
    """Single commands and where they stand; those of surveys and corridor scans stand inside these."""
    for n, item in enumerate(items):
        where = f"{path}: mission.items[{n}]"
        if isinstance(item, _SimpleItem):
            if not item.auto_continue:
                raise UserError(f"{where}: autoContinue is false, and vehicles do not stop there; set it to true.")
            yield where, item
        elif item.transect is None:
            raise UserError(f"{where}: a {item.complex_item_type} has no commands in it; replace it by waypoints.")
        else:
            yield from ((f"{where}.TransectStyleComplexItem.Items[{k}]", i) for k, i in enumerate(item.transect.items))


def _simple(item: Item, jump_id: int) -> _SimpleItem:
    params: list[float | None] = [*params_of_item(item)]  # NaN becomes null
    return _SimpleItem(command=item.command, frame=FILE_FRAMES[item.frame], params=params, do_jump_id=jump_id)


def _place_alt(item: Item) -> _PlaceAlt:
    lat_deg, lon_deg, alt_m = params_of_item(item)[4:]
    return lat_deg, lon_deg, alt_m


def _fence(items: list[Item]) -> _Fence:
    fence, rest = _Fence([], []), list(items)
    while rest:
        item = rest[0]
        lat_deg, lon_deg, alt_m = _place_alt(item)
        taken = 1
        if item.command in _VERTEX.values():
            taken = int(item.params[0])
            corners = rest[:taken]
            if taken < 3 or [(c.command, c.params[0]) for c in corners] != [(item.command, taken)] * taken:
                raise ProtocolError(f"fence: a polygon of {taken} vertices is broken off or mixed with another")
            fence.polygons.append(_Polygon(item.command == _VERTEX[True], [_place_alt(c)[:2] for c in corners]))
        elif item.command in _CIRCLE.values():
            fence.circles.append(_Circle(item.command == _CIRCLE[True], _Disc((lat_deg, lon_deg), item.params[0])))
        elif item.command == mav.MAV_CMD_NAV_FENCE_RETURN_POINT:
            fence.breach_return = (lat_deg, lon_deg, alt_m)
        else:
            raise ProtocolError(f"fence: command {item.command} is none of a geofence")
        rest = rest[taken:]
    return fence


def _fence_items(path: Path, fence: _Fence) -> list[Item]:
    """Polygons, circles and the return point, in this order."""
    out = []
    for n, p in enumerate(fence.polygons):
        where = f"{path}: geoFence.polygons[{n}]"
        out += [item_from_params(_ABOVE_SEA, _VERTEX[p.inclusion], (len(p.polygon), 0, 0, 0, *c, 0), where)
                for c in p.polygon]
    for n, c in enumerate(fence.circles):
        place = (c.circle.radius, 0, 0, 0, *c.circle.center, 0)
        out.append(item_from_params(_ABOVE_SEA, _CIRCLE[c.inclusion], place, f"{path}: geoFence.circles[{n}]"))
    if fence.breach_return is not msgspec.UNSET:
        out.append(item_from_params(_ABOVE_HOME, mav.MAV_CMD_NAV_FENCE_RETURN_POINT,
                                    (0, 0, 0, 0, *fence.breach_return), f"{path}: geoFence.breachReturn"))
    check_count(out, f"{path}: geoFence")
    return out


def _rally_items(path: Path, rally: _Rally) -> list[Item]:
    check_count(rally.points, f"{path}: rallyPoints.points")
    return [item_from_params(_ABOVE_HOME, mav.MAV_CMD_NAV_RALLY_POINT, (0, 0, 0, 0, *point),
                             f"{path}: rallyPoints.points[{n}]") for n, point in enumerate(rally.points)]


def _explain(path: Path, error: str) -> str:
    where = re.search(r" - at `\$\.?([^`]*)`", error)
    what = re.sub(r" - at `[^`]*`", "", error)
    field = where.group(1) if where else ""
    return f"{path}: {field or 'top level'}: {what[0].lower()}{what[1:]}; correct it or save the plan again."
