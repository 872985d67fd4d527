"""What a vehicle flew in a run, as a plan that can be flown again.

The way is the recorded track, not straight lines between pictures, which may lead through the structure: from the hover
point over the pad to the phase's pictures and back over the pad. Loops and waits are left out, and what remains
is at most LOOP_M / 2 + TOLERANCE_M beside the track.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mav

from ground_station.report.run_data import RunData, Track, ViewRow
from missions.errors import UserError
from missions.flight_plan import FlightPlan, home_item, item_from_params
from missions.frames import Array, Site, yaw_elevation_from_forward
from missions.mavlink import Item, Route, Waypoint, items_from_route
from missions.messages import SiteBrief
from missions.pads import geofence, takeoff_points

Indices = NDArray[np.intp]

LOOP_M = 0.2
TOLERANCE_M = 0.1
STANDING_M_S = 0.05
VERTICAL = ("takeoff", "land", "emergency")
"""Modes in which a vehicle is over a pad, or nobody knows where: no part of the plan."""
GROUND = "standby"


@dataclass(frozen=True)
class FlownPlan:
    """What one vehicle flew between a take-off and the landing after it; sorties count from 1 per vehicle."""

    vehicle_id: int
    sortie: int
    pictures: int
    plan: FlightPlan


def flown_plans(data: RunData, phase: str) -> list[FlownPlan]:
    """A plan for every sortie on which pictures of this phase ("explore" or "survey") were taken, in order of vehicle.

    Raises UserError when the run does not hold what that takes.
    """
    if not data.tracks or not data.views or "site" not in data.flight:
        raise UserError(f"{data.run.root}: trajectories.npz, views.csv and flight.json are needed to know what was "
                        "flown; give the folder of a run that has flown.")
    anchor = data.mission.site.anchor
    brief = msgspec.convert(data.flight["site"], SiteBrief)
    pads, fence = takeoff_points(data.mission, brief), _fence(geofence(data.mission, brief), anchor)
    out = []
    for track in data.tracks:
        home = home_item(*anchor.geodetic_from_enu(np.array(pads[track.vehicle_id - 1])))
        views = sorted((v for v in data.views if (v.phase, v.vehicle_id) == (phase, track.vehicle_id)),
                       key=lambda v: v.t_capture_s)
        for number, sortie in enumerate(_sorties(data, track), start=1):
            taken = [v for v in views if track.t_s[sortie[0]] <= v.t_capture_s <= track.t_s[sortie[-1]]]
            if taken:
                route = flown_route(data, track, sortie, taken)
                plan = FlightPlan(home=home, mission=items_from_route(route, anchor), fence=fence)
                out.append(FlownPlan(track.vehicle_id, number, len(taken), plan))
    return out


def flown_route(data: RunData, track: Track, sortie: Indices, views: list[ViewRow]) -> Route:
    """The samples `sortie` (indices) of a track as a route with these pictures, in order of time."""
    spec, t_s, position = data.mission.survey, track.t_s[sortie], track.position_enu_m[sortie]
    times = [t_s[0], *(v.t_capture_s for v in views), t_s[-1]]
    places = [position[0], *(v.position_enu_m for v in views), position[-1]]
    waypoints: list[Waypoint] = []
    for n, (begin, end) in enumerate(pairwise(times)):
        between = position[(t_s > begin) & (t_s < end)]
        way = straightened(without_loops(np.concatenate([places[n][None], between, places[n + 1][None]])))
        view = views[min(n, len(views) - 1)]
        yaw, elevation = yaw_elevation_from_forward(view.enu_from_camera[:, 2])
        ends = slice(0 if n == 0 else 1, None if n == len(views) else -1)
        waypoints += [Waypoint(position_enu_m=_tuple(corner), yaw_enu_rad=yaw, gimbal_elevation_rad=elevation,
                               stop=False, pass_m=spec.pass_m) for corner in way[ends]]
        if n < len(views):
            stop = view.speed_m_s < STANDING_M_S
            waypoints.append(Waypoint(
                position_enu_m=_tuple(view.position_enu_m), yaw_enu_rad=yaw, gimbal_elevation_rad=elevation,
                view_id=view.view_id, stop=stop, settle_s=spec.settle_s if stop else 0.0,
                pass_m=0.0 if stop else spec.pass_m, speed_m_s=0.0 if stop else view.speed_m_s))
    return Route(plan_id=1, phase=views[0].phase, waypoints=waypoints, home_after=True)


def without_loops(path: Array) -> Array:
    """(k, 3) points of a path (n, 3), both ends included: from each on to the last that is within LOOP_M of it."""
    kept = [0]
    while kept[-1] < len(path) - 1:
        rest = path[kept[-1] + 1:] - path[kept[-1]]
        near = np.flatnonzero(np.einsum("ij,ij->i", rest, rest) <= LOOP_M**2)
        kept.append(kept[-1] + 1 + (int(near[-1]) if len(near) else 0))
    return path[kept]


def straightened(path: Array) -> Array:
    """(k, 3) corners of a path (n, 3), both ends included, that leave none of its points by more than TOLERANCE_M
    (Douglas and Peucker 1973)."""
    kept, open_spans = {0, len(path) - 1}, [(0, len(path) - 1)]
    while open_spans:
        first, last = open_spans.pop()
        if last - first < 2:
            continue
        way, inner = path[last] - path[first], path[first + 1:last] - path[first]
        along = np.clip(inner @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
        off = np.linalg.norm(inner - along[:, None] * way, axis=1)
        if off.max() > TOLERANCE_M:
            corner = first + 1 + int(off.argmax())
            kept.add(corner)
            open_spans += [(first, corner), (corner, last)]
    return path[sorted(kept)]


def _sorties(data: RunData, track: Track) -> list[Indices]:
    """Indices of a track's samples between one take-off and the landing after it, without the vertical ways."""
    if len(track.mode) != len(track.t_s):
        raise UserError(f"{data.run.trajectories}: uav{track.vehicle_id}_mode is missing, so take-off and landing are "
                        "unknown; fly the mission again.")
    landed = np.flatnonzero(track.mode == GROUND)
    flights = np.split(np.arange(len(track.t_s)), landed)
    on_the_way = ~np.isin(track.mode, [GROUND, *VERTICAL])
    return [f[on_the_way[f]] for f in flights if on_the_way[f].any()]


def _fence(box: tuple[Array, Array], anchor: Site) -> list[Item]:
    """The geofence's outline; its lower and upper limit have no place in fence items."""
    (west, south, _), (east, north, _) = box
    corners = [anchor.geodetic_from_enu(np.array([e, n, 0.0]))[:2]
               for e, n in ((west, south), (east, south), (east, north), (west, north))]
    return [item_from_params(mav.MAV_FRAME_GLOBAL, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
                             (len(corners), 0, 0, 0, *corner, 0), "geofence") for corner in corners]


def _tuple(position: Array) -> tuple[float, float, float]:
    return float(position[0]), float(position[1]), float(position[2])
