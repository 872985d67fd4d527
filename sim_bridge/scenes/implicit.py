"""Curved solids as signed distance fields on a grid, and their surface by naive surface nets (Gibson 1998)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

Array = NDArray[np.float64]
Volume = NDArray[np.float32]
Ints = NDArray[np.int32]
Distance = Callable[[Volume, Volume, Volume], Volume]
"""Signed distance, negative inside, at broadcastable coordinates x, y, z in metres."""

Limb = tuple[Distance, Array, Array]
"""A solid's distance and the two corners (3,) of a box around it."""

_FAR = np.float32(1e3)


@dataclass(frozen=True, eq=False)
class Field:
    """Signed distances (i, j, k) at origin_m + step_m * (i, j, k), filled by adding solids that melt together."""

    origin_m: Array
    step_m: float
    values: Volume

    @classmethod
    def empty(cls, lo: ArrayLike, hi: ArrayLike, step_m: float) -> Field:
        """A field over the box lo, hi (3,) with nothing in it."""
        origin = np.asarray(lo, dtype=np.float64)
        shape = np.ceil((np.asarray(hi) - origin) / step_m).astype(int) + 1
        return cls(origin, step_m, np.full(tuple(shape), _FAR, dtype=np.float32))

    def add(self, distance: Distance, lo: ArrayLike, hi: ArrayLike, melt_m: float) -> None:
        """Unite with a solid that lies inside the box lo, hi (3,), rounding the joint over melt_m."""
        first = np.maximum(np.floor((np.asarray(lo) - melt_m - self.origin_m) / self.step_m), 0).astype(int)
        last = np.ceil((np.asarray(hi) + melt_m - self.origin_m) / self.step_m).astype(int) + 1
        block = tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
        x, y, z = np.ix_(*(
            (self.origin_m[i] + self.step_m * np.arange(self.values.shape[i])[block[i]]).astype(np.float32)
            for i in range(3)))
        a, b = self.values[block], distance(x, y, z)
        h = np.maximum(melt_m - np.abs(a - b), 0.0) / melt_m
        self.values[block] = np.minimum(a, b) - np.float32(0.25 * melt_m) * h * h


def round_cone(start: ArrayLike, end: ArrayLike, radii: tuple[float, float],
               flatten_y: float = 1.0) -> Limb:
    """A limb between two points with a radius at each, thinner along y by flatten_y; with its box.

    The distance is exact for equal radii and no flattening, and a good bound for slender limbs otherwise.
    """
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    along = (b - a) * np.array([1.0, flatten_y, 1.0])
    length2 = float(along @ along)

    def distance(x: Volume, y: Volume, z: Volume) -> Volume:
        dx, dy, dz = x - a[0].astype(np.float32), (y - np.float32(a[1])) * np.float32(flatten_y), z - np.float32(a[2])
        t = np.clip((dx * along[0] + dy * along[1] + dz * along[2]) / length2, 0.0, 1.0)
        radius = radii[0] + (radii[1] - radii[0]) * t
        gap = np.sqrt((dx - t * along[0]) ** 2 + (dy - t * along[1]) ** 2 + (dz - t * along[2]) ** 2)
        return np.asarray((gap - radius) / np.float32(np.sqrt(flatten_y)), dtype=np.float32)

    reach = max(radii)
    return distance, np.minimum(a, b) - reach, np.maximum(a, b) + reach


def surface(field: Field) -> tuple[Array, Ints]:
    """Vertices (n, 3) and triangles (m, 3) of the zero level, outward; open where the solid leaves the grid.

    One vertex per grid cell that the surface crosses, at the mean of its edge crossings, and one quadrilateral per
    crossed edge.
    """
    f = field.values
    cell_shape = tuple(n - 1 for n in f.shape)
    total, count = np.zeros((*cell_shape, 3)), np.zeros(cell_shape, np.int32)
    crossed = []
    for axis in range(3):
        low, high = _ends(f, axis)
        edges = np.argwhere((low < 0) != (high < 0))
        f0, f1 = (v[tuple(edges.T)].astype(np.float64) for v in (low, high))
        point = edges.astype(np.float64)
        point[:, axis] += f0 / (f0 - f1)
        others = [i for i in range(3) if i != axis]
        around = np.repeat(edges[:, None, :], 4, axis=1)
        around[:, [1, 2], others[0]] -= 1
        around[:, [2, 3], others[1]] -= 1
        inner = (around >= 0) & (around < cell_shape)
        for corner in range(4):
            ok = inner[:, corner].all(axis=1)
            at = tuple(around[ok, corner].T)
            np.add.at(total, at, point[ok])
            np.add.at(count, at, 1)
        whole = inner.all(axis=(1, 2))
        outward = (f0 < 0) != (axis == 1)
        crossed.append(np.where(outward[whole, None, None], around[whole], around[whole][:, ::-1]))
    return _meshed(field, total, count, np.concatenate(crossed))


def relaxed(vertices: Array, faces: Ints, rounds: int) -> Array:
    """Vertices (n, 3) evened out along the surface without shrinking it (Taubin 1995)."""
    i, j = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    joined = csr_array((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(len(vertices), len(vertices)))
    degree = joined.sum(axis=1)[:, None]
    for weight in (0.5, -0.53) * rounds:
        vertices = vertices + weight * (joined @ vertices / degree - vertices)
    return vertices


def _ends(f: Volume, axis: int) -> tuple[Volume, Volume]:
    lower, upper = [slice(None)] * 3, [slice(None)] * 3
    lower[axis], upper[axis] = slice(None, -1), slice(1, None)
    return f[tuple(lower)], f[tuple(upper)]


def _meshed(field: Field, total: Array, count: Ints, quads: NDArray[np.int64]) -> tuple[Array, Ints]:
    number = np.cumsum(count.ravel() > 0).reshape(count.shape) - 1
    vertices = field.origin_m + field.step_m * (total[count > 0] / count[count > 0][:, None])
    corners = number[quads[..., 0], quads[..., 1], quads[..., 2]].astype(np.int32)
    return vertices, np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
