"""A river through flat country in place of the common ground: meadows, quays, water, a weir for the take-off points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes import textures
from sim_bridge.scenes.scene import Part
from sim_bridge.scenes.solids import Solid, box, plate, textured
from sim_bridge.scenes.surroundings import GROUND, PREFIX, extent, growth

Array = NDArray[np.float64]

WATER = PREFIX + "water"
BED_M = -2.0
"""Height at which what stands in the river begins, below any water."""
QUAY_M = 0.6
WEIR_FROM_M, WEIR_TO_M = 8.5, 15.5
"""The weir's distance from the object's box, towards -y: pads stand on it."""


def river(rng: np.random.Generator, lo: Array, hi: Array, half_m: float, water_up_m: float,
          footings: list[Solid]) -> list[Part]:
    """Ground at height 0 with a river along y between x = -half_m and half_m, its water at water_up_m < 0.

    lo, hi: (3,) corners of the object's box. footings: what of the structure's foundations rises from the water.
    """
    west, south, east, north = extent(lo, hi)
    wall = half_m + QUAY_M
    meadow = [plate((west, south), (east, north), 0.0, [(-wall, south, wall, north)])]
    quays = [box((s * half_m if s > 0 else -wall, south, BED_M), (wall if s > 0 else s * half_m, north, 0.0))
             for s in (-1.0, 1.0)]
    weir = box((-half_m, lo[1] - WEIR_TO_M, BED_M), (half_m, lo[1] - WEIR_FROM_M, 0.0))
    stone = textures.stone(rng)
    return [
        textured(GROUND, meadow, textures.grass(rng), is_object=False),
        textured(PREFIX + "quays", quays, stone, is_object=False),
        textured(PREFIX + "weir", [weir, *footings], textures.concrete(rng), is_object=False),
        _water((-half_m, south), (half_m, north), water_up_m),
        *growth(rng, lo, hi, 0.0, wet=(-wall, wall)),
    ]


def _water(lo: tuple[float, float], hi: tuple[float, float], up_m: float) -> Part:
    flat = plate(lo, hi, up_m)
    return Part(WATER, flat.vertices_m, flat.faces, None, None, (58, 78, 72), False, True, water=True)
