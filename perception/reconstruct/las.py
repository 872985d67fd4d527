"""The cloud as LAS 1.4 or LAZ, in a projected CRS."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
from laspy.vlrs.known import WktCoordinateSystemVlr

from perception.reconstruct.cloud import Cloud
from perception.reconstruct.projection import Projection

POINT_FORMAT = 7
"""Coordinates and colours; colours and a WKT of the CRS in one file need 7 or more."""
RESOLUTION_M = 1e-4
FULL_16_BIT = 257
"""LAS colours have 16 bits: 255 becomes 65535."""
NORMALS = ("NormalX", "NormalY", "NormalZ")
"""The names under which CloudCompare and PDAL know them."""


def write_las(cloud: Cloud, where: Projection, path: Path) -> None:
    """Point format 7, with `confidence` (uint8, agreeing depth maps) and NORMALS (float32, grid axes) in extra bytes.

    Compressed when the name ends in .laz. The CRS is in the header as WKT; z is metres above its ellipsoid.
    Raises OSError when the file cannot be written.
    """
    grid = where.grid_from_enu(cloud.points_enu_m)
    header = laspy.LasHeader(point_format=POINT_FORMAT, version="1.4")
    header.generating_software = "swarmscan"
    header.scales, header.offsets = np.full(3, RESOLUTION_M), np.floor(grid.min(axis=0))
    header.add_extra_dims([laspy.ExtraBytesParams("confidence", np.uint8, "agreeing depth maps"),
                           *(laspy.ExtraBytesParams(name, np.float32) for name in NORMALS)])
    header.vlrs.append(WktCoordinateSystemVlr(where.wkt1))
    header.global_encoding.wkt = True
    points = laspy.LasData(header)
    points.xyz = grid
    points.red, points.green, points.blue = cloud.colours.T.astype(np.uint16) * FULL_16_BIT
    points.return_number = points.number_of_returns = np.ones(len(cloud), np.uint8)
    points["confidence"] = cloud.confidence
    for name, values in zip(NORMALS, where.grid_directions_from_enu(cloud.normals).T, strict=True):
        points[name] = values.astype(np.float32)
    points.write(path)
