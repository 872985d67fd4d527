"""Which reference points every view of a lattice truly sees, as packed bits: coverage, ceiling and oracles read them.

A point is seen when it lies within the sensing range and in the frame and nothing stands before it. 20,000 points and
50 views at each of 250 positions take 31 MiB and about ten seconds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array, enu_from_camera
from missions.pose_lattice import PoseLattice
from sim_bridge.coverage import TOLERANCE_M, in_frame
from sim_bridge.truth import BEFORE_FLIGHT_NS, Truth

Bits = NDArray[np.uint64]
WORD = 64


def seen_points(truth: Truth, lattice: PoseLattice, standable: NDArray[np.bool_], points_enu_m: Array, camera: Camera,
                range_m: float) -> Bits:
    """(poses, words) bit k of a row: whether that pose sees point k of (n, 3). Views that are not standable (p,) see
    nothing."""
    words = -(-len(points_enu_m) // WORD)
    seen = np.zeros((len(standable), lattice.orientations, words), dtype=np.uint64)
    views = [enu_from_camera(yaw, elevation) for yaw, elevation in lattice.yaw_elevation_rad]
    for p in np.flatnonzero(standable):
        away = points_enu_m - lattice.positions_enu_m[p]
        near = np.flatnonzero(np.einsum("ij,ij->i", away, away) <= range_m**2)
        near = near[truth.visible(lattice.positions_enu_m[p], points_enu_m[near], TOLERANCE_M, BEFORE_FLIGHT_NS)]
        for o, view in enumerate(views):
            seen[p, o] = packed(near[in_frame(away[near] @ view, camera)], words)
    return seen.reshape(-1, words)


def packed(members: NDArray[np.int64], words: int) -> Bits:
    """(words,) the set of these numbers."""
    mask = np.zeros(words * WORD, dtype=np.bool_)
    mask[members] = True
    return np.packbits(mask).view(np.uint64)


def count(bits: Bits) -> NDArray[np.int64]:
    """(...) how many are in each set (..., words)."""
    result: NDArray[np.int64] = np.bitwise_count(bits).sum(axis=-1, dtype=np.int64)
    return result
