"""Plants that store gas and grain and move bulk goods: spheres, silos, conveyors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sim_bridge.scenes.families.body import Body
from sim_bridge.scenes.families.draw import Family, between, one_of, whole
from sim_bridge.scenes.families.facades import Mass, Windows, band, glaze, opening, raise_mass
from sim_bridge.scenes.families.roofs import gable_roof
from sim_bridge.scenes.families.shapes import ball, bar, collar, drum, footing, pipe, raised, rod
from sim_bridge.scenes.families.tanks import spiral_stair

SIDES = (-1.0, 1.0)


@dataclass(frozen=True)
class GasSpheres(Family):
    """Spherical tanks on braced legs with stairs and pipes."""

    spheres: int = whole(2, 4)
    radius_m: float = between(4.5, 7.0)
    clearance_m: float = between(1.5, 3.0)
    """Under the spheres."""
    legs: int = whole(8, 12)
    bracing: str = one_of("crosses", "belts")
    gap_m: float = between(3.0, 5.0)
    pipes: int = whole(2, 4)

    def build(self, rng: np.random.Generator) -> Body:
        """The spheres in a row along x, pipes to the south."""
        body = Body()
        pitch = 2.0 * self.radius_m + self.gap_m
        for k in range(self.spheres):
            x = (k - (self.spheres - 1) / 2) * min(pitch, 66.0 / self.spheres)
            self._sphere(body, x, rng.uniform(0.0, 2.0 * np.pi))
        reach = self.spheres * min(pitch, 66.0 / self.spheres) / 2
        for k in range(self.pipes):
            y = -self.radius_m - 1.5 - 0.5 * k
            body.add("zinc" if k % 2 else "paint", rod((-reach, y, 0.8), (reach, y, 0.8), 0.12 + 0.04 * (k % 2), 14))
        for x in np.linspace(-reach + 0.3, reach - 0.3, 9):
            near, far = -self.radius_m - 1.2, -self.radius_m - 1.6 - 0.5 * self.pipes
            body.add("concrete", bar((x, near, 0.35), (x, far, 0.35), 0.3, 0.7))
        return body

    def _sphere(self, body: Body, x: float, start: float) -> None:
        r, z = self.radius_m, self.radius_m + self.clearance_m
        body.add("white", ball((x, 0.0, z), r, 56))
        body.add("white", collar(r - 0.1, r + 0.06, z - 0.15, z + 0.15, 64, (x, 0.0, 0.0)))
        angles = np.arange(self.legs) * 2.0 * np.pi / self.legs
        feet = np.stack([x + 0.97 * r * np.cos(angles), 0.97 * r * np.sin(angles), np.full_like(angles, 0.2)], axis=1)
        for i, foot in enumerate(feet):
            after = feet[(i + 1) % self.legs]
            body.add("paint", rod(foot, raised(foot, z - 0.2), 0.26, 16))
            body.add("concrete", footing(foot[0], foot[1], 0.6, 0.4))
            if self.bracing == "crosses":
                body.add("paint", rod(raised(foot, 0.5), raised(after, z - 1.5), 0.05, 8),
                         rod(raised(after, 0.5), raised(foot, z - 1.5), 0.05, 8))
            else:
                for share in (0.3, 0.65):
                    body.add("paint", rod(raised(foot, share * z), raised(after, share * z), 0.1, 8))
        body.add("zinc", pipe([(x, 0.0, self.clearance_m + 0.2), (x, 0.0, 0.9), (x, -r - 1.5, 0.9)], 0.2, 14))
        body.add("red", drum([(0.35, 0.5), (0.35, 1.3), (0.1, 1.35), (0.1, 1.8), (0.3, 1.82), (0.3, 1.9)],
                             (x, -r - 0.8, 0.0), 18))
        spiral_stair(body, (x, 0.0), start, 0.3, z, lambda _: r)
        top = z + r
        body.add("trim", drum([(1.3, top - 0.25), (1.3, top)], (x, 0.0, 0.0), 28))
        rim = [(x + 1.25 * np.cos(a), 1.25 * np.sin(a)) for a in np.arange(12) * np.pi / 6]
        for (ax, ay), (bx, by) in zip(rim, rim[1:] + rim[:1], strict=True):
            body.add("trim", rod((ax, ay, top - 0.1), (ax, ay, top + 1.1), 0.03, 6))
            body.add("trim", rod((ax, ay, top + 1.05), (bx, by, top + 1.05), 0.03, 6))


@dataclass(frozen=True)
class SiloBattery(Family):
    """Rows of concrete or corrugated silos with a gallery on top, a head house and a loading shed."""

    columns: int = whole(3, 5)
    rows: int = whole(1, 2)
    radius_m: float = between(2.6, 4.0)
    height_m: float = between(16.0, 25.0)
    skin: str = one_of("concrete", "zinc", "white")
    hoops: int = whole(0, 12)
    head_m: float = between(4.0, 9.0)
    """Height of the head house above the silos."""
    shed: bool = one_of(True, False)

    def build(self, rng: np.random.Generator) -> Body:
        """The silos along x, the head house to the east."""
        body, r, h = Body(), self.radius_m, self.height_m
        pitch = 2.0 * r - 0.15
        width = self.rows * pitch
        for i in range(self.columns):
            for j in range(self.rows):
                x, y = i * pitch, (j - (self.rows - 1) / 2) * pitch
                flat = [(r + 0.15, h), (r + 0.15, h + 0.4)]
                roof = [(0.4, h + 0.3 * r)] if self.skin == "zinc" else flat
                body.add(self.skin, drum([(r, 0.0), (r, h), *roof], (x, y, 0.0), 48))
                for k in range(self.hoops):
                    z = 1.0 + (h - 2.0) * k / self.hoops
                    body.add(self.skin, collar(r - 0.08, r + 0.07, z, z + 0.12, 48, (x, y, 0.0)))
        floor = h + (0.25 * r if self.skin == "zinc" else 0.38)
        gallery = Mass(-0.5 * r, -1.7, self.columns * pitch, 1.7, floor, floor + 3.0)
        raise_mass(body, gallery, "zinc")
        glaze(body, gallery, 3.0, Windows(3.0, 1.4, 1.0, 1.1), "-x -y +y")
        body.next_blocks()
        x0 = self.columns * pitch - r - 0.2
        head = Mass(x0, -width / 2 + 0.3, x0 + 6.0, width / 2 - 0.3, 0.0, h + self.head_m)
        raise_mass(body, head, "concrete")
        glaze(body, head, 3.4, Windows(2.9, 1.2, 1.4, 1.2), "+x -y +y", first=1)
        opening(body, head, "+x", (0.6, 0.05, 3.4, 3.2), Windows(1, 1, 1, 1, frame="paint"))
        band(body, head, "concrete", head.z1, head.z1 + 0.3, 0.2)
        body.add("zinc", pipe([(head.x1 - 1.0, 0.0, head.z1), (head.x1 - 1.0, 0.0, head.z1 + 1.5),
                               (head.x1 + 1.6, 0.0, head.z1 + 0.2), (head.x1 + 1.6, 0.0, 4.0)], 0.3, 16))
        if self.shed:
            body.next_blocks()
            shed = Mass(head.x1 - 0.3, head.y0 - 1.0, head.x1 + 8.0, head.y1 + 1.0, 0.0, 4.2)
            raise_mass(body, shed, "brick")
            glaze(body, shed, 4.2, Windows(2.6, 1.2, 1.3, 1.6), "-y +y")
            gable_roof(body, shed, 1.6, wall="brick", cover="zinc")
        return body


@dataclass(frozen=True)
class ConveyorWorks(Family):
    """Crusher and screen towers joined by inclined conveyor galleries on trestles, with hoppers and heaps."""

    towers: int = whole(2, 3)
    pitch_m: float = between(15.0, 18.5)
    tower_m: float = between(9.0, 16.0)
    side_m: float = between(4.5, 6.5)
    gallery: str = one_of("covered", "open")
    heaps: int = whole(1, 2)
    heap_m: float = between(3.5, 6.0)
    hoppers: bool = one_of(True, False)
    skin: str = one_of("zinc", "paint", "concrete")

    def build(self, rng: np.random.Generator) -> Body:
        """The works along x; goods travel east."""
        body = Body()
        xs = (np.arange(self.towers) - (self.towers - 1) / 2) * self.pitch_m
        heights = self.tower_m * (1.0 - 0.3 * rng.random(self.towers))
        for x, h in zip(xs.tolist(), heights.tolist(), strict=True):
            self._tower(body, x, h)
        half = self.side_m / 2
        for k in range(self.towers - 1):
            self._gallery(body, (xs[k] + half - 0.3, 0.0, 2.2), (xs[k + 1] - half + 0.3, 0.0, heights[k + 1] - 2.4))
        start = (xs[0] - 14.0, 0.0, 1.6)
        self._gallery(body, start, (xs[0] - half + 0.3, 0.0, heights[0] - 2.4))
        body.add("paint", drum([(0.7, 1.2), (2.2, 3.0), (2.2, 3.6)], (start[0], 0.0, 0.0), 4))
        for k in range(self.heaps):
            r = self.heap_m * 1.35
            x, y = xs[-1] + half + r + 1.0 - 3.0 * k, (2.0 if k == 0 else -1.0) * (k * (r + self.side_m) / 2)
            t = np.linspace(1.0, 0.02, 9)
            body.add("gravel", drum([(r * s, self.heap_m * (1.0 - s) * (1.0 - 0.12 * s)) for s in t], (x, y, 0.0), 40))
        end = (xs[-1] + half + self.heap_m * 1.35 + 1.0, 0.0, max(self.heap_m + 2.0, 0.75 * heights[-1]))
        self._gallery(body, (xs[-1] + half - 0.3, 0.0, 0.45 * heights[-1]), end)
        return body

    def _tower(self, body: Body, x: float, h: float) -> None:
        half = self.side_m / 2
        low = 3.4 if self.hoppers else 0.0
        tower = Mass(x - half, -half, x + half, half, low, h)
        raise_mass(body, tower, self.skin)
        glaze(body, tower, 3.2, Windows(2.3, 1.0, 1.2, 1.2))
        body.blocks.add("zinc", (x - half - 0.2, -half - 0.2, h), (x + half + 0.2, half + 0.2, h + 0.25))
        body.blocks.add("zinc", (x - 0.9, -0.9, h + 0.25), (x + 0.9, 0.9, h + 1.5))
        for sx in SIDES if self.hoppers else ():
            for sy in SIDES:
                cx, cy = x + sx * (half - 0.3), sy * (half - 0.3)
                body.add("paint", bar((cx, cy, 0.2), (cx, cy, low + 0.05), 0.4))
                body.add("concrete", footing(cx, cy, 0.6, 0.3))
            body.add("zinc", drum([(0.35, 1.4), (0.95, low + 0.05)], (x + sx * 0.25 * self.side_m, 0.0, 0.0), 4))
        for s in SIDES:
            body.add("trim", rod((x + half + 0.2, s * 0.25, low), (x + half + 0.2, s * 0.25, h - 0.1), 0.03, 6))
        for z in np.arange(low + 0.4, h - 0.4, 0.4):
            body.add("trim", rod((x + half + 0.2, -0.27, z), (x + half + 0.2, 0.27, z), 0.02, 6))

    def _gallery(self, body: Body, start: ArrayLike, end: ArrayLike) -> None:
        """A conveyor between two points, boxed in or with its belt and rollers open, on trestles."""
        a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
        along = (b - a) / np.linalg.norm(b - a)
        up = np.cross(along, (0.0, 1.0, 0.0))
        if self.gallery == "covered":
            body.add("zinc", bar(a, b, 2.0, 2.1), bar(a + 1.15 * up, b + 1.15 * up, 2.3, 0.12))
        else:
            for s in SIDES:
                side = np.array([0.0, 0.65 * s, 0.0])
                body.add("paint", bar(a + side, b + side, 0.12, 0.5))
                body.add("trim", rod(a + 1.4 * side + 1.2 * up, b + 1.4 * side + 1.2 * up, 0.03, 6))
            body.add("asphalt", bar(a + 0.35 * up, b + 0.35 * up, 1.0, 0.05))
            across = np.array([0.0, 1.0, 0.0])
            for t in np.arange(0.5, float(np.linalg.norm(b - a)) - 0.4, 1.2):
                foot = a + t * along
                body.add("zinc", rod(foot - 0.6 * across + 0.27 * up, foot + 0.6 * across + 0.27 * up, 0.08, 10))
                for s in SIDES:
                    post = foot + 0.91 * s * across
                    body.add("trim", rod(post - 0.2 * up, post + 1.2 * up, 0.025, 6))
                    body.add("trim", rod(foot + 0.6 * s * across - 0.1 * up, post - 0.1 * up, 0.03, 6))
        for share in (0.35, 0.7):
            head = a + share * (b - a) - 0.9 * up * (self.gallery == "covered")
            if head[2] > 1.8:
                self._trestle(body, head)

    def _trestle(self, body: Body, head: np.ndarray) -> None:
        wide = 0.8 + 0.09 * head[2]
        feet = [(head[0], s * wide, 0.1) for s in SIDES]
        tops = [(head[0], s * 0.6, head[2] + 0.1) for s in SIDES]
        for foot, top in zip(feet, tops, strict=True):
            body.add("paint", bar(foot, top, 0.22, 0.22))
            body.add("concrete", footing(foot[0], foot[1], 0.45, 0.3))
        low = [(head[0], s * (wide - (wide - 0.6) * 0.45), 0.1 + 0.45 * head[2]) for s in SIDES]
        body.add("paint", bar(low[0], low[1], 0.14), bar(feet[0], low[1], 0.1), bar(feet[1], low[0], 0.1),
                 bar(low[0], tops[1], 0.1), bar(low[1], tops[0], 0.1))
