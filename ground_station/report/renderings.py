"""The reconstruction from several sides: in colour, by confidence, and what is missing (thesis Figs. 5.16-5.18)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ground_station.report.splat import Pixels, ramp, splat
from perception.evaluate.comparison import MISSING_M, Comparison
from perception.evaluate.inspection import Inspection
from perception.evaluate.reference import Reference
from perception.products.atlas import Textured
from perception.products.picture_of_model import picture_of
from perception.reconstruct.cloud import Cloud, on_grid

CONFIDENCE_STOPS = ((178, 24, 43), (244, 165, 80), (255, 224, 120), (120, 198, 121), (0, 104, 90))
ABSENT_M = 0.50
MISSING_COLOUR, PARTIAL_COLOUR, PRESENT_COLOUR = (200, 30, 40), (240, 150, 50), (196, 202, 210)
BEYOND_COLOUR = (120, 80, 170)
ERROR_STOPS = ((214, 226, 214), (120, 198, 121), (255, 224, 120), (244, 120, 60), (178, 24, 43))
WORST_M = 0.08
"""Errors from here on have the last colour; the first quarter of the scale is what counts as within 2 cm."""
WIDTH_PX, HERO_WIDTH_PX = 760, 1180
SHOWN_SPACING_M = 0.05


@dataclass(frozen=True)
class Side:
    """A direction of view."""

    name: str
    yaw_deg: float
    elevation_deg: float


SIDES = (Side("from the south-west, above", 60.0, -25.0), Side("from the north-east, above", 240.0, -25.0),
         Side("from the south, below", 70.0, 20.0))


def thinned(cloud: Cloud, spacing_m: float) -> tuple[Cloud, float]:
    """The cloud as dense as the pictures can show it, and its spacing."""
    spacing_m = max(spacing_m, SHOWN_SPACING_M)
    return on_grid(cloud, spacing_m), spacing_m


def hero(cloud: Cloud, spacing_m: float) -> Pixels:
    """The cloud in its own colours, large."""
    return _render(cloud.points_enu_m, cloud.colours, SIDES[0], HERO_WIDTH_PX, spacing_m)


def in_colour(cloud: Cloud, spacing_m: float) -> list[tuple[str, Pixels]]:
    """The cloud in its own colours from every side."""
    return [(s.name, _render(cloud.points_enu_m, cloud.colours, s, WIDTH_PX, spacing_m)) for s in SIDES]


def hero_of_model(model: Textured) -> Pixels:
    """The textured model, large."""
    return _picture(model, SIDES[0], HERO_WIDTH_PX)


def model_in_colour(model: Textured) -> list[tuple[str, Pixels]]:
    """The textured model from every side."""
    return [(s.name, _picture(model, s, WIDTH_PX)) for s in SIDES]


def _picture(model: Textured, side: Side, width_px: int) -> Pixels:
    return picture_of(model, math.radians(side.yaw_deg), math.radians(side.elevation_deg), width_px)


def by_confidence(cloud: Cloud, spacing_m: float, least: int) -> list[tuple[str, Pixels]]:
    """The cloud coloured by the number of agreeing depth maps, from `least` (red) to 10 and more (green)."""
    colours = ramp(cloud.confidence.astype(np.float64), least, 10.0, CONFIDENCE_STOPS)
    return [(s.name, _render(cloud.points_enu_m, colours, s, WIDTH_PX, spacing_m)) for s in SIDES]


def missing(measured: Comparison, reachable: NDArray[np.bool_] | None = None) -> list[tuple[str, Pixels]]:
    """The true surface: grey where reconstructed, orange 25-50 cm from the cloud, red where farther; violet where it is
    missing and no three pictures from within reach (n,) could have shown it."""
    points = measured.reference.samples_enu_m.astype(np.float32)
    return _surface(points, missing_colours(measured, reachable))


def missing_colours(measured: Comparison, reachable: NDArray[np.bool_] | None = None) -> Pixels:
    """(n, 3) colours of the samples in the pictures of what is missing."""
    colours = np.full((len(measured.c2c_m), 3), PRESENT_COLOUR, dtype=np.uint8)
    colours[measured.c2c_m > MISSING_M] = PARTIAL_COLOUR
    colours[measured.c2c_m > ABSENT_M] = MISSING_COLOUR
    if reachable is not None:
        colours[(measured.c2c_m > MISSING_M) & ~reachable] = BEYOND_COLOUR
    return colours


def by_error(measured: Comparison) -> list[tuple[str, Pixels]]:
    """The uniform sampling of the cloud by distance to the true surface."""
    colours = ramp(np.abs(measured.uniform_c2m_m), 0.0, WORST_M, ERROR_STOPS)
    return [(s.name, _render(measured.uniform.points_enu_m, colours, s, WIDTH_PX, max(measured.spacing_m,
                                                                                      SHOWN_SPACING_M))) for s in SIDES]


def by_quality(reference: Reference, found: Inspection) -> list[tuple[str, Pixels]]:
    """The true surface coloured by the quality of its best picture, from 0 (red) to 1 (green)."""
    return _surface(reference.samples_enu_m.astype(np.float32), ramp(found.quality, 0.0, 1.0, CONFIDENCE_STOPS))


def _surface(points: NDArray[np.float32], colours: Pixels) -> list[tuple[str, Pixels]]:
    """Samples of a surface from every side, each as large as they lie apart."""
    few = points[:: max(1, len(points) // 2000)]
    spacing_m = float(np.median(cKDTree(points).query(few, k=4)[0][:, 3]))
    return [(s.name, _render(points, colours, s, WIDTH_PX, 1.5 * spacing_m)) for s in SIDES]


def _render(points: NDArray[np.float32], colours: Pixels, side: Side, width_px: int, point_m: float) -> Pixels:
    yaw, elevation = math.radians(side.yaw_deg), math.radians(side.elevation_deg)
    return splat(points, colours, yaw, elevation, width_px, 1.3 * point_m)
