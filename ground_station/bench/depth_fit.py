"""`swarmscan bench depth --fit`: fits the confidence of depth on the given scenes, for perception/depth/confidence.py.

Give families of split "train" alone; what is fitted is checked on others by the benchmark's calibration error.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from ground_station.bench.depth_scores import Floats, Mask, full_size
from ground_station.bench.depth_walking import online_depths
from missions.walks import Walks, truth_path, walks_path
from perception.depth.confidence import FAR_M, FEATURES, RIGHT, fitted, trusted

PIXELS_PER_PICTURE = 3000


def fit(folder: Path, scenes: Sequence[str]) -> dict[str, list[float]]:
    """Weights within and beyond FAR_M in the order of the features, and the two numbers for filled pixels."""
    rng = np.random.default_rng(0)
    samples = [part for scene in scenes for part in _samples(folder, scene, rng)]
    evidence, depth_m, right, right_filled = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    far = depth_m > FAR_M
    weights_near, weights_far = fitted(evidence[~far], right[~far]), fitted(evidence[far], right[far])
    odds = np.where(far, evidence @ weights_far, evidence @ weights_near)
    left = ~trusted(odds, depth_m)
    line = np.stack([np.ones(int(left.sum())), odds[left]], axis=1).astype(np.float32)
    found = {"near": weights_near, "far": weights_far, "filled": fitted(line, right_filled[left])}
    return {name: [round(float(w), 3) for w in weights] for name, weights in found.items()}


def _samples(folder: Path, scene: str,
             rng: np.random.Generator) -> list[tuple[Floats, Floats, Mask, Mask]]:
    """Per picture, of some pixels: evidence (n, features), the vote's depth, whether it is right, and the guess."""
    walks = msgspec.msgpack.decode(walks_path(folder, scene).read_bytes(), type=Walks)
    with np.load(truth_path(folder, scene)) as truth:
        true = truth["depth_m"]
    samples, first = [], 0
    for online in online_depths(walks):
        for i in range(len(online)):
            final, depth_m = online.depth(i), true[first + i]
            if final is None:
                continue
            pixels = rng.permutation(depth_m.size)[:PIXELS_PER_PICTURE]
            voted, rows = online.evidence(i)
            at = full_size(np.arange(voted.size).reshape(voted.shape), depth_m.shape).reshape(-1)[pixels]
            goal = np.minimum(depth_m.reshape(-1)[pixels], FAR_M)
            right, right_filled = (np.abs(np.minimum(d.reshape(-1)[at], FAR_M) - goal) < RIGHT * goal
                                   for d in (voted, final.depth_m))
            evidence = rows.reshape(len(FEATURES), -1)[:, at].T.copy()
            samples.append((evidence, voted.reshape(-1)[at], right, right_filled))
        first += len(online)
    return samples
