"""Power lines on lattice structures of angle steel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.shapes import footing, rectangle_ring, rod
from sim_bridge.scenes.families.wires import CONDUCTOR_RADIUS_M, insulator, lattice, string_wires

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LatticeLine(Family):
    """Square lattice pylons with cross-arms for one or two circuits."""

    length_m: float = between(50.0, 62.0)
    """Between the first and the last pylon."""
    pylons: int = whole(2, 3)
    height_m: float = between(20.0, 30.0)
    circuits: int = whole(1, 2)
    foot_m: float = between(1.8, 3.0)
    """Half the side at the ground."""
    reach_m: float = between(3.0, 5.0)
    outline: str = one_of("barrel", "fir", "level")
    """Lengths of the cross-arms: longest in the middle, at the bottom, or all on one level."""
    insulator_m: float = between(1.2, 2.0)
    sag_m: float = between(1.2, 2.5)

    def build(self, rng: np.random.Generator) -> Body:
        """The line along x."""
        body = Body()
        stations = np.linspace(-self.length_m / 2, self.length_m / 2, self.pylons).tolist()
        for x in stations:
            self._pylon(body, x)
        hung = [(y, z - self.insulator_m) for y, z in self._hangers()]
        string_wires(body, stations, hung, self.sag_m)
        string_wires(body, stations, [(0.0, self.height_m - 2 * CONDUCTOR_RADIUS_M)], 0.8 * self.sag_m)
        return body

    def _arms(self) -> list[tuple[float, float]]:
        """Height and reach of the cross-arms, lowest first."""
        top, r = self.height_m - 2.4, self.reach_m
        if self.outline == "level":
            return [(top - 1.6, 1.25 * r)]
        lengths = (0.85, 1.1, 0.8) if self.outline == "barrel" else (1.1, 0.95, 0.75)
        return [(top - 3.2 * (2 - i), length * r) for i, length in enumerate(lengths)]

    def _hangers(self) -> list[tuple[float, float]]:
        """(y, z) of the points on the cross-arms that insulators hang from."""
        if self.outline == "level":
            (z, reach), = self._arms()
            inner = [0.55] if self.circuits == 2 else []
            return [(s * f * reach, z) for s in (-1.0, 1.0) for f in (1.0, *inner)]
        if self.circuits == 2:
            return [(s * reach, z) for z, reach in self._arms() for s in (-1.0, 1.0)]
        return [(s * reach, z) for s, (z, reach) in zip((-1.0, 1.0, -1.0), self._arms(), strict=True)]

    def _pylon(self, body: Body, x: float) -> None:
        waist_z, waist, top = self._arms()[0][0], 0.16 * self.foot_m + 0.35, 0.4
        foot, middle = (rectangle_ring((x, 0.0), (h, h), z) for h, z in ((self.foot_m, 0.3), (waist, waist_z)))
        head = rectangle_ring((x, 0.0), (top, top), self.height_m - 1.2)
        body.add_all("zinc", lattice(foot, middle, 5, 0.15, 0.08))
        body.add_all("zinc", lattice(middle, head, 4, 0.12, 0.065))
        peak = rectangle_ring((x, 0.0), (0.04, 0.04), self.height_m)
        body.add_all("zinc", lattice(head, peak, 1, 0.08, 0.05))
        for corner in foot:
            body.add("concrete", footing(corner[0], corner[1], 0.45, 0.4))
        for z, reach in self._arms():
            for side in (-1.0, 1.0):
                self._arm(body, x, z, side * reach)
        for y, z in self._hangers():
            body.add("ceramic", insulator((x, y, z), self.insulator_m, 9))

    def _arm(self, body: Body, x: float, z: float, tip_y: float) -> None:
        half, side = 0.42, float(np.sign(tip_y))
        root = np.array([(x - half, side * half, z), (x + half, side * half, z), (x + half, side * half, z + 1.3),
                         (x - half, side * half, z + 1.3)])
        tip = np.array([(x - 0.06, tip_y, z), (x + 0.06, tip_y, z), (x + 0.06, tip_y, z + 0.1),
                        (x - 0.06, tip_y, z + 0.1)])
        body.add_all("zinc", lattice(root, tip, 4, 0.08, 0.05))


@dataclass(frozen=True)
class GuyedVLine(Family):
    """Guyed V-towers: two slender masts that meet at the foot, a beam over them, four guys."""

    length_m: float = between(42.0, 54.0)
    """Between the first and the last tower."""
    towers: int = whole(2, 3)
    height_m: float = between(18.0, 27.0)
    spread_m: float = between(4.0, 6.0)
    """Distance of the masts' heads from the middle."""
    overhang_m: float = between(2.0, 3.5)
    bundle: int = whole(1, 2)
    insulator_m: float = between(1.5, 2.4)
    sag_m: float = between(1.0, 2.0)

    def build(self, rng: np.random.Generator) -> Body:
        """The line along x."""
        body = Body()
        stations = np.linspace(-self.length_m / 2, self.length_m / 2, self.towers).tolist()
        places = (-self.spread_m - self.overhang_m + 0.3, 0.0, self.spread_m + self.overhang_m - 0.3)
        for x in stations:
            self._tower(body, x)
            for y in places:
                body.add("ceramic", insulator((x, y, self.height_m - 1.6), self.insulator_m, 11))
        gaps = [0.0] if self.bundle == 1 else [-0.2, 0.2]
        low = self.height_m - 1.6 - self.insulator_m
        string_wires(body, stations, [(y + g, low) for y in places for g in gaps], self.sag_m)
        if self.bundle == 2:
            body.add_all("cable", (rod((x, y - 0.22, low), (x, y + 0.22, low), 0.04, 6)
                                   for x in stations for y in places))
        earth = [(s * self.spread_m, self.height_m + 0.75) for s in (-1.0, 1.0)]
        string_wires(body, stations, earth, 0.8 * self.sag_m)
        return body

    def _tower(self, body: Body, x: float) -> None:
        beam = self.height_m - 1.2
        body.add("concrete", footing(x, 0.0, 1.1, 0.6))
        for s in (-1.0, 1.0):
            y, h = s * self.spread_m, 0.42
            foot = rectangle_ring((x, s * 0.5), (0.1, 0.1), 0.55)
            knee = rectangle_ring((x, s * (0.5 + 0.12 * (self.spread_m - 0.5))), (h, h), 0.12 * beam)
            head = rectangle_ring((x, y), (h, h), beam - 0.4)
            body.add_all("zinc", lattice(foot, knee, 2, 0.1, 0.06))
            body.add_all("zinc", lattice(knee, head, 14, 0.1, 0.06))
            horn = rectangle_ring((x, y), (0.3, 0.3), beam + 0.35)
            tip = rectangle_ring((x, y), (0.05, 0.05), self.height_m + 0.8)
            body.add_all("zinc", lattice(horn, tip, 2, 0.08, 0.05))
            for e in (-1.0, 1.0):
                anchor = np.array([x + e * 0.32 * self.height_m, s * (self.spread_m + 2.0), 0.25])
                body.add("cable", rod(anchor, (x, y, beam), 0.02, 6))
                body.add("concrete", footing(anchor[0], anchor[1], 0.5, 0.4))
        reach = self.spread_m + self.overhang_m
        near, far = (np.array([(x - 0.4, y, beam - 0.4), (x + 0.4, y, beam - 0.4), (x + 0.4, y, beam + 0.4),
                               (x - 0.4, y, beam + 0.4)]) for y in (-reach, reach))
        body.add_all("zinc", lattice(near, far, 16, 0.1, 0.06))


@dataclass(frozen=True)
class CatHeadLine(Family):
    """Lattice pylons whose trunk opens into two horns that carry a beam, with the middle phase in the window."""

    length_m: float = between(50.0, 60.0)
    """Between the first and the last pylon."""
    pylons: int = whole(2, 3)
    height_m: float = between(19.0, 27.0)
    foot_m: float = between(1.8, 2.6)
    waist: float = between(0.45, 0.6)
    """Share of the height at which the trunk opens."""
    window_m: float = between(2.6, 3.8)
    """Half the width of the window at the beam."""
    overhang_m: float = between(2.5, 3.8)
    insulator_m: float = between(1.4, 2.2)
    sag_m: float = between(1.2, 2.2)

    def build(self, rng: np.random.Generator) -> Body:
        """The line along x."""
        body = Body()
        stations = np.linspace(-self.length_m / 2, self.length_m / 2, self.pylons).tolist()
        reach = self.window_m + self.overhang_m
        places = (-reach + 0.15, 0.0, reach - 0.15)
        low = self.height_m - 2.4
        for x in stations:
            self._pylon(body, x, reach)
            for y in places:
                body.add("ceramic", insulator((x, y, low + 0.03), self.insulator_m, 10))
        string_wires(body, stations, [(y, low - self.insulator_m) for y in places], self.sag_m)
        string_wires(body, stations, [(s * self.window_m, self.height_m) for s in (-1.0, 1.0)], 0.8 * self.sag_m)
        return body

    def _pylon(self, body: Body, x: float, reach: float) -> None:
        waist_z, beam = self.waist * self.height_m, self.height_m - 2.4
        foot = rectangle_ring((x, 0.0), (self.foot_m, self.foot_m), 0.3)
        waist = rectangle_ring((x, 0.0), (0.55, 0.55), waist_z)
        body.add_all("zinc", lattice(foot, waist, 5, 0.15, 0.08))
        for corner in foot:
            body.add("concrete", footing(corner[0], corner[1], 0.45, 0.4))
        for s in (-1.0, 1.0):
            elbow_z, y = waist_z + 0.45 * (beam - waist_z), s * self.window_m
            root = rectangle_ring((x, s * 0.28), (0.5, 0.27), waist_z)
            elbow = rectangle_ring((x, 0.85 * y), (0.4, 0.35), elbow_z)
            head = rectangle_ring((x, y), (0.35, 0.4), beam)
            peak = rectangle_ring((x, y), (0.04, 0.04), self.height_m + 0.05)
            for a, b, panels in ((root, elbow, 5), (elbow, head, 4), (head, peak, 3)):
                body.add_all("zinc", lattice(a, b, panels, 0.1, 0.06))
            tip = np.array([(x - 0.05, s * reach, beam), (x + 0.05, s * reach, beam), (x + 0.05, s * reach, beam + 0.1),
                            (x - 0.05, s * reach, beam + 0.1)])
            body.add_all("zinc", lattice(_section(x, s * (self.window_m + 0.3), beam), tip, 4, 0.08, 0.05))
        west, east = (_section(x, s * self.window_m, beam) for s in (-1.0, 1.0))
        body.add_all("zinc", lattice(west, east, 9, 0.09, 0.055))


def _section(x: float, y: float, z: float) -> Array:
    """Section (4, 3) of a beam across the line."""
    return np.array([(x - 0.35, y, z), (x + 0.35, y, z), (x + 0.35, y, z + 0.8), (x - 0.35, y, z + 0.8)])
