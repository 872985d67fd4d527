"""`swarmscan bench depth --fit FILE`: trains the confidence of depth on the given scenes and writes its weights.

Give families of split "train" alone; what is trained is checked on others by the benchmark's calibration error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from ground_station.bench.depth_scores import Floats, Mask, full_size
from ground_station.bench.depth_walking import online_updates
from missions.walks import Walks, truth_path, walks_path
from perception.depth.confidence import Confidence, right, shipped, trusted
from perception.depth.depth_map import DepthMap
from perception.depth.learning import learnt, line
from perception.depth.plane_sweep import SweepSettings

SWEEPS = (SweepSettings(), SweepSettings(shrink=3, planes=80))
"""As the mission sweeps, and coarser, as trials of methods that choose views do."""
PIXELS_PER_PICTURE = 2500
FILLED_EVERY = 4
"""One in so many scenes shows how good depths are that were filled in."""

Sampled = tuple[DepthMap, Floats, Floats, Floats, NDArray[np.int64]]


def fit(folder: Path, scenes: Sequence[str], file: Path) -> dict[str, float]:
    """Train on walks that the folder holds; what to report. The weights go to a file."""
    rng = np.random.default_rng(0)
    samples = [(evidence[:, at].T.copy(), right(voted[at], true))
               for _, voted, evidence, true, at in _samples(folder, scenes, shipped(), rng)]
    evidence, truth = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    confidence, loss = learnt(evidence, truth)
    confidence = replace(confidence, filled=line(*_left(folder, scenes[::FILLED_EVERY], confidence, rng)))
    confidence.save(file)
    return {"samples": len(truth), "right": round(float(truth.mean()), 4), "log_loss": round(loss, 4)}


def _left(folder: Path, scenes: Sequence[str], confidence: Confidence,
          rng: np.random.Generator) -> tuple[Floats, Mask]:
    """Log odds of pixels that are not trusted, and whether what was filled in there is right."""
    parts = []
    for final, voted, evidence, true, at in _samples(folder, scenes, confidence, rng):
        some = np.ascontiguousarray(evidence[:, at])
        odds = confidence.log_odds(some[:, None])[0]
        left = ~trusted(odds, voted[at], some)
        parts.append((odds[left], right(final.depth_m.reshape(-1)[at], true)[left]))
    odds, truth = (np.concatenate(part) for part in zip(*parts, strict=True))
    return odds, truth


def _samples(folder: Path, scenes: Sequence[str], confidence: Confidence,
             rng: np.random.Generator) -> Iterator[Sampled]:
    """Per picture as it was when it was last estimated: final map, the vote's depth (n,) and features (k, n) of its
    pixels; of some pixels of the picture the true depth (m,), and where they lie in the map (m,)."""
    for scene in scenes:
        walks = msgspec.msgpack.decode(walks_path(folder, scene).read_bytes(), type=Walks)
        with np.load(truth_path(folder, scene)) as truth:
            true = truth["depth_m"]
        for sweep in SWEEPS:
            latest: dict[int, tuple[DepthMap, Floats, NDArray[np.float16]]] = {}
            for first, online, updated in online_updates(walks, sweep, confidence):
                for i in updated:
                    voted, evidence = online.evidence(i)
                    final = online.depth(i)
                    assert final is not None
                    latest[first + i] = final, voted.reshape(-1), evidence.reshape(len(evidence), -1).astype(np.float16)
            for number, (final, voted, rows) in latest.items():
                pixels = rng.permutation(true[number].size)[:PIXELS_PER_PICTURE]
                entry = np.arange(voted.size).reshape(final.depth_m.shape)
                at = full_size(entry, true[number].shape).reshape(-1)[pixels]
                yield final, voted, rows.astype(np.float32), true[number].reshape(-1)[pixels], at
