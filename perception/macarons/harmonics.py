"""Real spherical harmonics up to degree 7, and the directions from which a point has been seen as such coefficients.

Tesseral, orthonormal, with the Condon-Shortley phase; the polar angle is measured from +y and the azimuth from +z
towards +x, as in MACARONS.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

DEGREES = 8
COEFFICIENTS = DEGREES * DEGREES
"""The coefficient of degree l and order m stands at l * l + l + m."""
BIN_ELEVATIONS, BIN_AZIMUTHS = 7, 14
BINS = BIN_ELEVATIONS * BIN_AZIMUTHS
"""Directions that a view state tells apart: elevations -67.5 to 67.5 degrees, slowest, times azimuths."""


def harmonics(directions: Tensor) -> Tensor:
    """(..., 64) values of all harmonics in unit directions (..., 3)."""
    x, up, z = directions.unbind(-1)
    polar = _polar_parts(up)
    cosine, sine = torch.ones_like(x), torch.zeros_like(x)
    columns: list[Tensor] = [x] * COEFFICIENTS
    for m in range(DEGREES):
        for degree in range(m, DEGREES):
            part = _norm(degree, m) * polar[degree, m]
            columns[degree * degree + degree + m] = part * cosine
            if m:
                columns[degree * degree + degree - m] = part * sine
        cosine, sine = cosine * z - sine * x, sine * z + cosine * x
    return torch.stack(columns, dim=-1)


def _polar_parts(up: Tensor) -> dict[tuple[int, int], Tensor]:
    """Associated Legendre functions over sin(polar)^m, which the azimuthal part brings along."""
    parts: dict[tuple[int, int], Tensor] = {}
    for m in range(DEGREES):
        parts[m, m] = torch.full_like(up, (-1.0) ** m * math.prod(range(1, 2 * m, 2)))
        for degree in range(m + 1, DEGREES):
            below = parts[degree - 2, m] if degree - 2 >= m else torch.zeros_like(up)
            parts[degree, m] = ((2 * degree - 1) * up * parts[degree - 1, m] - (degree + m - 1) * below) / (degree - m)
    return parts


def _norm(degree: int, m: int) -> float:
    ratio = math.factorial(degree - m) / math.factorial(degree + m)
    return math.sqrt((2 * degree + 1) / (4 * math.pi) * ratio) * (math.sqrt(2.0) if m else 1.0)


def _angles() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(98,) elevations and azimuths of the bins, radians."""
    elevation = np.radians(-67.5 + 22.5 * np.arange(BIN_ELEVATIONS))
    azimuth = 2.0 * np.pi * np.arange(BIN_AZIMUTHS) / BIN_AZIMUTHS
    e, a = np.meshgrid(elevation, azimuth, indexing="ij")
    return e.ravel(), a.ravel()


def bin_directions() -> NDArray[np.float64]:
    """(98, 3) unit directions of the bins; world axes with z up, azimuth counter-clockwise from x."""
    e, a = _angles()
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)


def nearest_bin(directions: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) bin of each non-zero direction (n, 3) in elevation and azimuth; axes as in `bin_directions`."""
    elevation = np.degrees(np.arctan2(directions[:, 2], np.hypot(directions[:, 0], directions[:, 1])))
    row = np.clip(np.rint((elevation + 67.5) / 22.5), 0, BIN_ELEVATIONS - 1).astype(np.int64)
    turn = np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * np.pi)
    return row * BIN_AZIMUTHS + np.rint(turn * BIN_AZIMUTHS).astype(np.int64) % BIN_AZIMUTHS


def view_harmonics(seen_from: NDArray[np.bool_], frame_from_enu: NDArray[np.float64]) -> Tensor:
    """(n, 64) float32 coefficients, in the axes of frame_from_enu (3, 3), of view states (n, 98).

    A view state is the sum of unit impulses on its bins, each weighted with the bin's share of the sphere. MACARONS
    permutes bins to turn it; here the bins' own directions are turned, which is exact.
    """
    e, _ = _angles()
    weight = np.cos(e) * math.radians(22.5) * (2.0 * math.pi / BIN_AZIMUTHS)
    turned = torch.from_numpy((bin_directions() @ frame_from_enu.T).astype(np.float32))
    basis = harmonics(turned) * torch.from_numpy(weight.astype(np.float32))[:, None]
    return torch.from_numpy(seen_from.astype(np.float32)) @ basis
