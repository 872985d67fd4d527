"""Cloud to mesh (C2M): how far reconstructed points lie from the true surface (thesis 4.7.2, Eqs. 4.10-4.12)."""

from __future__ import annotations

import msgspec
import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from missions.frames import Array
from missions.triangles import without_slivers
from perception.evaluate.ray_scene import ray_scene

BIN_M = 0.001
INLIER_M = 0.02
TRIM_M = 0.05
"""The thesis sets the threshold of the exported histogram between 0 and 5 cm."""
AT_ONCE = 500_000


class Accuracy(msgspec.Struct, frozen=True):
    """Error of a set of points. Shares are 0-1, lengths metres; all None for no points."""

    mean_m: float | None
    rms_m: float | None
    within_2cm: float | None
    points: int


def distances_to_mesh(points_enu_m: NDArray[np.float32], vertices_enu_m: Array,
                      triangles: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """(n,) metres to the nearest triangle, positive on the side its normal points to, and (n,) which one that is.

    The sign is that of the nearest triangle's side, as in CloudCompare, so the mesh need not be closed.
    """
    pieces, piece_of = without_slivers(np.asarray(vertices_enu_m, np.float64)[triangles])
    scene = ray_scene(pieces.reshape(-1, 3), np.arange(3 * len(pieces), dtype=np.int64).reshape(-1, 3))
    distance, triangle = np.zeros(len(points_enu_m)), np.zeros(len(points_enu_m), dtype=np.int64)
    for start in range(0, len(points_enu_m), AT_ONCE):
        block = np.ascontiguousarray(points_enu_m[start:start + AT_ONCE], dtype=np.float32)
        nearest = scene.compute_closest_points(o3d.core.Tensor.from_numpy(block))
        offset = block - nearest["points"].numpy()
        side = np.sum(offset * nearest["primitive_normals"].numpy(), axis=1)
        distance[start:start + len(block)] = np.where(side < 0.0, -1.0, 1.0) * np.linalg.norm(offset, axis=1)
        triangle[start:start + len(block)] = piece_of[nearest["primitive_ids"].numpy()]
    return distance, triangle


def histogram(distances_m: Array, bin_m: float = BIN_M) -> tuple[NDArray[np.int64], Array]:
    """(counts (n,), bin centres (n,) m): bins whose edges are whole multiples of bin_m and that hold every distance."""
    index = np.floor(distances_m / bin_m).astype(np.int64)
    first = int(index.min(initial=0))
    counts = np.bincount(index - first) if len(index) else np.zeros(1, dtype=np.int64)
    centres = (np.arange(len(counts), dtype=np.float64) + first + 0.5) * bin_m
    return counts.astype(np.int64), centres


def binned(counts: NDArray[np.int64], centres_m: Array, inlier_m: float = INLIER_M) -> Accuracy:
    """Eqs. 4.10 (share within +-inlier_m), 4.11 (mean of |bin centre|) and 4.12 (RMS of bin centres)."""
    total = int(counts.sum())
    if not total:
        return Accuracy(None, None, None, 0)
    return Accuracy(float(np.sum(counts * np.abs(centres_m)) / total),
                    float(np.sqrt(np.sum(counts * centres_m**2) / total)),
                    float(np.sum(counts[np.abs(centres_m) <= inlier_m]) / total), total)


def exact(distances_m: Array, inlier_m: float = INLIER_M) -> Accuracy:
    """The same three figures from the distances themselves, without bins."""
    if not len(distances_m):
        return Accuracy(None, None, None, 0)
    size = np.abs(distances_m)
    return Accuracy(float(size.mean()), float(np.sqrt(np.mean(size**2))), float(np.mean(size <= inlier_m)), len(size))


def trimmed(distances_m: Array, limit_m: float = TRIM_M) -> Array:
    """The distances of at most limit_m: what the thesis's histogram shows, blind to gross errors."""
    return np.asarray(distances_m[np.abs(distances_m) <= limit_m])
