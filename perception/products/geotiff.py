"""Rasters as GeoTIFF (OGC 19-008r4), by Pillow: position, cell size and EPSG code in TIFF tags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, TiffTags
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from perception.products.rasters import NO_HEIGHT, Raster

PIXEL_SCALE, TIEPOINT, GEO_KEYS, GDAL_NO_DATA = 33550, 33922, 34735, 42113
MODEL_TYPE, RASTER_TYPE, PROJECTED_CRS = 1024, 1025, 3072
PROJECTED, PIXEL_IS_AREA = 1, 1
COMPRESSION = "tiff_adobe_deflate"


def write_orthophoto(raster: Raster, path: Path) -> None:
    """RGBA, transparent where nothing was seen. Raises OSError when it cannot be written."""
    _write(raster, raster.colours, "Orthophoto", path)


def write_dsm(raster: Raster, path: Path) -> None:
    """float32 metres above the ellipsoid of the CRS; NO_HEIGHT where nothing was seen. Raises OSError likewise."""
    _write(raster, raster.height_m, "Surface model, metres above the ellipsoid of the CRS", path)


def _write(raster: Raster, values: NDArray[np.generic], what: str, path: Path) -> None:
    tags = ImageFileDirectory_v2()
    keys = ((MODEL_TYPE, PROJECTED), (RASTER_TYPE, PIXEL_IS_AREA), (PROJECTED_CRS, raster.projection.epsg))
    _tag(tags, PIXEL_SCALE, TiffTags.DOUBLE, (raster.gsd_m, raster.gsd_m, 0.0))
    _tag(tags, TIEPOINT, TiffTags.DOUBLE, (0.0, 0.0, 0.0, raster.left_m, raster.top_m, 0.0))
    _tag(tags, GEO_KEYS, TiffTags.SHORT, (1, 1, 1, len(keys), *(n for key, value in keys for n in (key, 0, 1, value))))
    if values.ndim == 2:
        _tag(tags, GDAL_NO_DATA, TiffTags.ASCII, f"{NO_HEIGHT:g}")
    Image.fromarray(values).save(path, "TIFF", compression=COMPRESSION, tiffinfo=tags, software="swarmscan",
                                 description=what)


def _tag(tags: ImageFileDirectory_v2, tag: int, kind: int, value: tuple[float, ...] | str) -> None:
    tags.tagtype[tag] = kind
    tags[tag] = value
