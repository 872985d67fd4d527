"""Conductors with sag, insulators and lattice columns: what power lines are made of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.shapes import angle_steel, drum, members
from sim_bridge.scenes.solids import Solid, tube

Array = NDArray[np.float64]
CONDUCTOR_RADIUS_M = 0.015


def string_wires(body: Body, stations_x: Sequence[float], ends_m: Sequence[tuple[float, float]], sag: float,
                 points: int = 61) -> None:
    """Conductors through all stations at each of the places (y, z), with a sag in metres per 60 m span."""
    for y, z in ends_m:
        for x0, x1 in pairwise(stations_x):
            depth = sag * ((x1 - x0) / 60.0) ** 2
            t = np.linspace(-1.0, 1.0, points)
            path = np.stack([(x0 + x1) / 2 + t * (x1 - x0) / 2, np.full(points, y), z - depth * (1.0 - t * t)], axis=1)
            body.add("cable", tube(path, CONDUCTOR_RADIUS_M, 6, capped=True))


def insulator(top: Sequence[float], length: float, discs: int) -> Solid:
    """A string of discs hanging from a point."""
    pitch = (length - 0.2) / discs
    profile = [(0.02, 0.0), (0.02, 0.1)]
    for k in range(discs):
        z = 0.1 + k * pitch
        profile += [(0.13, z + 0.02), (0.12, z + 0.4 * pitch), (0.035, z + 0.8 * pitch)]
    profile += [(0.02, length - 0.1), (0.02, length + 0.05)]
    return drum(profile, (top[0], top[1], top[2] - length), 14)


def lattice(foot: ArrayLike, head: ArrayLike, panels: int, leg: float, brace: float) -> Iterator[Solid]:
    """A four-sided lattice column of angle steel between two quadrilaterals (4, 3), crossed in every panel."""
    low, high = np.asarray(foot, dtype=np.float64), np.asarray(head, dtype=np.float64)
    rings = low + _even_panels(low, high, panels)[:, None, None] * (high - low)
    a, b = rings[:-1], rings[1:]
    c, d = (np.roll(ring, -1, axis=1) for ring in (a, b))
    middle = (a.mean(axis=1) + b.mean(axis=1))[:, None] / 2
    inward = middle - (a + d) / 2
    yield _angles(low, high, leg, (low + high).mean(axis=0) - low - high)
    yield _angles(a, d, brace, inward)
    yield _angles(c, b, brace, -inward)
    yield _angles(b, d, brace, a - b)


def _angles(starts: Array, ends: Array, width: float, towards: Array) -> Solid:
    return members(starts.reshape(-1, 3), ends.reshape(-1, 3), angle_steel(width), towards.reshape(-1, 3))


def _even_panels(low: Array, high: Array, panels: int) -> Array:
    """Where to cut a tapering column so that its panels keep their proportions."""
    a, b = (np.linalg.norm(ring[0] - ring[2]) for ring in (low, high))
    ratio = (b / a) ** (1.0 / panels)
    sizes = ratio ** np.arange(panels)
    return np.asarray(np.concatenate([[0.0], np.cumsum(sizes)]) / sizes.sum())
