"""A span of a power line, 62.5 m long: two lattice towers of angle steel, insulators, and sagging 3 cm conductors."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes import textures
from sim_bridge.scenes.scene import Part
from sim_bridge.scenes.solids import Solid, beam, box, lathe, textured, tube

LENGTH_M, WIDTH_M, HEIGHT_M = 62.5, 11.0, 34.0
FOOT_HALF_M, FOOTING_HALF_M = 3.0, 0.5
TOWER_X = LENGTH_M / 2 - FOOT_HALF_M - FOOTING_HALF_M
LEVELS = np.array([0.4, 5.6, 10.2, 14.2, 17.6, 20.2, 22.0, 23.6, 26.0, 27.6, 30.0, 31.6])
"""Heights of the horizontal frames; the cross-arms start at 22, 26 and 30 m and are one frame deep."""
WAIST, WAIST_HALF_M, TOP_HALF_M = 22.0, 0.95, 0.6
ARMS = ((22.0, 23.6, 4.6), (26.0, 27.6, WIDTH_M / 2 - 0.03), (30.0, 31.6, 4.2))
"""Lower chord, upper chord and tip distance of each cross-arm."""
INSULATOR_M, CONDUCTOR_RADIUS_M, SAG_M = 1.7, 0.015, 1.5
LEG_M, BRACE_M = 0.16, 0.09

Array = NDArray[np.float64]


def powerline(rng: np.random.Generator) -> list[Part]:
    """The line's parts, centred on the origin, standing on z = 0, along x."""
    towers = [-TOWER_X, TOWER_X]
    return [
        textured("lattice", [member for x in towers for member in _tower(x)], textures.galvanised(rng)),
        textured("footings", [footing for x in towers for footing in _footings(x)], textures.concrete(rng)),
        textured("insulators", [i for x in towers for i in _insulators(x)],
                 textures.painted_steel(rng, (126, 74, 52))),
        textured("conductors", list(_wires()), textures.galvanised(rng, (128, 130, 132))),
    ]


def _angle(width: float) -> Array:
    """Profile (6, 2) of an angle section whose flanges are a ninth of its width thick."""
    t = width / 9.0
    return np.array([(0.0, 0.0), (width, 0.0), (width, t), (t, t), (t, width), (0.0, width)])


def half_width_m(z: float) -> float:
    """Half the tower's side at a height."""
    if z <= WAIST:
        return FOOT_HALF_M + (WAIST_HALF_M - FOOT_HALF_M) * z / WAIST
    return WAIST_HALF_M + (TOP_HALF_M - WAIST_HALF_M) * (z - WAIST) / (float(LEVELS[-1]) - WAIST)


def _corners(x: float, z: float) -> Array:
    """(4, 3) leg positions at a height, counter-clockwise from south-west."""
    h = half_width_m(z)
    return np.array([(x - h, -h, z), (x + h, -h, z), (x + h, h, z), (x - h, h, z)])


def _tower(x: float) -> Iterator[Solid]:
    axis = np.array([x, 0.0, 0.0])
    peak = np.array([x, 0.0, HEIGHT_M])
    for low, high in pairwise(LEVELS):
        yield from _panel(_corners(x, low), _corners(x, high), axis)
    for corner in _corners(x, LEVELS[-1]):
        yield beam(corner, peak, _angle(LEG_M * 0.7), axis - corner)
    for low, high, tip in ARMS:
        for side in (-1.0, 1.0):
            yield from _arm(x, low, high, side * tip)


def _panel(low: Array, high: Array, axis: Array) -> Iterator[Solid]:
    """Legs, crossed diagonals and the upper frame between two heights."""
    size = BRACE_M if low[0, 2] < WAIST else 0.75 * BRACE_M
    for i in range(4):
        j = (i + 1) % 4
        inward = axis - (low[i] + low[j]) / 2
        yield beam(low[i], high[i], _angle(LEG_M), (axis - low[i]) * (1.0, 1.0, 0.0))
        yield beam(low[i], high[j], _angle(size), inward * (1.0, 1.0, 0.0))
        yield beam(low[j], high[i], _angle(size), -inward * (1.0, 1.0, 0.0))
        yield beam(high[i], high[j], _angle(size), (0.0, 0.0, -1.0))
        if high[0, 2] - low[0, 2] > 3.0:
            yield beam((low[i] + low[j]) / 2 * 0.5 + (high[i] + high[j]) / 2 * 0.5, (high[i] + high[j]) / 2,
                       _angle(0.7 * size), inward * (1.0, 1.0, 0.0))


def _arm(x: float, low: float, high: float, tip_y: float) -> Iterator[Solid]:
    """A pyramid of four chords from the tower's face to the tip, laced along its sides and bottom."""
    side = np.sign(tip_y)
    tip = np.array([x, tip_y, low])
    roots = [np.array([x + e * half_width_m(z), side * half_width_m(z), z]) for e in (-1, 1) for z in (low, high)]
    for root in roots:
        yield beam(root, tip, _angle(BRACE_M), (0.0, 0.0, 1.0))
    steps = np.linspace(0.0, 0.86, 6)
    for k, (s, t) in enumerate(pairwise(steps)):
        a, b, c, d = (root + s * (tip - root) for root in roots)
        e, f, g, h = (root + t * (tip - root) for root in roots)
        lacing = [(a, f), (c, h), (a, g)] if k % 2 == 0 else [(b, e), (d, g), (c, e)]
        for start, end in [*lacing, (e, g), (f, h)]:
            yield beam(start, end, _angle(0.6 * BRACE_M), (0.0, 0.0, 1.0))


def _footings(x: float) -> Iterator[Solid]:
    for cx, cy, _ in _corners(x, 0.0):
        lo = (cx - FOOTING_HALF_M, cy - FOOTING_HALF_M, 0.0)
        yield box(lo, (cx + FOOTING_HALF_M, cy + FOOTING_HALF_M, LEVELS[0] + 0.05), "-z")


def _insulators(x: float) -> Iterator[Solid]:
    """Strings of discs hanging from the tips of the cross-arms."""
    discs, pitch = 10, (INSULATOR_M - 0.2) / 10
    rise = [(0.02, 0.0), (0.02, 0.1)]
    for k in range(discs):
        z = 0.1 + k * pitch
        rise += [(0.13, z + 0.02), (0.12, z + 0.05), (0.035, z + 0.11)]
    rise += [(0.02, INSULATOR_M - 0.1), (0.02, INSULATOR_M)]
    for low, _, tip in ARMS:
        for side in (-1.0, 1.0):
            yield lathe(rise, (x, side * (tip - 0.13), low - INSULATOR_M), 14)


def conductor_ends_m() -> list[tuple[float, float]]:
    """(y, z) of each wire at the towers: six conductors, and the earth wire over the peaks."""
    hung = [(side * (tip - 0.13), low - INSULATOR_M) for low, _, tip in ARMS for side in (-1.0, 1.0)]
    return [*hung, (0.0, HEIGHT_M - CONDUCTOR_RADIUS_M)]


def _wires() -> Iterator[Solid]:
    """Catenaries between the towers (the parabola differs by less than a millimetre at this sag)."""
    xs = np.linspace(-TOWER_X, TOWER_X, 121)
    for y, z in conductor_ends_m():
        sag = SAG_M if y else 0.8 * SAG_M
        path = np.stack([xs, np.full_like(xs, y), z - sag * (1.0 - (xs / TOWER_X) ** 2)], axis=1)
        yield tube(path, CONDUCTOR_RADIUS_M, 6, capped=True)
