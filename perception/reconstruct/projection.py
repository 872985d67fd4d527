"""Where the site lies in a projected coordinate reference system, through PROJ.

Heights are never above a geoid: they are metres above the ellipsoid of the CRS's own datum, and the CRS says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from missions.errors import UserError
from missions.frames import Array, Site

WGS84_3D = 4979
STEP_M = 10.0
"""Of the finite differences that give direction and scale of the grid; both are constant over a site."""
LARGEST_STRETCH = 0.01
UTM_LATITUDES_DEG = (-80.0, 84.0)
ELLIPSOIDAL_WKT1 = ('VERT_CS["Ellipsoid (metre)",VERT_DATUM["Ellipsoid",2002],UNIT["metre",1,AUTHORITY["EPSG","9001"]],'
                    'AXIS["Ellipsoidal height",UP]]')
"""How GDAL and PROJ say ellipsoidal height in WKT 1, which has no three-dimensional projected CRS; 2002 is its type."""


@dataclass(frozen=True)
class Projection:
    """From a site's ENU frame to easting, northing and ellipsoidal height of a projected CRS in metres."""

    site: Site
    epsg: int

    @cached_property
    def horizontal(self) -> CRS:
        """The CRS without heights."""
        return CRS.from_epsg(self.epsg)

    @property
    def wkt1(self) -> str:
        """The CRS with ellipsoidal heights in WKT 1 (OGC 01-009), as LAS 1.4 asks for it."""
        plane = self.horizontal
        return f'COMPD_CS["{plane.name} + Ellipsoid (metre)",{plane.to_wkt("WKT1_GDAL")},{ELLIPSOIDAL_WKT1}]'

    def grid_from_enu(self, position_enu_m: NDArray[np.floating]) -> Array:
        """(n, 3) easting, northing, height above the CRS's ellipsoid, metres, of positions (n, 3)."""
        lat, lon, alt = self.site.geodetic_rows_from_enu(np.asarray(position_enu_m, np.float64)).T
        return np.column_stack(self._transformer.transform(lon, lat, alt))

    def enu_from_grid(self, position_grid_m: NDArray[np.floating]) -> Array:
        """(n, 3) ENU metres at the height of the origin, of eastings and northings (n, 2)."""
        height = np.full(len(position_grid_m), self.height_of_enu_m)
        east, north = np.asarray(position_grid_m, np.float64).T
        lon, lat, alt = self._transformer.transform(east, north, height, direction="INVERSE")
        return np.array([self.site.enu_from_geodetic(*row) for row in zip(lat, lon, alt, strict=True)])

    @cached_property
    def height_of_enu_m(self) -> float:
        """What to add to an up coordinate for the height above the CRS's ellipsoid."""
        return float(self.grid_from_enu(np.zeros((1, 3)))[0, 2])

    def grid_directions_from_enu(self, direction_enu: NDArray[np.floating]) -> Array:
        """(n, 3) directions turned from true North to the grid's North (meridian convergence)."""
        north = self._north_step
        c, s = north[1] / np.hypot(*north), -north[0] / np.hypot(*north)
        grid_from_enu = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(np.asarray(direction_enu, np.float64) @ grid_from_enu.T)

    @property
    def scale(self) -> float:
        """Grid metres per metre on the ground at the site's origin."""
        return float(np.hypot(*self._north_step)) / STEP_M

    @property
    def accuracy_m(self) -> float | None:
        """How exactly PROJ knows the CRS's datum against WGS 84; 0 for the same datum, None when it does not say."""
        self.grid_from_enu(np.zeros((1, 3)))
        accuracy = float(self._transformer.get_last_used_operation().accuracy)
        return accuracy if accuracy >= 0.0 else None

    @cached_property
    def _transformer(self) -> Transformer:
        return Transformer.from_crs(CRS.from_epsg(WGS84_3D), self.horizontal.to_3d(), always_xy=True,
                                    allow_ballpark=False)

    @cached_property
    def _north_step(self) -> Array:
        """(2,) how far a step of STEP_M to the North goes on the grid."""
        here, there = self.grid_from_enu(np.array([[0.0, 0.0, 0.0], [0.0, STEP_M, 0.0]]))
        return np.asarray((there - here)[:2])


def utm_epsg(site: Site) -> int:
    """EPSG code of the site's UTM zone on WGS 84, by longitude alone (no exceptions for Norway and Svalbard)."""
    if not UTM_LATITUDES_DEG[0] <= site.lat_deg <= UTM_LATITUDES_DEG[1]:
        raise UserError(f"site.origin_lat_deg {site.lat_deg}: UTM ends at 80 degrees South and 84 North; name a "
                        "projected CRS with --crs, such as 5041 (North) or 5042 (South).")
    zone = math.floor((site.lon_deg + 180.0) / 6.0) % 60 + 1
    return (32600 if site.lat_deg >= 0.0 else 32700) + zone


def projection(site: Site, epsg: int | None = None) -> Projection:
    """Into this CRS, else into the site's UTM zone.

    Raises UserError when there is no such CRS, or it is not projected, not in metres, not for this place or stretched.
    """
    found = Projection(site, utm_epsg(site) if epsg is None else epsg)
    try:
        crs = found.horizontal
    except CRSError as e:
        raise UserError(f"--crs {epsg}: no such EPSG code; {_remedy(site)}.") from e
    if not crs.is_projected or {axis.unit_name for axis in crs.axis_info} != {"metre"}:
        raise UserError(f"--crs {epsg}: {crs.name} is not a projected CRS in metres; {_remedy(site)}.")
    if not _serves(crs, site):
        raise UserError(f"--crs {epsg}: {crs.name} does not reach the site at {site.lat_deg:.4f}, {site.lon_deg:.4f} "
                        f"(site.origin_lat_deg, origin_lon_deg); {_remedy(site)}.")
    if not math.isfinite(found.scale):
        raise UserError(f"--crs {epsg}: no transformation from WGS 84 to {crs.name} is known here; {_remedy(site)}.")
    if abs(found.scale - 1.0) > LARGEST_STRETCH:
        raise UserError(f"--crs {epsg}: {crs.name} makes {found.scale:.2f} m out of a metre at the site; "
                        f"{_remedy(site)}.")
    return found


def _serves(crs: CRS, site: Site) -> bool:
    """Whether the site lies in the CRS's area of use, which may cross the antimeridian."""
    area = crs.area_of_use
    if area is None:
        return True
    width_deg = (area.east - area.west) % 360.0 or 360.0
    return (site.lon_deg - area.west) % 360.0 <= width_deg and area.south <= site.lat_deg <= area.north


def _remedy(site: Site) -> str:
    if not UTM_LATITUDES_DEG[0] <= site.lat_deg <= UTM_LATITUDES_DEG[1]:
        return "give the code of one that is"
    return f"give the code of one that is, or leave --crs out for UTM ({utm_epsg(site)})"
