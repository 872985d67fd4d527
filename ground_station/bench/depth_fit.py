"""`swarmscan bench depth --fit`: fits the confidence of depth on the given scenes, for perception/depth/confidence.py.

Give families of split "train" alone; what is fitted is checked on others by the benchmark's calibration error.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from ground_station.bench.depth_scores import Floats, full_size
from ground_station.bench.depth_walking import online_depths
from missions.walks import Walks, truth_path, walks_path
from perception.depth.confidence import FAR_M, FEATURES, RIGHT, TRUSTED, fitted

PIXELS_PER_PICTURE = 3000


def fit(folder: Path, scenes: Sequence[str]) -> dict[str, list[float]]:
    """Weights by feature order, and the two numbers for pixels that are filled in."""
    rng = np.random.default_rng(0)
    samples = [part for scene in scenes for part in _samples(folder, scene, rng)]
    evidence, right, right_filled = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    weights = fitted(evidence, right)
    odds = evidence @ weights
    low = odds < TRUSTED
    line = np.stack([np.ones(int(low.sum())), odds[low]], axis=1).astype(np.float32)
    after = fitted(line, right_filled[low])
    return {"weights": [round(float(w), 3) for w in weights], "filled": [round(float(w), 3) for w in after]}


def _samples(folder: Path, scene: str,
             rng: np.random.Generator) -> list[tuple[Floats, NDArray[np.bool_], NDArray[np.bool_]]]:
    """Per picture: evidence (n, features) of some pixels, whether the vote is right, and the final guess."""
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
            samples.append((rows.reshape(len(FEATURES), -1)[:, at].T.copy(), right, right_filled))
        first += len(online)
    return samples
