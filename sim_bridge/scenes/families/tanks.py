"""Industrial plants of vessels: tank farms, distillation columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.racks import Rack, raise_rack
from sim_bridge.scenes.families.shapes import bar, collar, drum, pipe, raised, rod, vessel
from sim_bridge.scenes.solids import box

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TankFarm(Family):
    """Upright storage tanks in a bund, joined by pipes, with spiral stairs."""

    tanks: int = whole(3, 5)
    radius_m: float = between(4.0, 6.0)
    height_m: float = between(7.0, 13.0)
    spread: float = between(0.0, 0.35)
    """How much the tanks differ in size."""
    roof: str = one_of("cone", "dome", "floating")
    bund_m: float = between(0.8, 1.5)
    pipes: int = whole(2, 5)

    def build(self, rng: np.random.Generator) -> Body:
        """The tanks in a row along x, pipes to the south."""
        body = Body()
        radii = self.radius_m * (1.0 - self.spread * rng.random(self.tanks))
        heights = self.height_m * (1.0 - self.spread * rng.random(self.tanks))
        starts = np.concatenate([[0.0], np.cumsum(2.0 * radii + 2.5)])
        for x, r, h in zip(starts[:-1] + radii, radii, heights, strict=True):
            self._tank(body, float(x), float(r), float(h), rng.uniform(0.0, 2.0 * np.pi))
            self._connect(body, float(x), float(r))
        self._bund(body, -3.0, starts[-1] + 0.5)
        return body

    def _tank(self, body: Body, x: float, r: float, h: float, start: float) -> None:
        top = {"cone": [(r + 0.1, h), (0.3, h + 0.22 * r)],
               "floating": [(r, h), (r - 0.15, h), (r - 0.15, 0.75 * h)],
               "dome": [(r * np.cos(t), h + 0.4 * r * np.sin(t)) for t in np.linspace(0.0, 1.5, 9)]}[self.roof]
        body.add("concrete", drum([(r + 0.4, 0.0), (r + 0.4, 0.3)], (x, 0.0, 0.0), 48))
        body.add("white", drum([(r, 0.25), (r, h - 0.4), *top], (x, 0.0, 0.0), 64))
        for z in np.arange(2.4, h - 0.5, 2.4):
            body.add("white", collar(r - 0.05, r + 0.04, z, z + 0.1, 64, (x, 0.0, 0.0)))
        spiral_stair(body, (x, 0.0), start, 0.35, h, lambda _: r)

    def _connect(self, body: Body, x: float, r: float) -> None:
        """A pipe from a tank's foot to the header."""
        y = -self.radius_m - 2.2
        body.add("paint", pipe([(x, -r + 0.1, 0.9), (x, y + 0.3, 0.9), (x, y + 0.3, 0.55)], 0.16, 14))
        body.add("red", drum([(0.3, 0.55), (0.3, 1.25), (0.08, 1.3), (0.08, 1.7), (0.26, 1.72), (0.26, 1.78)],
                             (x, -r - 0.9, 0.0), 16))

    def _bund(self, body: Body, x0: float, x1: float) -> None:
        y0, y1 = -self.radius_m - 3.6 - 0.45 * self.pipes, self.radius_m + 2.6
        body.blocks.add("concrete", (x0, y0, 0.0), (x1, y1, self.bund_m))
        body.blocks.cut((x0 + 0.3, y0 + 0.3, 0.0), (x1 - 0.3, y1 - 0.3, self.bund_m))
        for k in range(self.pipes):
            y, r = -self.radius_m - 1.9 - 0.45 * k, 0.12 + 0.03 * (k % 3)
            body.add("zinc" if k % 2 else "paint", rod((x0 + 0.2, y, 0.55), (x1 - 0.2, y, 0.55), r, 14))
        for x in np.arange(x0 + 1.5, x1, 4.0):
            body.add("concrete", box((x - 0.15, -self.radius_m - 2.2 - 0.45 * (self.pipes - 1), 0.0),
                                     (x + 0.15, -self.radius_m - 1.6, 0.45)))


@dataclass(frozen=True)
class RefineryColumns(Family):
    """Distillation columns with platforms and ladders, exchangers and a pipe rack."""

    columns: int = whole(3, 5)
    height_m: float = between(20.0, 32.0)
    radius_m: float = between(1.0, 1.7)
    pitch_m: float = between(6.0, 8.0)
    spread: float = between(0.15, 0.5)
    """How much the columns differ in height."""
    platforms: int = whole(3, 5)
    exchangers: int = whole(2, 4)
    tiers: int = whole(2, 3)
    """Of the pipe rack."""

    def build(self, rng: np.random.Generator) -> Body:
        """The columns along x, the pipe rack to the south."""
        body = Body()
        xs = (np.arange(self.columns) - (self.columns - 1) / 2) * self.pitch_m
        heights = self.height_m * (1.0 - self.spread * rng.permutation(self.columns) / max(1, self.columns - 1))
        rack = Rack(self.columns * self.pitch_m, 4.0, self.tiers, 3.2)
        raise_rack(body, rack, (0.0, -7.5), rng)
        for i, (x, h) in enumerate(zip(xs.tolist(), heights.tolist(), strict=True)):
            r = self.radius_m * (0.75 + 0.5 * rng.random())
            self._column(body, x, r, h, "white" if i % 2 else "zinc")
            body.add("zinc", pipe([(x, 0.0, h - 0.2), (x, 0.0, h + 0.9), (x, -r - 0.9, h + 0.9), (x, -r - 0.9, 3.4),
                                   (x, -7.0, 3.4)], 0.2, 14))
        for k in range(self.exchangers):
            x = (k - (self.exchangers - 1) / 2) * 7.0
            body.add("zinc", vessel((x - 2.0, 5.2, 1.7), (x + 2.0, 5.2, 1.7), 0.65))
            for s in (-1.2, 1.2):
                body.blocks.add("concrete", (x + s - 0.2, 4.7, 0.0), (x + s + 0.2, 5.7, 1.3))
            body.add("paint", pipe([(x, 5.2, 2.2), (x, 5.2, 3.2), (x, 2.6, 3.2), (x, 2.6, 0.4)], 0.12))
        return body

    def _column(self, body: Body, x: float, r: float, h: float, metal: str) -> None:
        body.add("concrete", drum([(r + 0.5, 0.0), (r + 0.5, 0.6)], (x, 0.0, 0.0), 32))
        waist = 0.45 * h
        head = [(r * 0.8 * np.cos(t), h - 0.4 * r + 0.4 * r * np.sin(t)) for t in np.linspace(0.0, 1.5, 7)]
        body.add(metal, drum([(r, 0.55), (r, waist), (0.8 * r, waist + 0.8), *head], (x, 0.0, 0.0), 40))
        for k in range(self.platforms):
            z = h * (0.3 + 0.62 * k / max(1, self.platforms - 1))
            self._platform(body, x, (r if z < waist else 0.85 * r), z, 0.5 * np.pi * (k % 4))
        for side in (-0.22, 0.22):
            body.add("trim", rod((x + r + 0.25, side, 0.5), (x + r + 0.25, side, 0.94 * h), 0.03, 6))
        for z in np.arange(0.8, 0.93 * h, 0.4):
            body.add("trim", rod((x + r + 0.25, -0.24, z), (x + r + 0.25, 0.24, z), 0.018, 6))

    def _platform(self, body: Body, x: float, r: float, z: float, turn: float) -> None:
        """A platform around three quarters of a column, here round, with its railing open at one side."""
        outer = r + 0.95
        body.add("trim", collar(r - 0.06, outer, z - 0.08, z, 36, (x, 0.0, 0.0)))
        angles = turn + np.linspace(0.3, 2.0 * np.pi - 0.3, 19)
        rim = np.stack([x + (outer - 0.05) * np.cos(angles), (outer - 0.05) * np.sin(angles), np.full(19, z)], axis=1)
        for foot in rim:
            body.add("trim", rod(raised(foot, -0.02), raised(foot, 1.1), 0.022, 6))
        for height in (0.55, 1.08):
            body.add_all("trim", (rod(a, b, 0.025, 6) for a, b in pairwise(raised(rim, height))))


def spiral_stair(body: Body, middle: tuple[float, float], start: float, low: float, high: float,
                 radius_at: Callable[[float], float]) -> None:
    """Treads of 0.85 m around a shell whose radius is a function of height, with a handrail outside."""
    rail: list[Array] = []
    angle = start
    for k, z in enumerate(np.arange(low, high, 0.24)):
        r = radius_at(float(z))
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        tread = np.array([*middle, z]) + out * (r - 0.03)
        body.add("trim", bar(tread, tread + 0.85 * out, 0.28, 0.05))
        if k % 3 == 0:
            post = tread + 0.8 * out
            body.add("trim", rod(post, raised(post, 1.05), 0.025, 6))
            rail.append(raised(post, 1.05))
        angle += 0.24 / 0.85 / r
    body.add_all("trim", (rod(a, b, 0.03, 6) for a, b in pairwise(rail)))
