"""A model seen straight from above, on the grid of a projected CRS: orthophoto and surface model (DSM)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.errors import UserError
from missions.frames import Array
from perception.products.atlas import Textured
from perception.products.picture_of_model import seen_along
from perception.reconstruct.projection import Projection

NO_HEIGHT = -9999.0
SAMPLES = 2
"""Rays per cell along each axis."""
TILE_CELLS = 512
MOST_CELLS = 400_000_000
DOWN_ENU = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class Raster:
    """Cells of gsd_m, rows from North to South. colours (h, w, 4) RGBA, transparent where there is nothing;
    height_m (h, w) above the CRS's ellipsoid, NO_HEIGHT where there is nothing."""

    projection: Projection
    left_m: float
    """Easting of the left edge."""
    top_m: float
    """Northing of the upper edge."""
    gsd_m: float
    colours: NDArray[np.uint8]
    height_m: NDArray[np.float32]


def seen_from_above(model: Textured, where: Projection, gsd_m: float,
                    told: Callable[[int, int], None] = lambda done, total: None) -> Raster:
    """Colour and height of the highest surface in each cell; edges lie on whole multiples of gsd_m.

    Tile by tile, so that memory is what the raster itself takes. `told` hears of tiles done and in all.
    Raises UserError when the raster would have more than MOST_CELLS.
    """
    low, high = _bounds(model, where)
    left, top = math.floor(low[0] / gsd_m) * gsd_m, math.ceil(high[1] / gsd_m) * gsd_m
    width, height = (math.ceil(round(span / gsd_m, 6)) for span in (high[0] - left, top - low[1]))
    if width * height > MOST_CELLS:
        least = gsd_m * math.sqrt(width * height / MOST_CELLS)
        raise UserError(f"--gsd {gsd_m:g}: {width} x {height} cells are too many; give at least {least:.3g}.")
    raster = Raster(where, left, top, gsd_m, np.zeros((height, width, 4), np.uint8),
                    np.full((height, width), NO_HEIGHT, np.float32))
    tiles = list(_tiles(height, width))
    ceiling_m = float(model.surface.vertices_enu_m[:, 2].max()) + 1.0
    for done, (rows, columns) in enumerate(tiles, start=1):
        start = _starts(raster, rows, columns, ceiling_m)
        colours, distance = seen_along(model, start.reshape(-1, 3), DOWN_ENU)
        _fill(raster, rows, columns, colours, distance, ceiling_m)
        told(done, len(tiles))
    return raster


def _bounds(model: Textured, where: Projection) -> tuple[Array, Array]:
    grid = where.grid_from_enu(model.surface.vertices_enu_m)
    return grid.min(axis=0), grid.max(axis=0)


def _tiles(height: int, width: int) -> Iterator[tuple[slice, slice]]:
    for row in range(0, height, TILE_CELLS):
        for column in range(0, width, TILE_CELLS):
            yield slice(row, min(row + TILE_CELLS, height)), slice(column, min(column + TILE_CELLS, width))


def _starts(raster: Raster, rows: slice, columns: slice, up_m: float) -> Array:
    """(h, SAMPLES, w, SAMPLES, 3) where rays begin, ENU: exact at the tile's corners, between them on straight lines,
    which over a tile is less than a micrometre off."""
    north = raster.top_m - _inside(rows) * raster.gsd_m
    east = raster.left_m + _inside(columns) * raster.gsd_m
    corners = np.array([[e, n] for n in (north[0], north[-1]) for e in (east[0], east[-1])])
    a, b, c, d = raster.projection.enu_from_grid(corners)
    down = np.linspace(0.0, 1.0, len(north))[:, None, None]
    right = np.linspace(0.0, 1.0, len(east))[None, :, None]
    start = (a * (1.0 - right) + b * right) * (1.0 - down) + (c * (1.0 - right) + d * right) * down
    start[..., 2] = up_m
    return np.asarray(start.reshape(len(north) // SAMPLES, SAMPLES, len(east) // SAMPLES, SAMPLES, 3))


def _inside(cells: slice) -> Array:
    """Where the rays of cells go through, in cells."""
    count = (cells.stop - cells.start) * SAMPLES
    return np.asarray(cells.start + (np.arange(count) + 0.5) / SAMPLES)


def _fill(raster: Raster, rows: slice, columns: slice, colours: NDArray[np.float32], distance: Array,
          ceiling_m: float) -> None:
    """The mean colour and the height of the highest of each cell's rays that met something."""
    shape = (rows.stop - rows.start, SAMPLES, columns.stop - columns.start, SAMPLES)
    met = np.isfinite(distance).reshape(shape)
    count = met.sum(axis=(1, 3))
    total = np.where(met[..., None], colours.reshape(*shape, 3), 0.0).sum(axis=(1, 3))
    there = count > 0
    tile = raster.colours[rows, columns]
    tile[there, :3] = np.rint(total[there] / count[there, None])
    tile[there, 3] = 255
    nearest = distance.reshape(shape).min(axis=(1, 3))[there]
    raster.height_m[rows, columns][there] = ceiling_m - nearest + raster.projection.height_of_enu_m
