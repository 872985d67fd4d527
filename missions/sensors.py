"""Geometry of the simulated range sensor that sender and receiver share."""

from __future__ import annotations

import math

import numpy as np

from missions.frames import Array

RANGE_DIRECTION_COUNT = 1280
HIT_RADIUS_M = 0.2
"""A hit stands for the surface around it, which the rays beside it missed."""


def fibonacci_directions(count: int) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere (Fibonacci lattice)."""
    i = np.arange(count) + 0.5
    z = 1.0 - 2.0 * i / count
    r = np.sqrt(1.0 - z * z)
    angle = math.pi * (1.0 + math.sqrt(5.0)) * i
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1)


RANGE_DIRECTIONS = fibonacci_directions(RANGE_DIRECTION_COUNT)
"""(1280, 3) ENU unit vectors, about 5.6 degrees apart: half as many see thin beams too late."""
