"""The geofence that somebody uploads: polygons and circles to stay in, and to stay out of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions.frames import Array, Site
from missions.mavlink import Item
from vehicle.client_plan import PlanRefused
from vehicle.geofence import Circle, Geofence

INCLUDED, EXCLUDED = mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
CIRCLE_INCLUDED, CIRCLE_EXCLUDED = mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION


def fence_from_items(items: list[Item], site: Site, box: Geofence, pad_enu_m: Array) -> Geofence:
    """The mission's box with these zones. Raises PlanRefused."""
    stay_in: list[Array | Circle] = []
    stay_out: list[Array | Circle] = []
    seq = 0
    while seq < len(items):
        item = items[seq]
        zones = stay_in if item.command in (INCLUDED, CIRCLE_INCLUDED) else stay_out
        if item.command in (INCLUDED, EXCLUDED):
            count = int(item.params[0]) if np.isfinite(item.params[0]) else 0
            corners = items[seq:seq + count]
            if count < 3 or len(corners) < count or any(c.command != item.command for c in corners):
                raise PlanRefused(mav.MAV_MISSION_INVALID_PARAM1, f"item {seq}: not a polygon of {count} corners")
            zones.append(np.array([_place(c, site) for c in corners]))
            seq += count
            continue
        if item.command in (CIRCLE_INCLUDED, CIRCLE_EXCLUDED):
            if not item.params[0] > 0.0:
                raise PlanRefused(mav.MAV_MISSION_INVALID_PARAM1, f"item {seq}: a circle needs a radius")
            zones.append(Circle(_place(item, site), float(item.params[0])))
        elif item.command != mav.MAV_CMD_NAV_FENCE_RETURN_POINT:
            raise PlanRefused(mav.MAV_MISSION_UNSUPPORTED, f"item {seq}: command {item.command} is no fence")
        seq += 1
    fence = replace(box, stay_in=tuple(stay_in), stay_out=tuple(stay_out))
    if fence.room_m(pad_enu_m)[0] < 0.0:
        raise PlanRefused(mav.MAV_MISSION_DENIED, "the own pad would lie outside")
    return fence


def _place(item: Item, site: Site) -> Array:
    return site.enu_from_geodetic(item.x / 1e7, item.y / 1e7, site.alt_m)[:2]
