"""Flight plans that other ground stations upload: what of MAVLink's mission items this vehicle flies.

It takes what inspection plans are made of: waypoints, delays, speeds, camera and gimbal, regions of interest, take-off
and return. Everything else is refused as a whole with the result that the protocol has for it, never flown in part.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from msgspec import structs
from pymavlink.dialects.v20 import common as mav

from missions.frames import Array, Site, yaw_enu_from_heading_deg
from missions.mavlink import Item, Route, Waypoint

PHASE = "survey"
LONGEST_PASS_M = 1.0
"""A waypoint with a larger acceptance radius is passed this near."""
HOME_M = 2.0
"""A landing this near to the own pad is a landing at home; elsewhere nobody vouches for the ground."""
AMSL_FRAMES = (mav.MAV_FRAME_GLOBAL, mav.MAV_FRAME_GLOBAL_INT)
RELATIVE_FRAMES = (mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)


class PlanRefused(Exception):  # noqa: N818 - an answer, not an error
    """The MAV_MISSION_RESULT for the sender, and a sentence for people."""

    def __init__(self, result: int, reason: str) -> None:
        super().__init__(reason)
        self.result, self.reason = result, reason


@dataclass(frozen=True)
class Place:
    """Where the vehicle is at home, and where it is."""

    site: Site
    pad_enu_m: Array
    hover_enu_m: Array
    position_enu_m: Array


@dataclass
class ClientPlan:
    """The route, the items each waypoint is made of, and the return's item if there is one."""

    route: Route
    groups: list[list[int]]
    home_seq: int | None


@dataclass
class _Draft:
    """A plan as it is read, item by item."""

    place: Place
    new_view_id: Callable[[], int]
    nan_allowed: bool
    points: list[Waypoint] = field(default_factory=list)
    groups: list[list[int]] = field(default_factory=list)
    elevation_rad: float = 0.0
    speed_m_s: float = 0.0
    interest_enu_m: Array | None = None
    headed: list[bool] = field(default_factory=list)
    """For each waypoint, whether the plan says where it looks."""
    home_seq: int | None = None

    def add(self, waypoint: Waypoint, headed: bool) -> None:
        self.points.append(waypoint)
        self.headed.append(headed)
        self.groups.append([])

    def amend(self, **changes: object) -> None:
        """Change the last waypoint, or the one where the vehicle is now when there is none yet."""
        if not self.points:
            self.add(_at(self.place.position_enu_m, math.pi / 2.0), False)
        self.points[-1] = structs.replace(self.points[-1], **changes)


def read_plan(items: list[Item], place: Place, plan_id: int, new_view_id: Callable[[], int],
              nan_allowed: bool) -> ClientPlan:
    """The route that these items describe. Raises PlanRefused."""
    draft = _Draft(place, new_view_id, nan_allowed)
    for seq, item in enumerate(items):
        reader = _READERS.get(item.command)
        if reader is None:
            raise PlanRefused(mav.MAV_MISSION_UNSUPPORTED, f"item {seq}: command {item.command} is not flown")
        if draft.home_seq is not None:
            raise PlanRefused(mav.MAV_MISSION_INVALID_SEQUENCE, f"item {seq}: comes after the return")
        if not nan_allowed and any(math.isnan(p) for p in item.params[:3]):
            raise PlanRefused(mav.MAV_MISSION_INVALID_PARAM1, f"item {seq}: a parameter is not a number")
        reader(draft, seq, item)
        if draft.groups and draft.home_seq is None:
            draft.groups[-1].append(seq)
    _look_ahead(draft)
    route = Route(plan_id=plan_id, phase=PHASE, waypoints=draft.points, home_after=draft.home_seq is not None)
    return ClientPlan(route, draft.groups, draft.home_seq)


def position_of(item: Item, seq: int, place: Place) -> Array:
    """(3,) ENU metres. Raises PlanRefused."""
    if item.frame not in (*AMSL_FRAMES, *RELATIVE_FRAMES):
        raise PlanRefused(mav.MAV_MISSION_UNSUPPORTED_FRAME, f"item {seq}: frame {item.frame} is not flown")
    if abs(item.x) > 900_000_000:
        raise PlanRefused(mav.MAV_MISSION_INVALID_PARAM5_X, f"item {seq}: latitude {item.x / 1e7:g}")
    if abs(item.y) > 1_800_000_000:
        raise PlanRefused(mav.MAV_MISSION_INVALID_PARAM6_Y, f"item {seq}: longitude {item.y / 1e7:g}")
    if not math.isfinite(item.z):
        raise PlanRefused(mav.MAV_MISSION_INVALID_PARAM7, f"item {seq}: the altitude is not a number")
    position = place.site.enu_from_geodetic(item.x / 1e7, item.y / 1e7, item.z)
    if item.frame in RELATIVE_FRAMES:
        position[2] = item.z + float(place.pad_enu_m[2])
    return position


def _waypoint(draft: _Draft, seq: int, item: Item) -> None:
    hold_s, radius_m, _, heading_deg = item.params
    hold_s = hold_s if math.isfinite(hold_s) else 0.0
    passed = hold_s <= 0.0 and math.isfinite(radius_m) and radius_m > 0.0
    headed = math.isfinite(heading_deg)
    yaw = yaw_enu_from_heading_deg(heading_deg) if headed else 0.0
    draft.add(structs.replace(_at(position_of(item, seq, draft.place), yaw), stop=not passed, settle_s=hold_s,
                               pass_m=min(radius_m, LONGEST_PASS_M) if passed else 0.0,
                               gimbal_elevation_rad=draft.elevation_rad, speed_m_s=draft.speed_m_s), headed)
    _look_at_interest(draft)


def _takeoff(draft: _Draft, seq: int, item: Item) -> None:
    """Up over the pad, wherever the item says it is; the vehicle hovers over its pad first anyway."""
    above = position_of(Item(item.frame, item.command, item.params, 0, 0, item.z), seq, draft.place)
    up = max(float(above[2]), float(draft.place.hover_enu_m[2]))
    draft.add(_at(np.array([*draft.place.hover_enu_m[:2], up]), math.pi / 2.0), False)


def _loiter(draft: _Draft, seq: int, item: Item) -> None:
    seconds = item.params[0] if item.command == mav.MAV_CMD_NAV_LOITER_TIME else 0.0
    _waypoint(draft, seq, Item(item.frame, item.command, (max(seconds, 0.0), 0.0, 0.0, item.params[3]), item.x, item.y,
                               item.z))


def _return(draft: _Draft, seq: int, item: Item) -> None:
    draft.home_seq = seq


def _land(draft: _Draft, seq: int, item: Item) -> None:
    spot = position_of(Item(item.frame, item.command, item.params, item.x, item.y, 0.0), seq, draft.place)
    if np.linalg.norm((spot - draft.place.pad_enu_m)[:2]) > HOME_M and (item.x, item.y) != (0, 0):
        raise PlanRefused(mav.MAV_MISSION_INVALID_PARAM5_X,
                          f"item {seq}: landing is only known to be safe on the own pad")
    draft.home_seq = seq


def _delay(draft: _Draft, seq: int, item: Item) -> None:
    draft.amend(stop=True, settle_s=max(item.params[0], 0.0), pass_m=0.0)


def _speed(draft: _Draft, seq: int, item: Item) -> None:
    if math.isfinite(item.params[1]) and item.params[1] > 0.0:
        draft.speed_m_s = item.params[1]


def _pitch(draft: _Draft, seq: int, item: Item) -> None:
    """DO_GIMBAL_MANAGER_PITCHYAW and DO_MOUNT_CONTROL both carry the pitch first, degrees."""
    if math.isfinite(item.params[0]):
        draft.elevation_rad = math.radians(item.params[0])
        draft.amend(gimbal_elevation_rad=draft.elevation_rad)


def _heading(draft: _Draft, seq: int, item: Item) -> None:
    draft.amend(yaw_enu_rad=yaw_enu_from_heading_deg(item.params[0]))
    draft.headed[-1] = True


def _interest(draft: _Draft, seq: int, item: Item) -> None:
    draft.interest_enu_m = position_of(item, seq, draft.place)
    _look_at_interest(draft)


def _no_interest(draft: _Draft, seq: int, item: Item) -> None:
    draft.interest_enu_m = None


def _picture(draft: _Draft, seq: int, item: Item) -> None:
    """One picture at the waypoint. A series (IMAGE_START_CAPTURE with another count) starts when it is reached."""
    if item.command != mav.MAV_CMD_IMAGE_START_CAPTURE or item.params[2] == 1.0:
        draft.amend(view_id=draft.new_view_id())


def _nothing(draft: _Draft, seq: int, item: Item) -> None:
    """Accepted; done when it is reached, or of no consequence here."""


_READERS: dict[int, Callable[[_Draft, int, Item], None]] = {
    mav.MAV_CMD_NAV_WAYPOINT: _waypoint, mav.MAV_CMD_NAV_TAKEOFF: _takeoff,
    mav.MAV_CMD_NAV_LOITER_TIME: _loiter, mav.MAV_CMD_NAV_LOITER_UNLIM: _loiter,
    mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return, mav.MAV_CMD_NAV_LAND: _land, mav.MAV_CMD_NAV_DELAY: _delay,
    mav.MAV_CMD_DO_CHANGE_SPEED: _speed, mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: _pitch,
    mav.MAV_CMD_DO_MOUNT_CONTROL: _pitch, mav.MAV_CMD_CONDITION_YAW: _heading,
    mav.MAV_CMD_DO_SET_ROI_LOCATION: _interest, mav.MAV_CMD_DO_SET_ROI_NONE: _no_interest,
    mav.MAV_CMD_IMAGE_START_CAPTURE: _picture, mav.MAV_CMD_DO_DIGICAM_CONTROL: _picture,
    mav.MAV_CMD_IMAGE_STOP_CAPTURE: _nothing, mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE: _nothing,
    mav.MAV_CMD_SET_CAMERA_MODE: _nothing,
}


def _at(position_enu_m: Array, yaw_enu_rad: float) -> Waypoint:
    x, y, z = (float(c) for c in position_enu_m)
    return Waypoint(position_enu_m=(x, y, z), yaw_enu_rad=yaw_enu_rad)


def _look_at_interest(draft: _Draft) -> None:
    if draft.interest_enu_m is None or not draft.points:
        return
    away = draft.interest_enu_m - np.array(draft.points[-1].position_enu_m)
    level = float(np.hypot(away[0], away[1]))
    draft.amend(yaw_enu_rad=math.atan2(away[1], away[0]), gimbal_elevation_rad=math.atan2(away[2], level))
    draft.headed[-1] = True


def _look_ahead(draft: _Draft) -> None:
    """Waypoints without a heading look along the leg that leads to them."""
    before, yaw = draft.place.position_enu_m, math.pi / 2.0
    for n, point in enumerate(draft.points):
        here = np.array(point.position_enu_m)
        leg = here - before
        if np.hypot(leg[0], leg[1]) > 0.1:
            yaw = math.atan2(leg[1], leg[0])
        if draft.headed[n]:
            yaw = point.yaw_enu_rad
        else:
            draft.points[n] = structs.replace(point, yaw_enu_rad=yaw)
        before = here
