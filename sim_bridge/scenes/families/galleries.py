"""Galleries and ladders on round shafts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.shapes import collar, raised, ring, rod
from sim_bridge.scenes.solids import Solid

Middle = tuple[float, float]


def gallery(body: Body, radius: float, z: float, wide: float = 1.0, middle: Middle = (0.0, 0.0)) -> None:
    """A round gallery with railing on the outside of a shaft that stands at x and y."""
    outer = radius + wide
    body.add("trim", collar(radius - 0.06, outer, z - 0.12, z, 40, (*middle, 0.0)))
    angles = np.linspace(0.0, 2.0 * np.pi, 25)
    for a in angles[:-1]:
        foot = np.array([middle[0] + (outer - 0.06) * np.cos(a), middle[1] + (outer - 0.06) * np.sin(a), z - 0.02])
        body.add("trim", rod(foot, raised(foot, 1.1), 0.025, 6))
    for height in (0.55, 1.08):
        body.add("trim", ring(outer - 0.06, z + height, 0.03, middle))


def ladder(radius_at: Callable[[float], float], angle: float, low: float, high: float,
           middle: Middle = (0.0, 0.0)) -> Iterator[Solid]:
    """A ladder up a shaft whose radius is a function of height, standing at x and y."""
    out, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])

    def at(z: float, off: float, side: float) -> tuple[float, float, float]:
        x, y = middle + out * (radius_at(z) + off) + along * side
        return float(x), float(y), z

    stops = np.linspace(low, high, 9)
    for a, b in pairwise(stops):
        for side in (-0.22, 0.22):
            yield rod(at(a - 0.02, 0.2, side), at(b + 0.02, 0.2, side), 0.03, 6)
    for z in np.arange(low, high, 0.4):
        yield rod(at(z, 0.2, -0.24), at(z, 0.2, 0.24), 0.02, 6)
    for z in stops:
        for side in (-0.22, 0.22):
            yield rod(at(z, -0.1, side), at(z, 0.22, side), 0.025, 6)

