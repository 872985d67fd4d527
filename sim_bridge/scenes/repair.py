"""Mending what imported meshes bring along, and counting it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.exposure import open_lines
from sim_bridge.scenes.scene import Faces, Part, Vertices, merged

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
    if uv is not None and not np.isfinite(uv[faces]).all():
        repairs.bad_uv_parts += 1
        uv = None
    return compacted(vertices, faces, uv)


def without_doubles(parts: list[Part], repairs: Repairs) -> list[Part]:
    """The parts without faces that lie on another one, in whichever part and whichever way wound; counted.

    Modelling programs write the two sides of a face with two materials. The side that looks into the open stays; of two
    such the textured one, else the earlier one.
    """
    vertices, faces = merged(parts)
    group = _groups(vertices, faces)
    doubled = np.flatnonzero(np.bincount(group)[group] > 1)
    sizes = [len(p.faces) for p in parts]
    bare = np.repeat([p.procedural for p in parts], sizes)
    openness = np.zeros(len(faces), dtype=np.int64)
    if len(doubled):
        openness[doubled] = open_lines(vertices, faces, doubled)
    order = np.lexsort((np.arange(len(faces)), bare, -openness))
    chosen = np.zeros(len(faces), dtype=bool)
    chosen[order[np.unique(group[order], return_index=True)[1]]] = True
    repairs.duplicate += int((~chosen).sum())
    kept = zip(parts, np.split(chosen, np.cumsum(sizes)[:-1]), strict=True)
    return [p if own.all() else selected(p, own) for p, own in kept if own.any()]


def selected(part: Part, chosen: NDArray[np.bool_]) -> Part:
    """The part with only the chosen (m,) faces."""
    vertices, faces, uv = compacted(part.vertices_enu_m, part.faces[chosen], part.uv)
    return replace(part, vertices_enu_m=vertices, faces=faces, uv=uv)


def compacted(vertices: Vertices, faces: NDArray[np.integer],
              uv: Uv | None) -> tuple[Vertices, Faces, Uv | None]:
    """The same mesh without the vertices that no face uses."""
    used, index = np.unique(faces, return_inverse=True)
    return vertices[used], index.reshape(-1, 3).astype(np.int32), None if uv is None else uv[used]


def _areas(vertices: Vertices, faces: NDArray[np.integer]) -> Vertices:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def _groups(vertices: Vertices, faces: Faces) -> NDArray[np.intp]:
    """A number (m,) per face, equal for faces with the same three points, whichever way they are wound."""
    _, place = np.unique(np.round(vertices / SAME_POINT_M), axis=0, return_inverse=True)
    _, group = np.unique(np.sort(place.ravel()[faces], axis=1), axis=0, return_inverse=True)
    return np.asarray(group.ravel(), dtype=np.intp)
