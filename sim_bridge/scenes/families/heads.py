"""Busts: a head and shoulders of more than life size."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of
from sim_bridge.scenes.families.likeness import Shape, plinth
from sim_bridge.scenes.implicit import Limb, round_cone

SIDES = (-1.0, 1.0)


@dataclass(frozen=True)
class Bust(Family):
    """A head on shoulders that narrow to a socle, with hair, beard and headgear, on a tall plinth."""

    size_m: float = between(5.0, 9.0)
    """From the socle to the top of the skull."""
    shoulders: float = between(0.75, 1.0)
    jaw: float = between(0.85, 1.15)
    nose: float = between(0.7, 1.3)
    hair: str = one_of("bald", "curls", "bun", "long")
    beard: float = between(0.0, 1.0)
    headgear: str = one_of("none", "helmet", "wreath")
    tilt: float = between(-0.06, 0.06)
    metal: str = one_of("bronze", "marble", "copper")
    plinth: str = one_of("block", "drum", "steps")
    plinth_m: float = between(2.0, 5.0)

    def build(self, rng: np.random.Generator) -> Body:
        """The bust facing south."""
        body, h = Body(), self.size_m
        limbs = [*self._trunk(), *self._face(), *self._hair(rng)]
        shape = Shape(h / 110.0, 0.025 * h)
        shape.add(*(limb for limb in limbs))
        body.add(self.metal, shape.solid())
        plinth(body, self.plinth, (0.27 * h, 0.24 * h), self.plinth_m)
        return body

    def _limb(self, a: tuple[float, float, float], b: tuple[float, float, float], radii: tuple[float, float],
              flat: float = 1.0) -> Limb:
        """A limb in units of the bust's size above the plinth; heads tilt sideways."""
        h = self.size_m

        def placed(p: tuple[float, float, float]) -> tuple[float, float, float]:
            lean = self.tilt * max(0.0, p[2] - 0.4)
            return (p[0] + lean) * h, p[1] * h, self.plinth_m + p[2] * h

        return round_cone(placed(a), placed(b), (radii[0] * h, radii[1] * h), flat)

    def _trunk(self) -> list[Limb]:
        s = self.shoulders
        return [
            self._limb((0.0, 0.0, -0.01), (0.0, 0.0, 0.1), (0.13, 0.09)),
            self._limb((0.0, 0.0, 0.1), (0.0, -0.02, 0.3), (0.1, 0.2), 1.2),
            self._limb((-0.26 * s, 0.02, 0.36), (0.26 * s, 0.02, 0.36), (0.1, 0.1)),
            self._limb((-0.11, -0.06, 0.28), (0.11, -0.06, 0.28), (0.1, 0.1)),
            self._limb((0.0, 0.02, 0.4), (0.0, -0.01, 0.58), (0.1, 0.088)),
        ]

    def _face(self) -> list[Limb]:
        n, j = self.nose, self.jaw
        limbs = [
            self._limb((0.0, 0.03, 0.83), (0.0, -0.01, 0.84), (0.155, 0.15)),
            self._limb((0.0, -0.04, 0.76), (0.0, -0.075, 0.635), (0.13, 0.072 * j)),
            self._limb((0.0, -0.16, 0.79), (0.0, -0.16 - 0.05 * n, 0.72), (0.016, 0.028 * n)),
            self._limb((-0.035, -0.15, 0.66), (0.035, -0.15, 0.66), (0.016, 0.016)),
            self._limb((-0.09, -0.125, 0.815), (0.09, -0.125, 0.815), (0.03, 0.03)),
        ]
        for s in SIDES:
            limbs.append(self._limb((s * 0.055, -0.135, 0.775), (s * 0.06, -0.135, 0.775), (0.024, 0.024)))
            limbs.append(self._limb((s * 0.15, 0.0, 0.73), (s * 0.165, 0.02, 0.79), (0.02, 0.032)))
            limbs.append(self._limb((s * 0.08, -0.1, 0.71), (s * 0.1, -0.06, 0.73), (0.045, 0.05)))
        return limbs

    def _hair(self, rng: np.random.Generator) -> list[Limb]:
        limbs: list[Limb] = []
        if self.hair == "curls":
            for k in range(46):
                a, e = 2.4 * k, 0.1 + 1.4 * (k + 0.5) / 46
                x, y, z = np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)
                if y > -0.75 or z > 0.55:
                    limbs.append(self._limb((0.155 * x, 0.02 + 0.155 * y, 0.82 + 0.165 * z),
                                            (0.165 * x, 0.02 + 0.165 * y, 0.835 + 0.175 * z), (0.028, 0.02)))
        elif self.hair == "bun":
            limbs += [self._limb((0.0, 0.16, 0.84), (0.0, 0.2, 0.84), (0.08, 0.075)),
                      self._limb((-0.1, 0.0, 0.93), (0.1, 0.0, 0.93), (0.07, 0.07))]
        elif self.hair == "long":
            for s in SIDES:
                limbs += [self._limb((s * 0.12, 0.04, 0.9), (s * 0.17, 0.04, 0.5), (0.06, 0.065)),
                          self._limb((s * 0.06, 0.12, 0.9), (s * 0.08, 0.14, 0.48), (0.07, 0.07))]
        if self.beard > 0.4:
            for k in range(7):
                x = 0.028 * (k - 3)
                limbs.append(self._limb((x * 1.3, -0.1 + abs(x), 0.66), (x, -0.12 + abs(x), 0.66 - 0.2 * self.beard),
                                        (0.034, 0.02)))
        if self.headgear == "helmet":
            limbs.append(self._limb((0.0, 0.02, 0.87), (0.0, 0.0, 0.89), (0.178, 0.165)))
            crest = [(0.0, 0.19 * np.cos(t) + 0.02, 0.9 + 0.2 * np.sin(t)) for t in np.linspace(0.2, 2.6, 9)]
            limbs += [self._limb(a, b, (0.028, 0.028)) for a, b in pairwise(crest)]
        elif self.headgear == "wreath":
            for k in range(26):
                a = 2.0 * np.pi * k / 26
                x, y = 0.165 * float(np.cos(a)), 0.01 + 0.17 * float(np.sin(a))
                limbs.append(self._limb((x, y, 0.87), (1.12 * x, 1.12 * y, 0.9 + 0.02 * rng.random()), (0.02, 0.008)))
        return limbs
