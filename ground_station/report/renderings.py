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
from perception.reconstruct.cloud import Cloud, on_grid

CONFIDENCE_STOPS = ((178, 24, 43), (244, 165, 80), (255, 224, 120), (120, 198, 121), (0, 104, 90))
ABSENT_M = 0.50
MISSING_COLOUR, PARTIAL_COLOUR, PRESENT_COLOUR = (200, 30, 40), (240, 150, 50), (196, 202, 210)
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


def by_confidence(cloud: Cloud, spacing_m: float, least: int) -> list[tuple[str, Pixels]]:
    """The cloud coloured by the number of agreeing depth maps, from `least` (red) to 10 and more (green)."""
    colours = ramp(cloud.confidence.astype(np.float64), least, 10.0, CONFIDENCE_STOPS)
    return [(s.name, _render(cloud.points_enu_m, colours, s, WIDTH_PX, spacing_m)) for s in SIDES]


def missing(measured: Comparison) -> list[tuple[str, Pixels]]:
    """The true surface: grey where reconstructed, orange 25-50 cm from the cloud, red where farther."""
    points = measured.reference.samples_enu_m.astype(np.float32)
    colours = np.full((len(points), 3), PRESENT_COLOUR, dtype=np.uint8)
    colours[measured.c2c_m > MISSING_M] = PARTIAL_COLOUR
    colours[measured.c2c_m > ABSENT_M] = MISSING_COLOUR
    return _surface(points, colours)


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
