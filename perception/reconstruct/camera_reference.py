"""Where cameras stood and how they were turned, as tables that other photogrammetry programs take for a reference.

Positions are WGS 84 degrees with metres above its ellipsoid. Yaw, pitch and roll are those of Metashape's reference
pane and of OpenDroneMap, after Bäumker and Heimes (2001): at zero the camera looks straight down with the top of its
picture to true North; yaw turns clockwise, pitch 90 looks at the horizon, roll lowers the picture's right side;
ned_from_body = Rz(yaw) Ry(pitch) Rx(roll), body axes being the picture's top, its right and the optical axis.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pyproj import CRS

from missions.frames import Array, Site, ned_from_enu
from perception.reconstruct.bundle import Accuracy
from perception.reconstruct.pictures import SurveyPicture

WGS84 = 4326
CAMERA_FROM_BODY = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
LEVEL_LIMIT = 1e-6
"""Within this of pitch 90 yaw and roll turn about one axis; roll is 0 there. views.csv itself is exact to 1e-9."""
LEAST_POSITION_M = 0.01
LEAST_ATTITUDE_DEG = 0.1
"""No better accuracies are told: the site's anchor agrees with a true ENU frame so well, and 0 would mean unknown."""
HEIGHTS = "heights: metres above the WGS 84 ellipsoid"


def yaw_pitch_roll_deg(enu_from_camera: Array) -> tuple[float, float, float]:
    """Yaw in [0, 360), pitch in [-90, 270), roll in [-90, 90] of a rotation (3, 3); pitch above 90 looks upwards."""
    m = ned_from_enu((enu_from_camera @ CAMERA_FROM_BODY).T).T
    level = math.hypot(m[2, 1], m[2, 2])
    if level < LEVEL_LIMIT:
        turned = math.atan2(-m[0, 1], m[1, 1])
        return math.degrees(turned) % 360.0, math.copysign(90.0, -m[2, 0]), 0.0
    side = -1.0 if m[2, 2] < 0.0 else 1.0
    yaw = math.atan2(side * m[1, 0], side * m[0, 0])
    pitch, roll = math.atan2(-m[2, 0], side * level), math.atan2(side * m[2, 1], side * m[2, 2])
    return math.degrees(yaw) % 360.0, (math.degrees(pitch) + 90.0) % 360.0 - 90.0, math.degrees(roll)


def write_metashape(pictures: list[SurveyPicture], site: Site, accuracy: Accuracy, path: Path) -> None:
    """A CSV for Metashape's File > Import > Import Reference, in the layout of its own export: comments, then a row per
    picture with its file's name, and how exactly position (m) and attitude (degrees) were measured."""
    metres, degrees = _position_accuracy_m(accuracy), max(math.degrees(accuracy.attitude_rad), LEAST_ATTITUDE_DEG)
    exactly = f"{metres:g},{metres:g},{metres:g},{degrees:g},{degrees:g},{degrees:g}"
    names = "#Label,Longitude,Latitude,Altitude,Yaw,Pitch,Roll," + ",".join(
        f"{what} accuracy" for what in ("Longitude", "Latitude", "Altitude", "Yaw", "Pitch", "Roll"))
    rows = [",".join([name, *numbers, exactly]) for name, numbers in _rows(pictures, site)]
    crs = CRS.from_epsg(WGS84).to_wkt("WKT1_GDAL")
    path.write_text("\n".join([f"# CoordinateSystem: {crs}", f"# {HEIGHTS}", names, *rows, ""]), encoding="utf-8")


def write_geo(pictures: list[SurveyPicture], site: Site, accuracy: Accuracy, path: Path) -> None:
    """OpenDroneMap's image geolocation file (docs.opendronemap.org/geo): the CRS, then a row per picture."""
    metres = _position_accuracy_m(accuracy)
    rows = [" ".join([name, *numbers, f"{metres:g} {metres:g}"]) for name, numbers in _rows(pictures, site)]
    path.write_text("\n".join([f"EPSG:{WGS84}", f"# {HEIGHTS}", *rows, ""]), encoding="utf-8")


def _rows(pictures: list[SurveyPicture], site: Site) -> Iterator[tuple[str, list[str]]]:
    """Name of each file, with longitude, latitude, altitude, yaw, pitch, roll."""
    for p in pictures:
        lat, lon, alt = site.geodetic_from_enu(p.position_enu_m)
        angles = [f"{v:.7f}" for v in yaw_pitch_roll_deg(p.enu_from_camera)]
        yield p.path.name, [f"{lon:.11f}", f"{lat:.11f}", f"{alt:.5f}", *angles]


def _position_accuracy_m(accuracy: Accuracy) -> float:
    return max(accuracy.position_m, LEAST_POSITION_M)
