"""Where vehicles stand and may fly: take-off points, camera bounds, geofence. Pure functions of mission and site.

The ground station, the vehicles and the referee all use these, so that nobody has a different idea of the limits.
"""

from __future__ import annotations

import numpy as np

from missions.frames import Array
from missions.messages import SiteBrief, Vector
from missions.mission import Mission

PAD_SPACING_M = 6.0
PAD_DISTANCE_M = 12.0
"""The row of pads lies this far before the object's box (towards -y)."""
PARKED_HEIGHT_M = 0.2
"""Height of a parked vehicle's centre above the ground."""
PAD_FENCE_M = 3.0
"""The geofence leaves at least this much room around every pad."""
COLUMN_HALF_WIDTH_M = 3.0
HOVER_ABOVE_FLOOR_M = 1.0
GROUND_VOXELS = 1.5
"""Voxels whose middle lies less than one voxel above the ground are taken for ground, not for object."""


def takeoff_points(mission: Mission, site: SiteBrief) -> list[Vector]:
    """One point per vehicle, ENU metres: the centre of the parked vehicle; vehicle K has entry K - 1."""
    if mission.fleet.takeoff_enu_m:
        return list(mission.fleet.takeoff_enu_m)
    n = mission.fleet.vehicles
    middle = 0.5 * (site.object_min_enu_m[0] + site.object_max_enu_m[0])
    y, z = site.object_min_enu_m[1] - PAD_DISTANCE_M, site.ground_up_m + PARKED_HEIGHT_M
    return [(middle + (k - 0.5 * (n - 1)) * PAD_SPACING_M, y, z) for k in range(n)]


def camera_bounds(mission: Mission, site: SiteBrief) -> tuple[Array, Array]:
    """(lower, upper), each (3,) ENU metres: the box in which pictures are taken; its floor is above the ground."""
    margin = mission.site.camera_margin_m
    lower, upper = np.array(site.object_min_enu_m) - margin, np.array(site.object_max_enu_m) + margin
    lower[2] = site.ground_up_m + mission.site.camera_floor_m
    return lower, upper


def surface_box(mission: Mission, site: SiteBrief) -> tuple[Array, Array]:
    """(lower, upper), each (3,) ENU metres: the object's box without the ground that it stands on, which nobody asked
    for and which would take a share of the views."""
    lower, upper = np.array(site.object_min_enu_m), np.array(site.object_max_enu_m)
    above_ground = site.ground_up_m + GROUND_VOXELS * mission.explore.voxel_m
    lower[2] = min(max(lower[2], above_ground), upper[2] - mission.explore.voxel_m)
    return lower, upper


def geofence(mission: Mission, site: SiteBrief) -> tuple[Array, Array]:
    """(lower, upper), each (3,) ENU metres: the box no vehicle leaves; it holds all pads and stands on the ground."""
    lower, upper = camera_bounds(mission, site)
    lower, upper = lower - mission.site.geofence_margin_m, upper + mission.site.geofence_margin_m
    pads = np.array(takeoff_points(mission, site))
    lower = np.minimum(lower, pads.min(axis=0) - PAD_FENCE_M)
    upper = np.maximum(upper, pads.max(axis=0) + PAD_FENCE_M)
    lower[2] = site.ground_up_m
    return lower, upper


def fence_limit(mission: Mission, site: SiteBrief) -> tuple[Array, Array]:
    """(lower, upper), each (3,) ENU metres: how far an operator may move the geofence out in flight. Maps reach so far;
    what lies beyond the geofence is unknown until pictures show it."""
    (lower, upper), room = geofence(mission, site), mission.site.geofence_room_m
    return lower - np.array([room, room, 0.0]), upper + room


def hover_points(mission: Mission, site: SiteBrief) -> list[Vector]:
    """Where a vehicle's vertical take-off ends and its landing begins, ENU metres, one per vehicle."""
    up = site.ground_up_m + max(mission.site.camera_floor_m, mission.fleet.clearance_m) + HOVER_ABOVE_FLOOR_M
    return [(x, y, max(up, z + HOVER_ABOVE_FLOOR_M)) for x, y, z in takeoff_points(mission, site)]


def takeoff_columns(mission: Mission, site: SiteBrief) -> list[tuple[Array, Array]]:
    """(lower, upper) boxes, one per vehicle, that the operator has looked at and vouches for: free before any picture.

    A column stands on the ground around its pad and reaches its half width above the hover point.
    """
    columns = []
    for x, y, z in hover_points(mission, site):
        half = COLUMN_HALF_WIDTH_M
        columns.append((np.array([x - half, y - half, site.ground_up_m]), np.array([x + half, y + half, z + half])))
    return columns
