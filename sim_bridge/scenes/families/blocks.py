"""Bodies of axis-aligned boxes of several materials, without hidden or doubled faces: piers, decks, buildings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim_bridge.scenes.solids import Solid, quads

Array = NDArray[np.float64]
AIR = 0
SAME_DECIMALS = 4


class Blocks:
    """Boxes that make one body: where two overlap the later one wins; only faces towards the air are kept.

    The faces of all materials together are closed: the body is cut along one rectilinear grid, so that neighbouring
    faces share whole edges.
    """

    def __init__(self) -> None:
        self._corners: list[tuple[Sequence[float], Sequence[float]]] = []
        self._materials: list[str] = []

    def add(self, material: str, lo: Sequence[float], hi: Sequence[float]) -> None:
        """Fill the box between two corners (3,), given in any order, with a material."""
        self._corners.append((np.minimum(lo, hi).tolist(), np.maximum(lo, hi).tolist()))
        self._materials.append(material)

    def cut(self, lo: Sequence[float], hi: Sequence[float]) -> None:
        """Take the box between two corners (3,) out of what has been added so far."""
        self.add("", lo, hi)

    def solids(self) -> dict[str, Solid]:
        """The surface by material."""
        if not self._corners:
            return {}
        corners = np.round(np.array(self._corners), SAME_DECIMALS)
        lines = [np.unique(corners[:, :, axis]) for axis in range(3)]
        names = list(dict.fromkeys(m for m in self._materials if m))
        label = np.zeros(tuple(len(line) + 1 for line in lines), np.int16)
        for (lo, hi), material in zip(corners, self._materials, strict=True):
            span = tuple(slice(int(np.searchsorted(line, a)) + 1, int(np.searchsorted(line, b)) + 1)
                         for line, a, b in zip(lines, lo, hi, strict=True))
            label[span] = names.index(material) + 1 if material else AIR
        found: list[tuple[NDArray[np.int16], Array]] = [f for axis in range(3) for f in _faces(label, lines, axis)]
        labels, faces = (np.concatenate(column) for column in zip(*found, strict=True))
        return {name: quads(faces[labels == i + 1]) for i, name in enumerate(names) if (labels == i + 1).any()}


def _faces(label: NDArray[np.int16], lines: list[Array], axis: int) -> list[tuple[NDArray[np.int16], Array]]:
    """Labels (n,) and corners (n, 4, 3) of the faces across one axis, those that look up it first."""
    below = np.take(label, np.arange(label.shape[axis] - 1), axis)
    above = np.take(label, np.arange(1, label.shape[axis]), axis)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    out = []
    for inner, outer, order in ((below, above, [0, 1, 2, 3]), (above, below, [3, 2, 1, 0])):
        cells = np.argwhere((inner != AIR) & (outer == AIR))
        corners = np.zeros((len(cells), 4, 3))
        corners[:, :, axis] = lines[axis][cells[:, axis]][:, None]
        for corner, (du, dv) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
            corners[:, corner, u] = lines[u][cells[:, u] - 1 + du]
            corners[:, corner, v] = lines[v][cells[:, v] - 1 + dv]
        out.append((inner[tuple(cells.T)], corners[:, order]))
    return out
