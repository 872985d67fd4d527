"""Sculptures without a likeness, on plinths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Drawn, between, one_of, whole
from sim_bridge.scenes.families.likeness import Shape, plinth
from sim_bridge.scenes.implicit import round_cone


@dataclass(frozen=True)
class KnotSculpture(Drawn):
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
        shape = Shape(h / 110.0, 0.15 * self.thick * h)
        for i in range(240):
            shape.add(round_cone(path[i], path[i + 1], (float(strand[i]), float(strand[i + 1]))))
        body.add(self.metal, shape.solid())
        half = 0.26 * h
        plinth(body, self.plinth, (half, 0.5 * half + 1.0), self.plinth_m)
        return body
