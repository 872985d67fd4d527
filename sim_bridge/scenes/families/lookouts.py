"""Round towers with galleries: lookouts and lighthouses."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.facades import Mass, Windows, glaze, raise_mass
from sim_bridge.scenes.families.galleries import gallery
from sim_bridge.scenes.families.roofs import gable_roof, hip_roof
from sim_bridge.scenes.families.shapes import bar, collar, drum, raised, rod


@dataclass(frozen=True)
class ObservationTower(Family):
    """A concrete shaft with one or two pods and an aerial."""

    height_m: float = between(26.0, 38.0)
    """Up to the roof of the upper pod."""
    foot_m: float = between(1.8, 2.8)
    taper: float = between(0.55, 0.8)
    pods: int = whole(1, 2)
    pod_m: float = between(3.2, 5.0)
    """Radius beyond the shaft's foot."""
    pod: str = one_of("disc", "bowl", "drum")
    aerial_m: float = between(6.0, 11.0)
    fins: int = one_of(0, 3, 4)

    def build(self, rng: np.random.Generator) -> Body:
        """The tower."""
        body, h = Body(), self.height_m
        zs = np.linspace(0.0, h, 14)
        body.add("concrete", drum([(self._radius(z), z) for z in zs], sides=48))
        for k in range(self.fins):
            a = 2.0 * np.pi * k / self.fins
            out = np.array([np.cos(a), np.sin(a), 0.0])
            body.add("concrete", bar(raised(out * self.foot_m * 2.2, 0.7), raised(out * 0.6 * self.foot_m, 0.32 * h),
                                     0.5, 1.2))
        for k in range(self.pods):
            self._pod(body, h - k * 0.26 * h, self.pod_m * (1.0 - 0.3 * k))
        base = 2.4 * self.foot_m
        body.blocks.add("stone", (-base, -base, 0.0), (base, base, 0.8))
        body.add("white", rod((0.0, 0.0, h - 0.1), (0.0, 0.0, h + 0.5 * self.aerial_m), 0.35, 16))
        body.add("red", rod((0.0, 0.0, h + 0.5 * self.aerial_m - 0.1), (0.0, 0.0, h + self.aerial_m), [0.3, 0.06], 12))
        return body

    def _radius(self, z: float) -> float:
        return self.foot_m * (self.taper + (1.0 - self.taper) * float(np.exp(-4.0 * z / self.height_m)))

    def _pod(self, body: Body, top: float, wide: float) -> None:
        r = wide + self._radius(top)
        low = {"disc": 2.2, "bowl": 3.6, "drum": 4.2}[self.pod]
        inner = self._radius(top) + 0.1 if self.pod != "drum" else 0.8 * r
        body.add("white", drum([(inner, top - low - 0.8), (r, top - 2.2 if self.pod != "drum" else top - low),
                                (r, top - 1.9)], sides=56))
        body.add("glass", drum([(r - 0.12, top - 1.95), (r - 0.05, top - 0.45)], sides=56))
        body.add("white", drum([(r + 0.1, top - 0.5), (r + 0.1, top - 0.2), (0.5 * r, top + 0.25)], sides=56))
        for a in np.linspace(0.0, 2.0 * np.pi, 29)[:-1]:
            out = np.array([np.cos(a), np.sin(a), 0.0]) * (r - 0.03)
            body.add("trim", rod(raised(out, top - 1.95), raised(out, top - 0.45), 0.06, 6))
        gallery(body, 0.5 * r, top + 0.25, 0.35 * r)


@dataclass(frozen=True)
class Lighthouse(Family):
    """A round or octagonal tower with a gallery and a lantern, and the keeper's house at its foot."""

    height_m: float = between(16.0, 30.0)
    """Up to the gallery."""
    foot_m: float = between(2.6, 3.8)
    taper: float = between(0.5, 0.75)
    sides: int = one_of(8, 48)
    stripes: int = whole(0, 3)
    wall: str = one_of("white", "stone", "plaster")
    house: str = one_of("none", "gable", "hip")
    base_m: float = between(0.0, 3.0)

    def build(self, rng: np.random.Generator) -> Body:
        """The lighthouse with its house to the east."""
        body, h = Body(), self.height_m
        zs = np.linspace(0.0, h, 2 * self.stripes + 2)
        for k, (a, b) in enumerate(pairwise(zs)):
            steps = np.linspace(a - 0.01 * (k > 0), b, 6)
            body.add("red" if k % 2 else self.wall, drum([(self._radius(z), z) for z in steps], sides=self.sides))
        if self.base_m > 0.8:
            body.add("stone", drum([(self.foot_m + 1.6, 0.0), (self.foot_m + 1.2, self.base_m)], sides=self.sides))
        for k in range(4):
            a, z = k * np.pi / 2 + 0.4, h * (0.2 + 0.17 * k)
            out = raised(np.array([np.cos(a), np.sin(a), 0.0]) * (self._radius(z) - 0.15), z)
            body.add("glass", bar(out, raised(out, 1.3), 0.7, 0.7, (np.cos(a), np.sin(a), 0.0)))
        self._lantern(body)
        if self.house != "none":
            self._house(body)
        return body

    def _radius(self, z: float) -> float:
        t = z / self.height_m
        return self.foot_m * (1.0 - (1.0 - self.taper) * t * (1.35 - 0.35 * t))

    def _lantern(self, body: Body) -> None:
        h, r = self.height_m, self._radius(self.height_m)
        body.add("stone", drum([(r - 0.1, h - 0.9), (r + 0.7, h - 0.15), (r + 0.7, h - 0.05)], sides=self.sides))
        gallery(body, r, h, 0.95)
        room = 0.72 * r
        body.add("trim", drum([(room + 0.1, h - 0.05), (room + 0.1, h + 0.7)], sides=24))
        body.add("glass", drum([(room, h + 0.65), (room, h + 2.6)], sides=16))
        for a in np.arange(16) * 2.0 * np.pi / 16:
            out = np.array([np.cos(a), np.sin(a), 0.0]) * room
            body.add("trim", rod(raised(out, h + 0.65), raised(out, h + 2.6), 0.05, 6))
        t = np.linspace(0.0, 1.5, 8)
        body.add("copper", drum([((room + 0.25) * np.cos(a), h + 2.55 + 0.8 * room * np.sin(a)) for a in t], sides=32))
        body.add("trim", rod((0.0, 0.0, h + 2.5 + 0.75 * room), (0.0, 0.0, h + 4.2 + 0.8 * room), [0.1, 0.03]))

    def _house(self, body: Body) -> None:
        x = self.foot_m + 0.2
        house = Mass(x, -3.2, x + 8.5, 3.2, 0.0, 3.4)
        raise_mass(body, house, "plaster")
        glaze(body, house, 3.4, Windows(2.4, 1.0, 1.4, 1.0, surround="stone"), "+x -y +y")
        if self.house == "gable":
            gable_roof(body, house, 2.6, wall="plaster")
        else:
            hip_roof(body, house, 2.4)
        body.add("brick", drum([(0.45, 3.2), (0.4, 7.0)], (x + 6.0, 0.6, 0.0), 4))
        body.add("stone", collar(self.foot_m - 0.2, self.foot_m + 0.25, 0.0, 0.6))
