"""Power lines on poles of steel tube, wood and concrete."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.shapes import bar, collar, drum, footing, frustum, rod
from sim_bridge.scenes.families.wires import insulator, string_wires
from sim_bridge.scenes.solids import box

SIDES = (-1.0, 1.0)


@dataclass(frozen=True)
class TubularLine(Family):
    """Tapering steel tubes with tubular cross-arms for one or two circuits."""

    length_m: float = between(50.0, 64.0)
    """Between the first and the last pole."""
    poles: int = whole(2, 3)
    height_m: float = between(20.0, 32.0)
    foot_m: float = between(0.45, 0.75)
    sides: int = one_of(8, 12, 24)
    circuits: int = whole(1, 2)
    levels: int = whole(2, 3)
    reach_m: float = between(2.2, 4.0)
    arm: str = one_of("level", "raised", "curved")
    insulator_m: float = between(1.2, 2.0)
    sag_m: float = between(1.2, 2.4)

    def build(self, rng: np.random.Generator) -> Body:
        """The line along x."""
        body = Body()
        stations = np.linspace(-self.length_m / 2, self.length_m / 2, self.poles).tolist()
        for x in stations:
            self._pole(body, x)
        string_wires(body, stations, [(y, z - self.insulator_m) for y, z in self._tips()], self.sag_m)
        string_wires(body, stations, [(0.0, self.height_m + 0.02)], 0.8 * self.sag_m)
        return body

    def _arms(self) -> list[tuple[float, float, float]]:
        """Side, length and height of the arms where they leave the pole."""
        heights = [self.height_m - 1.8 - 3.2 * k for k in range(self.levels)]
        if self.circuits == 2:
            return [(s, self.reach_m * (1.0 + 0.12 * (k % 2)), z) for k, z in enumerate(heights) for s in SIDES]
        return [(SIDES[k % 2], self.reach_m, z) for k, z in enumerate(heights)]

    def _tips(self) -> list[tuple[float, float]]:
        """(y, z) of the arms' ends."""
        rise = {"level": 0.0, "raised": 0.7, "curved": 1.0}[self.arm]
        return [(s * reach, z + rise) for s, reach, z in self._arms()]

    def _pole(self, body: Body, x: float) -> None:
        h, r = self.height_m, self.foot_m
        cuts = np.linspace(0.3, h, 9)
        body.add("zinc", drum([(r * (1.0 - 0.6 * z / h), z) for z in cuts], (x, 0.0, 0.0), self.sides))
        for z in cuts[2:8:2]:
            wide = r * (1.0 - 0.6 * z / h)
            body.add("zinc", collar(0.6 * wide, wide + 0.08, z - 0.08, z + 0.08, 24, (x, 0.0, 0.0)))
        body.add("concrete", drum([(r + 0.6, 0.0), (r + 0.6, 0.45)], (x, 0.0, 0.0), 24))
        for (s, _, z), (y, tip) in zip(self._arms(), self._tips(), strict=True):
            knee = 0.45 * y
            bend = z + (tip - z) * (0.8 if self.arm == "curved" else 0.45)
            body.add("zinc", rod((x, 0.0, z), (x, knee + 0.04 * s, bend), [0.17, 0.13], 12),
                     rod((x, knee, bend), (x, y + 0.15 * s, tip), [0.13, 0.08], 12))
            body.add("ceramic", insulator((x, y, tip), self.insulator_m, 9))
        for z in np.arange(3.0, h - 1.0, 0.45):
            body.add("zinc", rod((x, 0.0, z), (x + r * (1.0 - 0.6 * z / h) + 0.16, 0.0, z), 0.015, 6))


@dataclass(frozen=True)
class HFrameLine(Family):
    """Wooden double poles with a cross-arm and crossed bracing."""

    length_m: float = between(48.0, 64.0)
    """Between the first and the last frame."""
    frames: int = whole(2, 4)
    height_m: float = between(13.0, 19.0)
    spread_m: float = between(1.6, 2.4)
    """Distance of the poles from the middle."""
    reach_m: float = between(3.6, 4.8)
    pole_m: float = between(0.17, 0.24)
    braced: int = whole(1, 2)
    """Panels of crossed bracing."""
    insulator_m: float = between(0.9, 1.5)
    sag_m: float = between(1.0, 2.2)

    def build(self, rng: np.random.Generator) -> Body:
        """The line along x."""
        body = Body()
        stations = np.linspace(-self.length_m / 2, self.length_m / 2, self.frames).tolist()
        arm = self.height_m - 2.0
        for x in stations:
            self._frame(body, x, arm)
        places = [-self.reach_m + 0.2, 0.0, self.reach_m - 0.2]
        string_wires(body, stations, [(y, arm - 0.2 - self.insulator_m) for y in places], self.sag_m)
        string_wires(body, stations, [(s * self.spread_m, self.height_m + 0.02) for s in SIDES], 0.8 * self.sag_m)
        return body

    def _frame(self, body: Body, x: float, arm: float) -> None:
        w, r = self.spread_m, self.pole_m
        for s in SIDES:
            body.add("timber", drum([(r, 0.0), (0.65 * r, self.height_m)], (x, s * w, 0.0), 16))
            body.add("timber", bar((x, s * w, arm - 1.6), (x, s * (self.reach_m - 0.4), arm - 0.1), 0.1, 0.14))
        for e in SIDES:
            body.add("timber", box((x + e * 0.2 - 0.06, -self.reach_m, arm - 0.14),
                                   (x + e * 0.2 + 0.06, self.reach_m, arm + 0.14)))
        step = 0.3 * self.height_m
        for k in range(self.braced):
            top, low = arm - 1.4 - k * step, arm - 1.4 - (k + 1) * step
            body.add("timber", bar((x - 0.1, -w, low), (x - 0.1, w, top), 0.09, 0.16),
                     bar((x + 0.1, w, low), (x + 0.1, -w, top), 0.09, 0.16))
        for y in (-self.reach_m + 0.2, 0.0, self.reach_m - 0.2):
            body.add("zinc", box((x - 0.3, y - 0.04, arm - 0.22), (x + 0.3, y + 0.04, arm - 0.1)))
            body.add("ceramic", insulator((x, y, arm - 0.18), self.insulator_m, 6))


@dataclass(frozen=True)
class ConcretePoleLine(Family):
    """Tapering concrete poles with pin insulators, street lamps, and a transformer on one of them."""

    length_m: float = between(48.0, 64.0)
    """Between the first and the last pole."""
    poles: int = whole(3, 5)
    height_m: float = between(10.0, 14.0)
    section: str = one_of("square", "round", "ladder")
    arms: int = whole(1, 2)
    reach_m: float = between(1.1, 1.8)
    lamps: bool = one_of(True, False)
    transformer: bool = one_of(True, False)
    cables: int = whole(2, 4)
    """Telephone cables below the conductors."""
    sag_m: float = between(1.0, 2.0)

    def build(self, rng: np.random.Generator) -> Body:
        """The line along x."""
        body = Body()
        stations = np.linspace(-self.length_m / 2, self.length_m / 2, self.poles).tolist()
        ends: list[tuple[float, float]] = []
        for k in range(self.arms):
            z = self.height_m - 0.35 - 1.1 * k
            ends += [(f * self.reach_m, z + 0.42) for f in ((-0.92, -0.4, 0.92) if k == 0 else (-0.92, 0.92))]
        for x in stations:
            self._pole(body, x, ends)
        string_wires(body, stations, ends, self.sag_m)
        low = self.height_m - 2.6 - 1.1 * (self.arms - 1)
        string_wires(body, stations, [(0.28, low - 0.35 * k) for k in range(self.cables)], 1.2 * self.sag_m)
        if self.transformer:
            self._transformer(body, stations[len(stations) // 2])
        return body

    def _pole(self, body: Body, x: float, ends: list[tuple[float, float]]) -> None:
        h = self.height_m
        if self.section == "round":
            body.add("concrete", drum([(0.24, 0.0), (0.13, h)], (x, 0.0, 0.0), 24))
        elif self.section == "square":
            body.add("concrete", frustum((x, 0.0), (0.2, 0.2), (0.11, 0.11), 0.0, h))
        else:
            for s in SIDES:
                body.add("concrete", frustum((x, s * 0.19), (0.12, 0.06), (0.09, 0.05), 0.0, h))
            for z in np.arange(0.6, h, 1.1):
                body.add("concrete", box((x - 0.08, -0.2, z), (x + 0.08, 0.2, z + 0.22)))
        body.add("concrete", footing(x, 0.0, 0.5, 0.15))
        for k in range(self.arms):
            z = h - 0.35 - 1.1 * k
            body.add("zinc", box((x - 0.15, -self.reach_m, z - 0.06), (x - 0.04, self.reach_m, z + 0.06)))
            for s in SIDES:
                body.add("zinc", bar((x - 0.1, 0.05 * s, z - 0.8), (x - 0.1, 0.7 * s * self.reach_m, z), 0.05))
        for y, z in ends:
            body.add("ceramic", drum([(0.02, z - 0.5), (0.02, z - 0.28), (0.09, z - 0.26), (0.05, z - 0.16),
                                      (0.1, z - 0.14), (0.04, z - 0.03), (0.04, z + 0.02)], (x - 0.1, y, 0.0), 14))
            body.add("cable", rod((x - 0.14, y, z), (x + 0.02, y, z), 0.02, 6))
        if self.lamps:
            z = 0.7 * h
            body.add("zinc", rod((x, 0.0, z), (x, -1.1, z + 0.8), 0.04, 8),
                     rod((x, -1.06, z + 0.79), (x, -2.0, z + 0.9), 0.04, 8))
            body.add("trim", box((x - 0.14, -2.6, z + 0.82), (x + 0.14, -1.9, z + 0.98)))

    def _transformer(self, body: Body, x: float) -> None:
        z = 0.48 * self.height_m
        body.add("zinc", box((x - 0.7, -0.5, z - 0.15), (x + 0.7, 1.3, z)))
        body.add("paint", box((x - 0.5, 0.32, z - 0.02), (x + 0.5, 1.0, z + 1.1)))
        for k in range(9):
            at = x - 0.44 + 0.11 * k
            body.add("paint", box((at - 0.015, 0.98, z + 0.1), (at + 0.015, 1.25, z + 1.0)))
        for at in (-0.3, 0.0, 0.3):
            body.add("ceramic", drum([(0.07, 1.05), (0.09, 1.2), (0.05, 1.25), (0.09, 1.35), (0.04, 1.45), (0.02, 1.7)],
                                     (x + at, 0.66, z), 12))
