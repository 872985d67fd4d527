"""Ground, road, trees and rocks around an object; never part of the object.

Free for flying: nothing taller than 1 m within 12 m of the object's box, and south of it (towards -y) no tree or rock
within 20 m, so that take-off pads have room there.
"""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from sim_bridge.scenes import textures
from sim_bridge.scenes.scene import Part
from sim_bridge.scenes.solids import Solid, lathe, planar_mapped, plate, textured

PREFIX = "surroundings_"
GROUND = PREFIX + "ground"
APRON_M, FREE_M, FREE_SOUTH_M = 6.0, 12.0, 20.0
ROAD_FROM_M, ROAD_WIDTH_M = 17.0, 6.0

Array = NDArray[np.float64]


def ground(rng: np.random.Generator, lo: Array, hi: Array, ground_up_m: float, road: bool) -> list[Part]:
    """Flat ground of at least 160 x 160 m: grass, a gravel apron under the object and, if wanted, a road north of it.

    lo, hi: (3,) corners of the object's box.
    """
    west, south, east, north = extent(lo, hi)
    apron = (lo[0] - APRON_M, lo[1] - APRON_M, hi[0] + APRON_M, hi[1] + APRON_M)
    lane = (west, hi[1] + ROAD_FROM_M, east, hi[1] + ROAD_FROM_M + ROAD_WIDTH_M)
    holes = [apron, lane] if road else [apron]
    parts = [
        textured(GROUND, [plate((west, south), (east, north), ground_up_m, holes)], textures.grass(rng),
                 is_object=False),
        textured(PREFIX + "apron", [plate(apron[:2], apron[2:], ground_up_m)], textures.gravel(rng), is_object=False),
    ]
    if road:
        parts.append(textured(PREFIX + "road", [plate(lane[:2], lane[2:], ground_up_m)], textures.asphalt(rng),
                              is_object=False))
    return parts


def growth(rng: np.random.Generator, lo: Array, hi: Array, ground_up_m: float,
           wet: tuple[float, float] | None = None) -> list[Part]:
    """Trees and rocks standing on the ground outside the free zone around the box lo, hi (3,).

    wet: from where to where along x a river flows, if one does.
    """
    trunks, crowns, rocks = [], [], []
    for x, y in _sites(rng, lo, hi, 14, 5.0, wet):
        trunk, crown = _tree(rng, np.array([x, y, ground_up_m]))
        trunks.append(trunk)
        crowns += crown
    for x, y in _sites(rng, lo, hi, 24, 2.4, wet):
        radii = rng.uniform(0.4, 1.4) * np.array([1.0, rng.uniform(0.6, 1.0), rng.uniform(0.4, 0.7)])
        rocks.append(_blob(rng, np.array([x, y, ground_up_m]), radii, 2, 0.16))
    return [
        textured(PREFIX + "trunks", trunks, textures.bark(rng), is_object=False),
        textured(PREFIX + "crowns", crowns, textures.foliage(rng), is_object=False),
        textured(PREFIX + "rocks", rocks, textures.rock(rng), is_object=False),
    ]


def extent(lo: Array, hi: Array) -> tuple[float, float, float, float]:
    """West, south, east and north end of the ground around the box lo, hi (3,)."""
    middle, half = (lo[:2] + hi[:2]) / 2, np.maximum(80.0, (hi[:2] - lo[:2]) / 2 + 50.0)
    (west, south), (east, north) = middle - half, middle + half
    return float(west), float(south), float(east), float(north)


def _sites(rng: np.random.Generator, lo: Array, hi: Array, count: int, radius_m: float,
           wet: tuple[float, float] | None) -> list[tuple[float, float]]:
    """Places where something of this radius may stand: off the free zone, the road and the river, within view."""
    reach = 42.0
    found: list[tuple[float, float]] = []
    while len(found) < count:
        x, y = (float(rng.uniform(lo[i] - reach, hi[i] + reach)) for i in range(2))
        outside = max(lo[0] - x, x - hi[0], lo[1] - y, y - hi[1]) - radius_m
        on_road = ROAD_FROM_M - radius_m < y - hi[1] < ROAD_FROM_M + ROAD_WIDTH_M + radius_m
        on_pads = -radius_m < lo[1] - y < FREE_SOUTH_M + radius_m
        afloat = wet is not None and wet[0] - radius_m < x < wet[1] + radius_m
        if outside > FREE_M and not (on_road or on_pads or afloat):
            found.append((x, y))
    return found


def _tree(rng: np.random.Generator, foot: Array) -> tuple[Solid, list[Solid]]:
    height = float(rng.uniform(5.0, 8.0))
    heights = np.linspace(0.0, height * 0.75, 6)
    trunk = lathe(np.stack([0.28 * (1.0 - 0.11 * heights) + 0.15 * np.exp(-4.0 * heights), heights], axis=1), foot, 10)
    crown = []
    for _ in range(3):
        offset = np.array([*rng.uniform(-1.3, 1.3, 2), height * rng.uniform(0.6, 0.95)])
        crown.append(_blob(rng, foot + offset, rng.uniform(1.2, 1.9) * np.array([1.0, 1.0, 0.85]), 3, 0.2))
    return trunk, crown


def _blob(rng: np.random.Generator, centre: Array, radii: Array, subdivisions: int, roughness: float) -> Solid:
    """A lumpy ellipsoid: a sphere whose radius is a sum of random waves."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    direction = np.asarray(sphere.vertices, dtype=np.float64)
    waves = rng.normal(0.0, 1.0, (12, 3)) * np.array([2.0, 4.0, 8.0]).repeat(4)[:, None]
    swell = np.sin(direction @ waves.T + rng.uniform(0.0, 2.0 * np.pi, 12)) / np.array([2.0, 4.0, 8.0]).repeat(4)
    scale = np.clip(1.0 + roughness * swell.sum(axis=1), 0.5, 1.6)
    return planar_mapped(centre + direction * scale[:, None] * radii, np.asarray(sphere.faces, dtype=np.int32))
