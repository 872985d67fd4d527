"""Closed solids that the families are put together from. They overlap by centimetres where they meet."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_bridge.scenes.solids import Solid, box, joined, lathe, planar_mapped, tube

Array = NDArray[np.float64]
Ints = NDArray[np.int32]


def square(width: float, depth: float = 0.0) -> Array:
    """Profile (4, 2) of a rectangular bar centred on its axis; depth (along its second axis) as width if not given."""
    x, y = width / 2, (depth or width) / 2
    return np.array([(-x, -y), (x, -y), (x, y), (-x, y)])


def angle_steel(width: float) -> Array:
    """Profile (6, 2) of an angle section whose flanges are a ninth of its width thick."""
    t = width / 9.0
    return np.array([(0.0, 0.0), (width, 0.0), (width, t), (t, t), (t, width), (0.0, width)])


def circle(radius: float, sides: int) -> Array:
    """Profile (sides, 2) of a round bar."""
    t = np.arange(sides) * 2.0 * np.pi / sides
    return radius * np.stack([np.cos(t), np.sin(t)], axis=1)


def members(starts: ArrayLike, ends: ArrayLike, profile: Array, towards: ArrayLike = ((0.0, 0.0, 1.0),)) -> Solid:
    """Straight members between points (n, 3) with one closed profile (k, 2), counter-clockwise, and end faces.

    The profile's second axis points as far towards a direction (n, 3) or (1, 3) as the member's own direction allows.
    The end faces are fans about the profile's first point.
    """
    start, end = np.asarray(starts, dtype=np.float64), np.asarray(ends, dtype=np.float64)
    length = np.linalg.norm(end - start, axis=1)
    along = (end - start) / length[:, None]
    across = np.cross(np.broadcast_to(np.asarray(towards, dtype=np.float64), along.shape), along)
    across = np.where((np.linalg.norm(across, axis=1) < 1e-6)[:, None], np.cross((1.0, 0.0, 0.0), along), across)
    across /= np.linalg.norm(across, axis=1)[:, None]
    up = np.cross(along, across)
    ring = profile[None, :, :1] * -across[:, None] + profile[None, :, 1:] * up[:, None]
    a, b = start[:, None] + ring, end[:, None] + ring
    sides = np.stack([np.roll(a, -1, axis=1), a, b, np.roll(b, -1, axis=1)], axis=2)
    reach = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.roll(profile, -1, axis=0) - profile, axis=1))])
    u = 3.1 * start[:, :1, None] + np.stack([reach[1:], reach[:-1], reach[:-1], reach[1:]], axis=1)
    v = start[:, 2, None, None] + length[:, None, None] * np.array([0.0, 0.0, 1.0, 1.0])
    uv = np.stack(np.broadcast_arrays(u, v), axis=-1)
    n, k = len(start), len(profile)
    flat = np.broadcast_to(profile, (n, k, 2)).reshape(-1, 2)
    first = 4 * np.arange(n * k)[:, None, None]
    fan = np.stack([np.zeros(k - 2), np.arange(1, k - 1), np.arange(2, k)], axis=1).astype(np.int64)
    caps = 4 * n * k + k * np.arange(n)[:, None, None]
    faces = [(first + np.array([[0, 1, 2], [0, 2, 3]])), caps + fan, caps + n * k + fan[:, ::-1]]
    return Solid(np.concatenate([sides.reshape(-1, 3), a.reshape(-1, 3), b.reshape(-1, 3)]),
                 np.concatenate([f.reshape(-1, 3) for f in faces]).astype(np.int32),
                 np.concatenate([uv.reshape(-1, 2), flat, flat]))


def bar(start: ArrayLike, end: ArrayLike, width: float, depth: float = 0.0,
        towards: ArrayLike = (0.0, 0.0, 1.0)) -> Solid:
    """A rectangular bar between two points."""
    return members(_row(start), _row(end), square(width, depth), _row(towards))


def angle(start: ArrayLike, end: ArrayLike, width: float, towards: ArrayLike = (0.0, 0.0, 1.0)) -> Solid:
    """An angle-steel member between two points."""
    return members(_row(start), _row(end), angle_steel(width), _row(towards))


def rod(start: ArrayLike, end: ArrayLike, radius: float | Sequence[float], sides: int = 8) -> Solid:
    """A round rod between two points with one radius, or one at each end."""
    if isinstance(radius, float):
        return members(_row(start), _row(end), circle(radius, sides))
    return tube(np.stack([start, end]), np.asarray(radius, dtype=np.float64), sides, capped=True)


def drum(profile: ArrayLike, foot: ArrayLike = (0.0, 0.0, 0.0), sides: int = 24) -> Solid:
    """A closed solid of revolution from a profile (n, 2) of radius and height, upwards along its outside."""
    line = np.asarray(profile, dtype=np.float64)
    return lathe(np.concatenate([[(0.0, line[0, 1])], line, [(0.0, line[-1, 1])]]), foot, sides)


def ball(centre: ArrayLike, radius: float, sides: int = 24, flat: float = 1.0) -> Solid:
    """A sphere, or a spheroid whose height is flat times its width."""
    t = np.linspace(-np.pi / 2, np.pi / 2, sides // 2 + 1)
    profile = np.stack([radius * np.cos(t), flat * radius * np.sin(t)], axis=1)
    profile[[0, -1], 0] = 0.0
    return lathe(profile, centre, sides)


def vessel(start: ArrayLike, end: ArrayLike, radius: float, sides: int = 28) -> Solid:
    """A cylinder between two points with rounded heads beyond them."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    along = (b - a) / np.linalg.norm(b - a)
    t = np.linspace(0.0, 0.96 * np.pi / 2, 7)
    head, reach = radius * np.cos(t), 0.5 * radius * np.sin(t)
    path = np.concatenate([a - reach[::-1, None] * along, b + reach[:, None] * along])
    return tube(path, np.concatenate([head[::-1], head]), sides, capped=True)


def pipe(points: ArrayLike, radius: float, sides: int = 12) -> Solid:
    """A pipe through points (n, 3) with ball elbows."""
    path = np.asarray(points, dtype=np.float64)
    legs = [rod(a, b, radius, sides) for a, b in pairwise(path)]
    return joined([*legs, *(ball(p, 1.12 * radius, sides) for p in path[1:-1])])


def loft(rings: ArrayLike) -> Solid:
    """A closed solid through convex rings (n, k, 3), each counter-clockwise seen from the last one's side."""
    points = np.asarray(rings, dtype=np.float64)
    n, k = points.shape[:2]
    index = np.arange(n * k, dtype=np.int32).reshape(n, k)
    a, b = index[:-1], index[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    sides = np.concatenate([np.stack([a, d, c], axis=-1), np.stack([a, c, b], axis=-1)]).reshape(-1, 3)
    fan = np.stack([np.zeros(k - 2, np.int32), np.arange(1, k - 1), np.arange(2, k)], axis=1).astype(np.int32)
    faces = np.concatenate([sides, fan[:, ::-1], fan + np.int32((n - 1) * k)])
    return planar_mapped(*_without_slivers(points.reshape(-1, 3), faces))


def frustum(middle: Sequence[float], low: Sequence[float], high: Sequence[float], z0: float, z1: float) -> Solid:
    """A four-sided tapering block about (x, y): half sides (2,) at z0 and at z1."""
    return loft([rectangle_ring(middle, low, z0), rectangle_ring(middle, high, z1)])


def rectangle_ring(middle: Sequence[float], half: Sequence[float], z: float) -> Array:
    """(4, 3) corners of a level rectangle, counter-clockwise seen from above."""
    (x, y), (a, b) = middle, half
    return np.array([(x - a, y - b, z), (x + a, y - b, z), (x + a, y + b, z), (x - a, y + b, z)])


def ribbon(lower: ArrayLike, upper: ArrayLike, y0: float, y1: float) -> Solid:
    """What lies between two lines (n, 2) of x and z, from y0 to y1: arches, gables, ramps.

    Both lines run towards larger x with points over each other; they may touch at the ends.
    """
    low, high = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)

    def lifted(line: Array, y: float) -> Array:
        return np.stack([line[:, 0], np.full(len(line), y), line[:, 1]], axis=1)

    rings = np.stack([lifted(low, y0), lifted(low, y1), lifted(high, y1), lifted(high, y0)], axis=1)
    return loft(rings)


def footing(x: float, y: float, half: float, height: float) -> Solid:
    """A square block on the ground."""
    return box((x - half, y - half, 0.0), (x + half, y + half, height))


def turned_profile(outline: ArrayLike, sides: int = 48, foot: ArrayLike = (0.0, 0.0, 0.0)) -> Solid:
    """A closed hollow solid of revolution from an outline (n, 2) of radius and height, counter-clockwise in (r, z)."""
    line = np.asarray(outline, dtype=np.float64)
    return lathe(np.concatenate([line, line[:1]]), foot, sides)


def collar(inner: float, outer: float, z0: float, z1: float, sides: int = 48,
           foot: ArrayLike = (0.0, 0.0, 0.0)) -> Solid:
    """A level ring of rectangular section around a shaft."""
    return turned_profile([(inner, z0), (outer, z0), (outer, z1), (inner, z1)], sides, foot)


def ring(radius: float, z: float, thick: float, middle: tuple[float, float] = (0.0, 0.0)) -> Solid:
    """A level hoop of square section about the vertical through x and y."""
    return collar(radius - thick, radius + thick, z - thick, z + thick, foot=(*middle, 0.0))


def raised(points: ArrayLike, height: float) -> Array:
    """Points (3,) or (n, 3) moved up."""
    return np.add(points, (0.0, 0.0, height))


def turned(solid: Solid) -> Solid:
    """The solid turned about the vertical by a quarter: x becomes y, y becomes -x."""
    x, y, z = solid.vertices_m.T
    return Solid(np.stack([-y, x, z], axis=1), solid.faces, solid.uv_m)


def moved(solid: Solid, by: ArrayLike) -> Solid:
    """The solid moved, its texture with it."""
    return Solid(solid.vertices_m + np.asarray(by, dtype=np.float64), solid.faces, solid.uv_m)


def _row(point: ArrayLike) -> Array:
    return np.asarray(point, dtype=np.float64)[None]


def _without_slivers(points: Array, faces: Ints) -> tuple[Array, Ints]:
    """The mesh with coinciding points made one and without the faces that this flattens."""
    _, first, place = np.unique(np.round(points, 6), axis=0, return_index=True, return_inverse=True)
    merged = first[place.ravel()][faces]
    flat = (merged == np.roll(merged, 1, axis=1)).any(axis=1)
    return points, merged[~flat].astype(np.int32)
