"""Sculptures without a likeness, on plinths."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.likeness import Shape, plinth
from sim_bridge.scenes.implicit import round_cone


@dataclass(frozen=True)
class KnotSculpture(Family):
    """A torus knot of swelling thickness, standing on a plinth."""

    height_m: float = between(10.0, 18.0)
    """Of the knot alone."""
    winds: int = whole(2, 3)
    around: int = one_of(3, 5, 7)
    flat: float = between(0.35, 0.6)
    """Depth over width."""
    thick: float = between(0.07, 0.11)
    """Radius of the strand over the height."""
    swell: float = between(0.0, 0.5)
    metal: str = one_of("bronze", "copper", "white", "red")
    plinth: str = one_of("steps", "block", "drum")
    plinth_m: float = between(1.5, 4.0)

    def build(self, rng: np.random.Generator) -> Body:
        """The sculpture facing south."""
        body = Body()
        h = self.height_m
        winds = self.winds if np.gcd(self.winds, self.around) == 1 else 5 - self.winds
        t = np.linspace(0.0, 2.0 * np.pi, 241)
        ring = 0.72 + 0.28 * np.cos(self.around * t)
        path = 0.42 * h * np.stack([ring * np.cos(winds * t), self.flat * np.sin(self.around * t),
                                    ring * np.sin(winds * t)], axis=1)
        strand = self.thick * h * (1.0 + self.swell * np.sin(3 * t) * 0.5)
        path[:, 2] += self.plinth_m - (path[:, 2] - strand).min() - 0.3
        shape = Shape(h / 85.0, 0.15 * self.thick * h)
        for i in range(240):
            shape.add(round_cone(path[i], path[i + 1], (float(strand[i]), float(strand[i + 1]))))
        body.add(self.metal, shape.solid())
        half = 0.26 * h
        plinth(body, self.plinth, (half, 0.5 * half + 1.0), self.plinth_m)
        return body


@dataclass(frozen=True)
class PebbleTotem(Family):
    """Flattened pebbles piled askew, melted into each other more or less, some with rings around them."""

    pebbles: int = whole(5, 9)
    size_m: float = between(2.6, 4.0)
    """Radius of the lowest pebble."""
    shrink: float = between(0.8, 0.95)
    flat: float = between(0.4, 0.65)
    askew: float = between(0.15, 0.45)
    melt: float = between(0.04, 0.2)
    rings: int = whole(0, 3)
    metal: str = one_of("rock", "bronze", "white", "concrete")
    plinth: str = one_of("steps", "drum")
    plinth_m: float = between(0.6, 2.0)

    def build(self, rng: np.random.Generator) -> Body:
        """The pile on its plinth."""
        body, r, z = Body(), self.size_m, self.plinth_m
        shape = Shape(self.size_m / 24.0, self.melt * self.size_m)
        x, y = 0.0, 0.0
        for k in range(self.pebbles):
            high = 0.75 * self.flat * r * (0.8 + 0.4 * rng.random())
            turn = rng.uniform(0.0, np.pi)
            middle = np.array([x, y, z + 0.85 * high])
            for i, long in enumerate((0.7, 0.5, 0.35)):
                a = turn + i * np.pi / 3
                reach = long * r * np.array([np.cos(a), np.sin(a), rng.uniform(-0.15, 0.15)])
                shape.add(round_cone(middle - reach, middle + reach, (0.85 * high, 0.8 * high)))
            if k < self.rings:
                self._ring(shape, middle, 1.25 * r, 0.1 * r)
            z += 1.7 * high
            x, y = (c + self.askew * r * rng.uniform(-1.0, 1.0) for c in (x, y))
            r *= self.shrink
        body.add(self.metal, shape.solid())
        plinth(body, self.plinth, (0.8 * self.size_m, 0.8 * self.size_m), self.plinth_m + 0.1 * self.size_m)
        return body

    def _ring(self, shape: Shape, middle: NDArray[np.float64], radius: float, thick: float) -> None:
        t = np.linspace(0.0, 2.0 * np.pi, 41)
        rim = middle + radius * np.stack([np.cos(t), np.sin(t), 0.25 * np.sin(t)], axis=1)
        for a, b in pairwise(rim):
            shape.add(round_cone(a, b, (thick, thick)), melt_m=0.5 * thick)
