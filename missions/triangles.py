"""Triangles as Open3D needs them, which reckons in single precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array

Indices = NDArray[np.int64]

MOST_SLENDER_M = 1000.0
"""Length^3 / height^2 of a triangle at which nearest points are right to about 0.1 mm."""
LEAST_HEIGHT_M = 0.002
"""Thinner triangles, also those without area, are cut as if they were so wide: into pieces of 16 cm."""


def without_slivers(corners_enu_m: Array) -> tuple[Array, Indices]:
    """Triangles (m, 3, 3) cut across their longest edges until none is so long and thin that the nearest point on it is
    wrong in single precision, in which Open3D reckons: (k, 3, 3), and (k,) which one each piece is of.

    Its place along a triangle of length l and height h is off by up to about 1e-7 l^3 / h^2: 3 cm were seen on a
    ledge of 49.5 x 0.12 m.
    """
    of = np.arange(len(corners_enu_m), dtype=np.int64)
    done: list[tuple[Array, Indices]] = []
    while True:
        edges = np.linalg.norm(np.roll(corners_enu_m, -1, axis=1) - corners_enu_m, axis=2)
        longest = edges.max(axis=1, initial=0.0)
        area = 0.5 * np.linalg.norm(np.cross(corners_enu_m[:, 1] - corners_enu_m[:, 0],
                                             corners_enu_m[:, 2] - corners_enu_m[:, 0]), axis=1)
        height = np.maximum(2.0 * area / np.maximum(longest, 1e-12), LEAST_HEIGHT_M)
        sliver = longest**3 > MOST_SLENDER_M * height**2
        done.append((corners_enu_m[~sliver], of[~sliver]))
        if not sliver.any():
            return np.concatenate([c for c, _ in done]), np.concatenate([o for _, o in done])
        first = edges[sliver].argmax(axis=1)[:, None] + np.arange(3)
        a, b, c = np.take_along_axis(corners_enu_m[sliver], (first % 3)[:, :, None], axis=1).swapaxes(0, 1)
        middle = 0.5 * (a + b)
        corners_enu_m = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        of = np.tile(of[sliver], 2)
