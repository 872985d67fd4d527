"""How much of the surface that can be seen was seen, estimated from the map alone.

Seen are the faces of known surface that pictures have shown. Missing are the faces, of known and of imagined voxels,
that no picture has shown though views from the lattice would: each counts by the chance that its voxel is solid and the
next one is not. What is buried, or hidden from wherever a camera may stand, counts neither way: the estimate is of
coverage relative to what all views of the lattice together could cover.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from missions.sensors import fibonacci_directions
from planning.nbv.sight_kernels import FACES, show_from
from planning.nbv.sights import BLOCK_VOXELS, SURELY, ImaginedMap, new_blocks

MISSING_WEIGHT = 1.0
"""What is really there of the missing surface that is expected: the imagination is taken at its word. What
`swarmscan bench coverage --fit` finds lies between 0.8 and 1.2, and errors hardly depend on it there."""
RAYS = 512
MOST_POSITIONS = 300
"""Of more positions as many are drawn."""

Box = tuple[slice, ...]


@dataclass(frozen=True)
class SurfaceTally:
    """Area of voxels' faces: what was seen, and what is expected to be missing."""

    seen_m2: float
    missing_m2: float

    @property
    def coverage(self) -> float:
        """Estimated share of the visible surface that was seen, 0 to 1; 0 where none is known."""
        return self.seen_m2 / (self.seen_m2 + self.missing_m2) if self.seen_m2 > 0.0 else 0.0


def surface_tally(imagined: ImaginedMap, box: Box, positions_enu_m: Array, range_m: float) -> SurfaceTally:
    """What of the surface in a box (of indices) was seen, and what views in all directions from positions (p, 3) would
    still show; positions that are likelier solid than free show nothing."""
    missing = visible_faces(imagined, positions_enu_m, range_m)[box]
    expected = sum(float((chance[box] * ((missing >> face) & 1)).sum())
                   for face, chance in enumerate(face_chances(imagined.occupancy)))
    return SurfaceTally(seen_m2(imagined, box), MISSING_WEIGHT * expected * imagined.voxel_m**2)


def seen_m2(imagined: ImaginedMap, box: Box) -> float:
    """Area of the faces of known surface in a box that pictures have shown."""
    shown = np.where(imagined.occupancy[box] >= 1.0, imagined.faced[box] & ~imagined.unseen[box], 0)
    return float(np.bitwise_count(shown).sum()) * imagined.voxel_m**2


def visible_faces(imagined: ImaginedMap, positions_enu_m: Array, range_m: float) -> NDArray[np.uint8]:
    """(i, j, k) bits of the new faces that views from these positions (p, 3) would likelier than not show."""
    voxels = (positions_enu_m - imagined.origin_enu_m) / imagined.voxel_m
    at = np.clip(voxels.astype(np.int64), 0, np.array(imagined.occupancy.shape) - 1)
    voxels = voxels[imagined.occupancy[tuple(at.T)] < SURELY]
    if len(voxels) > MOST_POSITIONS:
        voxels = voxels[np.random.default_rng(0).permutation(len(voxels))[:MOST_POSITIONS]]
    shares = show_from(imagined.occupancy, *new_blocks(imagined.unseen), BLOCK_VOXELS, voxels,
                       fibonacci_directions(RAYS), range_m / imagined.voxel_m, SURELY)
    return np.asarray(np.bitwise_or.reduce(shares, axis=0) & imagined.unseen)


def face_chances(occupancy: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """For each face -x, +x, -y, +y, -z, +z: (i, j, k) chance that the voxel is solid and the next one is not. Beyond
    the grid nothing is solid."""
    open_ = np.float32(1.0) - np.pad(occupancy, 1)
    beside = (np.roll(open_, 1 if face % 2 == 0 else -1, axis=face // 2)[1:-1, 1:-1, 1:-1] for face in range(FACES))
    return [occupancy * chance for chance in beside]
