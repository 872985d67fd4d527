"""What candidate views would show of a map that is partly imagined, and what is left of it once other views are taken.

Every voxel is solid with a probability (its occupancy: known, or imagined where nothing was seen), and of its six
faces those are new that no view which counts has shown: a girder seen from the left is still to be seen from the
right. The expected new surface of a view is the area of the faces that its rays come to, nearer voxels hiding farther
ones: volumetric rendering of novelty with occupancy as opacity, the idea of MAGICIAN (Li et al., CVPR 2026), done by
ray casting through voxels instead of by Gaussians. What is unknown is free or solid in pieces, not voxel by voxel
(`sight_kernels.ALIKE`).

Rays are cast once per position and shared by all of its orientations. What they meet is kept, in cells of a few voxels,
so that a search can ask what a view adds after others without casting again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.frames import Array
from missions.sensors import fibonacci_directions
from planning.nbv.interest import Interest
from planning.nbv.lattice import in_view
from planning.nbv.sight_kernels import FACES, cast_stops, count_stops, new_area, show, shown, view_sums

RAYS = 2048
SURELY = 0.5
"""A picture has shown a face when its rays reach it with this probability."""
BLOCK_VOXELS = 4
"""Rays that meet no block with something new are not followed."""
CELL_VOXELS = 4
"""Edge of a cell of `Sights`, in voxels: what is shown of a cell, all views share. Rays lie two to three voxels apart
where they end, farther when aslant, so that in smaller cells views of the same surface hardly meet, and ways along it
promise too much."""


@dataclass(frozen=True)
class Shown:
    """Faces of voxels, none twice."""

    voxel: NDArray[np.int64]
    """(n,) flat number in the grid."""
    faces: NDArray[np.uint8]
    """(n,) bit f is set for face f."""


@dataclass(frozen=True)
class ImaginedMap:
    """Occupancy of every voxel of a grid, and what of it is new; outside of the grid there is nothing."""

    origin_enu_m: Array
    voxel_m: float
    occupancy: NDArray[np.float32]
    """(i, j, k) probability that the voxel stops a ray, 0 where it is known to be free."""
    faced: NDArray[np.uint8]
    """(i, j, k) bit f is set where the voxel has a face f (-x, +x, -y, +y, -z, +z): the next one is not solid too."""
    unseen: NDArray[np.uint8]
    """(i, j, k) likewise, where that face is new; 0 wherever nothing is gained."""
    box: tuple[slice, ...]
    """Of indices, holds all that is of interest."""
    interest: Interest | None = None
    """What of it counts more than the rest."""

    @classmethod
    def new(cls, origin_enu_m: Array, voxel_m: float, occupancy: NDArray[np.float32],
            box: tuple[slice, ...]) -> ImaginedMap:
        """Nothing was shown yet. Between two voxels that are surely occupied there is no face."""
        solid = np.pad(occupancy >= 1.0, 1)
        faced = np.zeros(occupancy.shape, dtype=np.uint8)
        for face in range(FACES):
            beside = np.roll(solid, 1 if face % 2 == 0 else -1, axis=face // 2)
            faced |= np.where(~(solid & beside), np.uint8(1 << face), np.uint8(0))[1:-1, 1:-1, 1:-1]
        outside = np.ones(occupancy.shape, dtype=np.bool_)
        outside[box] = False
        unseen = np.where(outside | (occupancy <= 0.0), np.uint8(0), faced)
        return cls(origin_enu_m, voxel_m, occupancy, faced, unseen, box)

    def shown_by(self, pose: Pose, camera: Camera, range_m: float) -> Shown:
        """What a picture is likelier than not to show of the box."""
        rays = camera.rays_camera().reshape(-1, 3) @ pose.enu_from_camera.T
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        start = (np.array(pose.position_enu_m) - self.origin_enu_m) / self.voxel_m
        bits = np.zeros_like(self.faced)
        spans = [extent.indices(n)[:2] for extent, n in zip(self.box, self.occupancy.shape, strict=True)]
        lower, upper = np.array(spans, dtype=np.float64).T.copy()
        show(self.occupancy, bits, start, rays, lower, upper, range_m / self.voxel_m, SURELY)
        voxel = np.flatnonzero(bits != 0)  # numpy is three times as fast over booleans
        return Shown(voxel, bits.ravel()[voxel])

    def count_as_shown(self, shown: Shown) -> None:
        """What a picture has shown is not new any more."""
        self.unseen.reshape(-1)[shown.voxel] &= ~shown.faces

    def show(self, pose: Pose, camera: Camera, range_m: float) -> None:
        """Count as shown what a picture is likelier than not to show."""
        self.count_as_shown(self.shown_by(pose, camera, range_m))


@dataclass(frozen=True)
class Orientations:
    """The directions that rays are cast in and those of them that each orientation of the camera sees."""

    directions_enu: Array
    """(r, 3)"""
    first: NDArray[np.int64]
    """(o + 1,) orientation k sees rays[first[k]:first[k + 1]]."""
    rays: NDArray[np.int64]

    @classmethod
    def of(cls, yaw_enu_rad: Array, elevation_rad: Array, camera: Camera, rays: int = RAYS) -> Orientations:
        """For orientations (o,) of a camera."""
        directions = fibonacci_directions(rays)
        mask = in_view(directions, yaw_enu_rad, elevation_rad, camera)
        first = np.concatenate([[0], np.cumsum(mask.sum(axis=0))])
        return cls(directions, first, np.nonzero(mask.T)[1])

    @cached_property
    def by_ray(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The other way round: ray r is seen by orientations second[first[r]:first[r + 1]]."""
        orientation = np.repeat(np.arange(len(self)), np.diff(self.first))
        first = np.concatenate([[0], np.cumsum(np.bincount(self.rays, minlength=len(self.directions_enu)))])
        return first, orientation[np.argsort(self.rays, kind="stable")]

    def __len__(self) -> int:
        return len(self.first) - 1


@dataclass(frozen=True)
class Sights:
    """What every ray from every position may stop at: the faces, by direction, of cells of the grid."""

    orientations: Orientations
    first: NDArray[np.int64]
    """(p * r + 1,) ray j of position i meets entries [first[i * r + j], first[i * r + j + 1])."""
    cell: NDArray[np.int32]
    """Which face of which cell, by a number from 0 to cells - 1."""
    area_m2: NDArray[np.float32]
    """Expected new surface there on that ray."""
    arrives: NDArray[np.float32]
    """Probability that the ray gets as far."""
    cells: int

    @property
    def nothing_shown(self) -> NDArray[np.float32]:
        """(cells,) what is left to see of each cell before any view: all."""
        return np.ones(self.cells, dtype=np.float32)

    @cached_property
    def gains_m2(self) -> Array:
        """(p, o) expected new surface of every view, each taken alone."""
        return self.gains_after(self.nothing_shown)

    def gains_after(self, left: NDArray[np.float32]) -> Array:
        """(p, o) expected new surface of every view once only these shares (cells,) are left to see."""
        o = self.orientations
        positions = (len(self.first) - 1) // len(o.directions_enu)
        gains: Array = view_sums(self.first, self.cell, self.area_m2, left, *o.by_ray, positions, len(o))
        return gains

    def left_after(self, position: int, orientation: int, left: NDArray[np.float32]) -> NDArray[np.float32]:
        """(cells,) what is left to see after a view."""
        o = self.orientations
        result: NDArray[np.float32] = shown(self.first, self.cell, self.arrives, left, o.first, o.rays,
                                            len(o.directions_enu), position, orientation)
        return result


def sights(imagined: ImaginedMap, positions_enu_m: Array, orientations: Orientations, range_m: float) -> Sights:
    """Cast rays from positions (p, 3). Cost: p * r rays, each as long as it passes free or uncertain voxels."""
    voxel = imagined.voxel_m
    starts = (positions_enu_m - imagined.origin_enu_m) / voxel
    rays = imagined.occupancy, imagined.unseen
    count, until = count_stops(*rays, *new_blocks(imagined.unseen), BLOCK_VOXELS, starts, orientations.directions_enu,
                               range_m / voxel, CELL_VOXELS)
    first = np.concatenate([[0], np.cumsum(count.ravel())])
    scale = 4.0 * math.pi / len(orientations.directions_enu) * voxel**2
    cell, area, arrives = cast_stops(*rays, starts, orientations.directions_enu, until, CELL_VOXELS, first, scale)
    there = new_area(*rays, CELL_VOXELS)
    area = np.minimum(area, voxel**2 * there[cell])  # one ray that comes aslant from afar may stand for more
    faces = np.zeros(len(there), dtype=np.bool_)
    faces[cell] = True
    if imagined.interest is not None:
        area *= _weights(imagined, imagined.interest)[cell // FACES]
    number = np.cumsum(faces, dtype=np.int32) - 1
    return Sights(orientations, first, number[cell], area, arrives, int(faces.sum()))


def _weights(imagined: ImaginedMap, interest: Interest) -> NDArray[np.float32]:
    """How much what is shown of each cell counts: more where a box of interest reaches into it."""
    cells = [math.ceil(n / CELL_VOXELS) for n in imagined.occupancy.shape]
    index = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, 3)
    middle = imagined.origin_enu_m + (index + 0.5) * CELL_VOXELS * imagined.voxel_m
    half = 0.5 * CELL_VOXELS * imagined.voxel_m
    reaching = replace(interest, lower_enu_m=interest.lower_enu_m - half, upper_enu_m=interest.upper_enu_m + half)
    return reaching.weights_at(middle).astype(np.float32)


def new_blocks(unseen: NDArray[np.uint8]) -> tuple[NDArray[np.bool_], Array, Array]:
    """Which blocks of BLOCK_VOXELS along each edge hold something new, and the corners (3,), in blocks, of a box around
    all that do."""
    i, j, k = (math.ceil(n / BLOCK_VOXELS) for n in unseen.shape)
    padded = np.zeros((i * BLOCK_VOXELS, j * BLOCK_VOXELS, k * BLOCK_VOXELS), dtype=np.bool_)
    padded[tuple(slice(0, n) for n in unseen.shape)] = unseen > 0
    in_blocks = padded.reshape(i, BLOCK_VOXELS, j, BLOCK_VOXELS, k, BLOCK_VOXELS)
    blocks = np.asarray(in_blocks.any(axis=(1, 3, 5)))
    marked = [np.flatnonzero(blocks.any(axis=others)) for others in ((1, 2), (0, 2), (0, 1))]
    lower, upper = (np.array([n[end] + rim if len(n) else 0.0 for n in marked]) for end, rim in ((0, 0), (-1, 1)))
    return blocks, lower, upper
