"""Judges the true tracks of a simulated campaign mission: separation and clearance at all times, not at samples only.

It knows nothing of what vehicles announced or planned. Between two samples a body leaves the chord by at most
a dt^2 / 8, so the chord's distance less that bound holds for every instant in between.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from missions.frames import Array
from missions.grid import OCCUPIED, VoxelGrid
from planning.trajectories import Curve
from vehicle.simulator import NS

CHORD_STEP_M = 0.02
"""Clearance is looked up along a chord in steps of what is to spare, at least this."""
TOLERANCE_M = 0.03
"""Planners walk segments in steps of 5 cm, so what they call clear may lie half of that nearer."""


@dataclass(frozen=True)
class Verdict:
    """Lower bounds over the whole mission, and how often a pair or a body came nearer than allowed."""

    least_separation_m: float
    least_clearance_m: float
    separation_violations: int
    clearance_violations: int


def track(curves: list[tuple[int, Curve]], times_ns: NDArray[np.int64]) -> Array:
    """(T, 3) true positions at these times of a body that follows each curve from its start until the next starts."""
    starts = np.array([t for t, _ in curves])
    which = np.maximum(np.searchsorted(starts, times_ns, side="right") - 1, 0)
    out = np.empty((len(times_ns), 3))
    for n, (start, curve) in enumerate(curves):
        mine = which == n
        if mine.any():
            out[mine] = curve.at((times_ns[mine] - start) / NS)[0]
    return out


def judge(tracks: Array, flying: NDArray[np.bool_], times_ns: NDArray[np.int64], grid: VoxelGrid, separation_m: float,
          clearance_m: float, acceleration_m_s2: float) -> Verdict:
    """tracks (n, T, 3) at times (T,); flying (n, T). Curves change at these times only."""
    dt = np.diff(times_ns) / NS
    bow = acceleration_m_s2 * dt**2 / 8.0
    least, near = math.inf, 0
    for a in range(len(tracks)):
        for b in range(a):
            both = flying[a] & flying[b]
            gap = _chord_gaps(tracks[a] - tracks[b]) - 2.0 * bow
            gap = gap[both[1:] & both[:-1]]
            least = min(least, float(gap.min(initial=math.inf)))
            near += _onsets(gap < separation_m)
    room, bumps = math.inf, 0
    for a in range(len(tracks)):
        moved = np.any(np.diff(tracks[a], axis=0) != 0.0, axis=1) & flying[a][1:]
        p, q = np.ascontiguousarray(tracks[a][:-1][moved]), np.ascontiguousarray(tracks[a][1:][moved])
        gap = chord_clearances(p, q, grid.state == OCCUPIED, np.asarray(grid.origin_enu_m), grid.voxel_m,
                               clearance_m + 0.5) - bow[moved]
        room = min(room, float(gap.min(initial=math.inf)))
        bumps += _onsets(gap < clearance_m - TOLERANCE_M)
    return Verdict(least, room, near, bumps)


def _onsets(bad: NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(bad[1:] & ~bad[:-1])) + int(len(bad) > 0 and bool(bad[0]))


def _chord_gaps(relative: Array) -> Array:
    """(T - 1,) least distance of the chords of (T, 3) from the origin."""
    a, span = relative[:-1], np.diff(relative, axis=0)
    length2 = np.maximum(np.einsum("ij,ij->i", span, span), 1e-18)
    f = np.clip(-np.einsum("ij,ij->i", a, span) / length2, 0.0, 1.0)
    return np.asarray(np.linalg.norm(a + f[:, None] * span, axis=1))


@njit(cache=True)  # type: ignore[untyped-decorator]
def chord_clearances(a: Array, b: Array, solid: NDArray[np.bool_], lower: Array, voxel: float, reach: float) -> Array:
    """(n,) least distance of each chord a-b to the solid cubes, capped at reach; exact to half of CHORD_STEP_M."""
    out = np.empty(len(a))
    for m in range(len(a)):
        length = math.sqrt(((b[m] - a[m]) ** 2).sum())
        done, least = 0.0, reach
        while True:
            f = done / length if length > 0.0 else 0.0
            gap = _cube_distance(a[m] + f * (b[m] - a[m]), solid, lower, voxel, reach)
            least = min(least, gap)
            if done >= length:
                break
            done = min(length, done + max(CHORD_STEP_M, gap - least))
        out[m] = least - 0.5 * CHORD_STEP_M
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _cube_distance(p: Array, solid: NDArray[np.bool_], lower: Array, voxel: float, reach: float) -> float:
    best = reach * reach
    n = math.ceil(reach / voxel)
    i0 = math.floor((p[0] - lower[0]) / voxel)
    j0 = math.floor((p[1] - lower[1]) / voxel)
    k0 = math.floor((p[2] - lower[2]) / voxel)
    for i in range(max(0, i0 - n), min(solid.shape[0], i0 + n + 1)):
        x0 = lower[0] + i * voxel
        dx = max(x0 - p[0], p[0] - x0 - voxel, 0.0)
        if dx * dx >= best:
            continue
        for j in range(max(0, j0 - n), min(solid.shape[1], j0 + n + 1)):
            y0 = lower[1] + j * voxel
            dy = max(y0 - p[1], p[1] - y0 - voxel, 0.0)
            if dx * dx + dy * dy >= best:
                continue
            for k in range(max(0, k0 - n), min(solid.shape[2], k0 + n + 1)):
                if solid[i, j, k]:
                    z0 = lower[2] + k * voxel
                    dz = max(z0 - p[2], p[2] - z0 - voxel, 0.0)
                    best = min(best, dx * dx + dy * dy + dz * dz)
    return math.sqrt(best)
