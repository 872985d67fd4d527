"""Ground control points from a CSV file: a row for every mark of a point in a picture.

Columns: name, picture, x_px, y_px (pixels of the file as it is stored; the centre of the first one is 0.5, 0.5), role
(control or check; control when left out), and the point's place: lat_deg, lon_deg, height_m (WGS 84, above the
ellipsoid), or x, y, z in a projected CRS that is named by its EPSG code, or east_m, north_m, up_m of the run's ENU.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from ground_station.csv_table import read_table
from missions.errors import UserError
from missions.frames import Array, Site
from perception.reconstruct.control_points import ControlPoint

PLACES = (("lat_deg", "lon_deg", "height_m"), ("x", "y", "z"), ("east_m", "north_m", "up_m"))
ROLES = ("control", "check")
WGS84_3D = 4979


@dataclass(frozen=True)
class MarkedPoint:
    """A point with its marks by picture's name. geodetic: lat, lon, height; else place is ENU metres."""

    name: str
    role: str
    place: tuple[float, float, float]
    geodetic: bool
    marks: dict[str, Array] = field(default_factory=dict)

    def placed(self, site: Site, number_of: dict[str, int]) -> ControlPoint:
        """In a site's ENU, with pictures by number; marks in other pictures are left out."""
        place = site.enu_from_geodetic(*self.place) if self.geodetic else np.array(self.place)
        marks = {number_of[name]: mark for name, mark in self.marks.items() if name in number_of}
        return ControlPoint(self.name, place, self.role == "check", marks)


def read_control(path: Path, epsg: int | None = None) -> list[MarkedPoint]:
    """The points in order of appearance. epsg: CRS of x, y, z. Raises UserError naming file, line and remedy."""
    rows, columns = read_table(path)
    missing = [c for c in ("name", "picture", "x_px", "y_px") if c not in columns]
    place = next((names for names in PLACES if columns.issuperset(names)), None)
    if missing or place is None:
        raise UserError(f"{path}: columns {', '.join(missing) or 'of the place'} are missing; add them (name, picture, "
                        "x_px, y_px and lat_deg, lon_deg, height_m or x, y, z or east_m, north_m, up_m).")
    to_geodetic = _to_geodetic(path, epsg) if place == PLACES[1] else None
    points: dict[str, MarkedPoint] = {}
    for line, row in enumerate(rows, start=2):
        point, picture, mark = _row(path, line, row, place, to_geodetic)
        known = points.setdefault(point.name, point)
        if (known.place, known.role) != (point.place, point.role):
            raise UserError(f"{path}: line {line}: {point.name} has another place or role before; make them equal.")
        known.marks[picture] = mark
    return list(points.values())


def _to_geodetic(path: Path, epsg: int | None) -> Transformer:
    if epsg is None:
        raise UserError(f"{path}: x, y and z need the CRS that they are in; name it with --control-crs, such as 25832.")
    try:
        return Transformer.from_crs(CRS.from_epsg(epsg).to_3d(), CRS.from_epsg(WGS84_3D), always_xy=True)
    except CRSError as e:
        raise UserError(f"--control-crs {epsg}: no such EPSG code; give that of the points.") from e


def _row(path: Path, line: int, row: dict[str, str], place: tuple[str, ...],
         to_geodetic: Transformer | None) -> tuple[MarkedPoint, str, Array]:
    try:
        x, y, z = (float(row[c]) for c in place)
        mark = np.array([float(row["x_px"]), float(row["y_px"])])
    except (TypeError, ValueError) as e:
        raise UserError(f"{path}: line {line}: {e}; write numbers there.") from e
    role = (row.get("role") or ROLES[0]).strip()
    if role not in ROLES or not row["name"] or not row["picture"]:
        raise UserError(f"{path}: line {line}: name and picture must be there and role be control or check; mend it.")
    if to_geodetic is not None:
        lon, lat, height = to_geodetic.transform(x, y, z)
        x, y, z = lat, lon, height
    if not all(map(math.isfinite, (x, y, z, *mark))):
        raise UserError(f"{path}: line {line}: not a finite place and mark; mend it.")
    return MarkedPoint(row["name"].strip(), role, (x, y, z), place != PLACES[2]), row["picture"].strip(), mark


def copy_control(points: list[MarkedPoint], site: Site, path: Path) -> None:
    """The same points in the run's own ENU, for the run folder."""
    with path.open("w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f)
        writer.writerow(("name", "role", *PLACES[2], "picture", "x_px", "y_px"))
        for point in points:
            place = point.placed(site, {}).place_enu_m.tolist()
            writer.writerows([point.name, point.role, *place, picture, *mark.tolist()]
                             for picture, mark in point.marks.items())
