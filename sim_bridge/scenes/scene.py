"""What a true scene is: named parts of triangles with their material, and the object's box.

World frame: local ENU, metres. Texture coordinates follow OpenGL and OBJ (v grows upwards) and repeat outside 0-1.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Vertices = NDArray[np.float64]
Faces = NDArray[np.int32]
Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles that share one material."""

    name: str
    vertices_enu_m: Vertices
    """(n, 3) float64."""
    faces: Faces
    """(m, 3) int32, counter-clockwise seen from outside where the source knows an outside."""
    uv: NDArray[np.float32] | None
    """(n, 2) float32, or None where the source has none."""
    texture: Image | None
    """(h, w, 3) uint8, top row first; parts with the same picture share one array."""
    color_rgb: tuple[int, int, int]
    is_object: bool
    """False for ground and surroundings."""
    procedural: bool
    """True where the part has no texture of its own and the renderer puts a procedural one on it."""
    water: bool = False
    """True for a level surface of water: it mirrors the sky on waves that lie differently in every picture."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A true world: what the cameras see and what the referee judges against."""

    name: str
    parts: list[Part]
    object_min_enu_m: tuple[float, float, float]
    object_max_enu_m: tuple[float, float, float]
    ground_up_m: float
    notes: list[str] = field(default_factory=list)
    """What the importer found and repaired, one sentence each."""

    def object_mesh(self) -> tuple[Vertices, Faces]:
        """Vertices (n, 3) and faces (m, 3) of the object alone, without ground and surroundings."""
        return merged(p for p in self.parts if p.is_object)

    def mesh(self) -> tuple[Vertices, Faces]:
        """Vertices (n, 3) and faces (m, 3) of all parts."""
        return merged(self.parts)

    def triangles(self) -> int:
        """Number of triangles of all parts."""
        return sum(len(p.faces) for p in self.parts)


def merged(parts: Iterable[Part]) -> tuple[Vertices, Faces]:
    """Vertices (n, 3) and faces (m, 3) of some parts in one mesh, in their order."""
    vertices, faces, start = [np.zeros((0, 3))], [np.zeros((0, 3), np.int32)], 0
    for part in parts:
        vertices.append(part.vertices_enu_m)
        faces.append(part.faces + np.int32(start))
        start += len(part.vertices_enu_m)
    return np.concatenate(vertices), np.concatenate(faces)
