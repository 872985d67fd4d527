"""Where a straight leg meets a triangle mesh, and the box that the thesis puts around it (section 4.4.3, appendix A).

Appendix A tests "all mesh triangles fully enclosed within the spatial bounds defined by the line segment". Taken at its
word that misses every triangle that is larger than the leg's own bounds, such as a wall that the leg crosses. Tested
here is every triangle whose bounds overlap those of the leg, which none that is hit can fail.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array

PARALLEL = 1e-12
EDGE = 1e-9
"""Hits this far outside a triangle count, so that a leg cannot slip between two triangles by rounding."""
FLAT_M = 1e-3
"""A reference box is at least this much larger than what was hit: boxes around axis-parallel faces have no volume."""


@dataclass(frozen=True)
class Box:
    """An axis-aligned box (Eqs. 4.5 and 4.7): lower and upper corner (3,), ENU metres."""

    lower: Array
    upper: Array

    @classmethod
    def around(cls, triangles: Array) -> Box:
        """Bounds of the vertices of triangles (m, 3, 3), m > 0 (Eq. 4.5)."""
        vertices = triangles.reshape(-1, 3)
        return cls(vertices.min(axis=0), vertices.max(axis=0))

    def expanded(self, direction: Array, alpha: float) -> Box:
        """Scaled by alpha orthogonally to a direction of flight (unit vector, Eq. 4.6), unchanged along it.

        The corners are moved by d dᵀ + alpha (1 - d dᵀ) about the centre. Since Eq. 4.7 clips by axis-parallel planes,
        the bounds of the moved corners are returned.
        """
        along = np.outer(direction, direction)
        scale = along + alpha * (np.eye(3) - along)
        half = np.abs(scale) @ (0.5 * (self.upper - self.lower))
        centre = 0.5 * (self.lower + self.upper)
        return Box(centre - half, centre + half)

    def grown(self, margin_m: float) -> Box:
        """Larger by a margin on every side."""
        return Box(self.lower - margin_m, self.upper + margin_m)

    def contains(self, points_enu_m: Array) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3) lie in the box, its surface included."""
        points = np.asarray(points_enu_m, dtype=np.float64).reshape(-1, 3)
        return np.asarray(np.all((points >= self.lower) & (points <= self.upper), axis=1))


def hit_triangles(a_enu_m: Array, b_enu_m: Array, triangles: Array) -> NDArray[np.int64]:
    """Indices of the triangles (m, 3, 3) that the leg from a (3,) to b (3,) meets, in rising order.

    Möller and Trumbore: O + t D = (1 - u - v) V0 + u V1 + v V2 with D of unit length, t in [0, |b - a|], u, v >= 0 and
    u + v <= 1. Legs parallel to a triangle do not meet it.
    """
    length = float(np.linalg.norm(b_enu_m - a_enu_m))
    near = np.flatnonzero(_overlapping(triangles, Box(np.minimum(a_enu_m, b_enu_m), np.maximum(a_enu_m, b_enu_m))))
    if length == 0.0 or not len(near):
        return np.zeros(0, dtype=np.int64)
    direction = (b_enu_m - a_enu_m) / length
    v0 = triangles[near, 0]
    edge1, edge2 = triangles[near, 1] - v0, triangles[near, 2] - v0
    p = np.cross(direction, edge2)
    determinant = np.einsum("ij,ij->i", edge1, p)
    size = np.linalg.norm(edge1, axis=1) * np.linalg.norm(edge2, axis=1)
    crossing = np.abs(determinant) > PARALLEL * size
    inverse = np.divide(1.0, determinant, out=np.zeros_like(determinant), where=crossing)
    to_origin = a_enu_m - v0
    u = np.einsum("ij,ij->i", to_origin, p) * inverse
    q = np.cross(to_origin, edge1)
    v = q @ direction * inverse
    t = np.einsum("ij,ij->i", edge2, q) * inverse
    inside = (u >= -EDGE) & (v >= -EDGE) & (u + v <= 1.0 + EDGE) & (t >= 0.0) & (t <= length)
    return np.asarray(near[crossing & inside])


def clipped(triangles: Array, box: Box) -> Array:
    """(k, 3, 3) the parts of the triangles that lie in the box, cut by its six planes in turn (Eqs. 4.7 and 4.8)."""
    from trimesh.intersections import slice_faces_plane  # a third of all that the ground station would import

    near = triangles[_overlapping(triangles, box)]
    vertices, faces = near.reshape(-1, 3), np.arange(3 * len(near)).reshape(-1, 3)
    for axis in range(3):
        inwards = np.eye(3)[axis]
        for normal, origin in ((inwards, box.lower), (-inwards, box.upper)):
            if len(faces):
                vertices, faces, _ = slice_faces_plane(vertices, faces, normal, origin)
    return np.asarray(vertices[faces], dtype=np.float64).reshape(-1, 3, 3)


def halves(triangles: Array) -> Array:
    """(4 m, 3, 3) every triangle cut in four at the middles of its edges."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def _overlapping(triangles: Array, box: Box) -> NDArray[np.bool_]:
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    lower, upper = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    return np.asarray(np.all((lower <= box.upper + EDGE) & (upper >= box.lower - EDGE), axis=1))
