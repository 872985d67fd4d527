"""The map as a surface to draw: open faces of solid voxels, cut into blocks, thinned to what a client can draw."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array

BLOCK_VOXELS = 16
"""A change is sent as the blocks it touches."""
SHADES = (0.78, 0.84, 0.70, 0.92, 0.52, 1.0)
"""Of faces -x, +x, -y, +y, -z, +z: light from above, a little from the north-east."""
STEPS = np.array([(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)])
BOX_CORNERS = np.array([[(0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0)], [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],
                     [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)], [(0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0)],
                     [(0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0)], [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]])
"""(6, 4, 3) of each face, so that it looks outwards."""
Block = tuple[int, int, int]


@dataclass(frozen=True)
class Faces:
    """Open faces of cubes with an edge of `voxel_m`."""

    cube: NDArray[np.int64]
    """(f,) which of the cubes."""
    facing: NDArray[np.int64]
    """(f,) index in STEPS."""
    index: NDArray[np.int64]
    """(c, 3) of the cubes."""
    colour: NDArray[np.uint8]
    """(c, 3)"""
    voxel_m: float

    def blocks(self, origin_enu_m: Array) -> Iterator[tuple[Block, NDArray[np.float32], NDArray[np.uint32],
                                                            NDArray[np.uint8]]]:
        """Per block of cubes: (v, 3) vertices, (t, 3) triangles, (v, 3) colours."""
        block = self.index[self.cube] // BLOCK_VOXELS
        names, which = np.unique(block, axis=0, return_inverse=True)
        order = np.argsort(which.ravel(), kind="stable")
        ends = np.searchsorted(which.ravel()[order], np.arange(len(names) + 1))
        for n, name in enumerate(names.tolist()):
            yield (name[0], name[1], name[2]), *self._mesh(order[ends[n]:ends[n + 1]], origin_enu_m)

    def _mesh(self, rows: NDArray[np.int64], origin_enu_m: Array) -> tuple[
            NDArray[np.float32], NDArray[np.uint32], NDArray[np.uint8]]:
        cube, facing = self.cube[rows], self.facing[rows]
        corners = (self.index[cube][:, None] + BOX_CORNERS[facing]) * self.voxel_m + origin_enu_m
        colours = self.colour[cube] * np.array(SHADES)[facing][:, None]
        first = 4 * np.arange(len(rows), dtype=np.uint32)[:, None]
        triangles = np.concatenate([first + np.array([0, 1, 2], np.uint32), first + np.array([0, 2, 3], np.uint32)])
        return (corners.reshape(-1, 3).astype(np.float32), triangles,
                np.repeat(colours.astype(np.uint8), 4, axis=0))


def open_faces(index: NDArray[np.int64], colour: NDArray[np.uint8], voxel_m: float, most: int) -> Faces:
    """The open faces of solid voxels (n, 3) with colours (n, 3); where there are more than `most`, those of cubes two,
    four, ... times as large that hold at least one, in the mean of their colours."""
    faces = _open(index, colour, voxel_m)
    while len(faces.cube) > most and len(faces.index) > 1:
        coarse, which, count = np.unique(faces.index // 2, axis=0, return_inverse=True, return_counts=True)
        mean = np.stack([np.bincount(which.ravel(), faces.colour[:, c], len(coarse)) for c in range(3)], axis=1)
        faces = _open(coarse, (mean / count[:, None]).astype(np.uint8), 2.0 * faces.voxel_m)
    return faces


def _open(index: NDArray[np.int64], colour: NDArray[np.uint8], voxel_m: float) -> Faces:
    if not len(index):
        none = np.zeros(0, dtype=np.int64)
        return Faces(none, none, index, colour, voxel_m)
    low = index.min(axis=0) - 1
    solid = np.zeros(tuple(index.max(axis=0) - low + 2), dtype=np.bool_)
    solid[tuple((index - low).T)] = True
    cubes, facings = [], []
    for facing, step in enumerate(STEPS):
        cube = np.flatnonzero(~solid[tuple((index - low + step).T)])
        cubes.append(cube)
        facings.append(np.full(len(cube), facing))
    return Faces(np.concatenate(cubes), np.concatenate(facings), index, colour, voxel_m)
