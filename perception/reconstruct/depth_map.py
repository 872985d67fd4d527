"""The depth map of a picture: what its stereo pairs agree on, refined by all of them together."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from perception.reconstruct.refinement import refined
from perception.reconstruct.stereo import Eye, Map, PairDepth, pair_depths

AGREE_PX = 1.0
"""Two pairs agree when their depths differ by less than this much disparity of the weaker one."""


def depth_map(reference: Eye, partners: list[Eye], near_m: float, far_m: float) -> Map:
    """(height, width) float32 depth in metres along the optical axis; 0 where no pair was trusted or no partner looks
    alike, infinite in the sky.

    The sky counts as seen: it tells that nothing floats before it, and that what was matched into it is no surface.
    """
    pairs = pair_depths(reference, partners, near_m, far_m)
    depth = refined(reference, partners, merge_pairs(pairs, reference.grey.shape))
    depth[reference.sky] = np.inf
    return depth


def merge_pairs(pairs: list[PairDepth], shape: tuple[int, ...]) -> Map:
    """Per pixel, the largest group of agreeing pairs, averaged in inverse depth, weighted by each pair's precision.

    Where pairs contradict each other and none has company, nothing is kept; where only one pair matched, it is kept.
    """
    if not pairs:
        return np.zeros(shape, dtype=np.float32)
    inverse = np.stack([p.inverse_depth for p in pairs])
    per_px = np.array([p.inverse_depth_per_px for p in pairs], dtype=np.float32)
    merged = np.zeros(shape, dtype=np.float32)
    _merge(inverse, per_px, np.float32(AGREE_PX), merged)
    return merged


def _merge_pixels(inverse: NDArray[np.float32], per_px: NDArray[np.float32], agree_px: np.float32,
                  depth: NDArray[np.float32]) -> None:
    pairs, height, width = inverse.shape
    for v in range(height):
        for u in range(width):
            seen, best_count, best_weight, best_sum = 0, 0, 0.0, 0.0
            for i in range(pairs):
                own = inverse[i, v, u]
                if not own > 0.0:
                    continue
                seen += 1
                count, weight, total = 0, 0.0, 0.0
                for j in range(pairs):
                    other = inverse[j, v, u]
                    if abs(other - own) < agree_px * max(per_px[i], per_px[j]):
                        w = 1.0 / (per_px[j] * per_px[j])
                        count, weight, total = count + 1, weight + w, total + w * other
                if count > best_count or (count == best_count and weight > best_weight):
                    best_count, best_weight, best_sum = count, weight, total
            if best_count > 1 or (best_count == 1 and seen == 1):
                depth[v, u] = best_weight / best_sum


_merge = numba.njit(nogil=True, cache=True)(_merge_pixels)
