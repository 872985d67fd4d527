"""KML for globes and maps: the way, the pictures with where the camera looks, home and the geofence's outline.

Altitudes above home are shown above the sea by home's altitude. For looking at: plans come back from `.plan` and
waypoint files.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path

from pymavlink.dialects.v20 import common as mav

from missions.flight_plan import FlightPlan, has_place, params_of_item
from missions.mavlink import Item

NAMESPACE = "http://www.opengis.net/kml/2.2"
_POLYGON = (mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION)


def write_kml(path: Path, plan: FlightPlan, name: str) -> None:
    """Write a plan under this name. Circles of the geofence and rally points are not drawn."""
    root = ET.Element("kml", xmlns=NAMESPACE)
    document = _add(root, "Document")
    _add(document, "name", name)
    _point(document, "home", "", _coordinates(plan.home, plan.home))
    way = [_coordinates(item, plan.home) for item in plan.mission if has_place(item)]
    line = _placemark(document, "way", "LineString")
    _add(line, "altitudeMode", "absolute")
    _add(line, "coordinates", " ".join(way))
    _pictures(_add(document, "Folder"), plan)
    corners = [item for item in plan.fence if item.command in _POLYGON]
    while corners:
        taken = int(corners[0].params[0])
        _outline(document, corners[:taken], plan.home)
        corners = corners[taken:]
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _pictures(folder: ET.Element, plan: FlightPlan) -> None:
    """A point per picture: heading in its icon, heading and gimbal pitch in words."""
    _add(folder, "name", "pictures")
    at, pitch_deg = plan.home, 0.0
    for item in plan.mission:
        if has_place(item):
            at = item
        elif item.command == mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW:
            pitch_deg = item.params[0]
        elif item.command == mav.MAV_CMD_IMAGE_START_CAPTURE:
            heading_deg = at.params[3]
            words = f"heading {heading_deg:.1f}°, gimbal pitch {pitch_deg:.1f}°"
            _point(folder, f"{item.params[3]:.0f}", words, _coordinates(at, plan.home), heading_deg)


def _point(parent: ET.Element, name: str, words: str, coordinates: str, heading_deg: float = math.nan) -> None:
    placemark = _add(parent, "Placemark")
    _add(placemark, "name", name)
    if words:
        _add(placemark, "description", words)
    if math.isfinite(heading_deg):
        _add(_add(_add(placemark, "Style"), "IconStyle"), "heading", f"{heading_deg:.2f}")
    point = _add(placemark, "Point")
    _add(point, "altitudeMode", "absolute")
    _add(point, "coordinates", coordinates)


def _outline(parent: ET.Element, corners: list[Item], home: Item) -> None:
    """A polygon of the geofence, on the ground."""
    polygon = _placemark(parent, "geofence", "Polygon")
    ring = _add(_add(polygon, "outerBoundaryIs"), "LinearRing")
    _add(ring, "coordinates", " ".join(_coordinates(c, home) for c in [*corners, corners[0]]))


def _placemark(parent: ET.Element, name: str, shape: str) -> ET.Element:
    placemark = _add(parent, "Placemark")
    _add(placemark, "name", name)
    return _add(placemark, shape)


def _coordinates(item: Item, home: Item) -> str:
    lat_deg, lon_deg, alt_m = params_of_item(item)[4:]
    above_sea_m = alt_m + (home.z if item.frame == mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT else 0.0)
    return f"{lon_deg:.7f},{lat_deg:.7f},{above_sea_m:.3f}"


def _add(parent: ET.Element, tag: str, text: str | None = None) -> ET.Element:
    child = ET.SubElement(parent, tag)
    child.text = text
    return child
