"""Mending what imported meshes bring along, and counting it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.scene import Faces, Vertices

SAME_POINT_M = 1e-6
LEAST_AREA_M2 = 1e-10

Uv = NDArray[np.float32]


@dataclass
class Repairs:
    """How many of each fault were found, over all parts of a file."""

    not_finite: int = 0
    out_of_range: int = 0
    degenerate: int = 0
    duplicate: int = 0
    bad_uv_parts: int = 0

    def notes(self) -> list[str]:
        """One sentence per kind of fault that was found."""
        told = (
            (self.not_finite, "dropped {} faces with NaN or infinite vertices"),
            (self.out_of_range, "dropped {} faces that refer to vertices which do not exist"),
            (self.degenerate, "dropped {} faces without area"),
            (self.duplicate, "dropped {} faces that repeat another one"),
            (self.bad_uv_parts, "ignored NaN or infinite texture coordinates in {} parts"),
        )
        return [sentence.format(count) for count, sentence in told if count]


def mended(vertices: Vertices, faces: NDArray[np.integer], uv: Uv | None,
           repairs: Repairs) -> tuple[Vertices, Faces, Uv | None]:
    """A mesh without faulty faces and without unused vertices, in the same order; the faults are counted.

    vertices: (n, 3) in metres; faces: (m, 3); uv: (n, 2) or None.
    """
    known = ((faces >= 0) & (faces < len(vertices))).all(axis=1)
    repairs.out_of_range += int((~known).sum())
    faces = faces[known]
    finite = np.isfinite(vertices[faces]).all(axis=(1, 2))
    repairs.not_finite += int((~finite).sum())
    faces = faces[finite]
    solid = _areas(vertices, faces) > LEAST_AREA_M2
    repairs.degenerate += int((~solid).sum())
    faces = faces[solid]
    first = _first_of_each(vertices, faces)
    repairs.duplicate += len(faces) - len(first)
    faces = faces[first]
    if uv is not None and not np.isfinite(uv[faces]).all():
        repairs.bad_uv_parts += 1
        uv = None
    return compacted(vertices, faces, uv)


def compacted(vertices: Vertices, faces: NDArray[np.integer],
              uv: Uv | None) -> tuple[Vertices, Faces, Uv | None]:
    """The same mesh without the vertices that no face uses."""
    used, index = np.unique(faces, return_inverse=True)
    return vertices[used], index.reshape(-1, 3).astype(np.int32), None if uv is None else uv[used]


def _areas(vertices: Vertices, faces: NDArray[np.integer]) -> Vertices:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def _first_of_each(vertices: Vertices, faces: NDArray[np.integer]) -> NDArray[np.intp]:
    """Rows of the faces that no earlier face covers with the same three points, whichever way it is wound."""
    if not len(faces):
        return np.zeros(0, np.intp)
    used, index = np.unique(faces, return_inverse=True)
    _, place = np.unique(np.round(vertices[used] / SAME_POINT_M), axis=0, return_inverse=True)
    corners = np.sort(place.ravel()[index].reshape(-1, 3), axis=1)
    _, first = np.unique(corners, axis=0, return_index=True)
    return np.sort(first)
