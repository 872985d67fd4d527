"""How likely a depth is right: a logistic model of what was seen while it was estimated.

`swarmscan bench depth --fit` fits WEIGHTS on given scenes; these are of the families of split "train", seed 1.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.depth.depth_map import DepthMap, Image
from perception.depth.fusion import Consensus

RIGHT = 0.05
"""The relative error below which a depth counts as right."""
FEATURES = ("constant", "agree", "against", "support", "own, passed", "own, not passed", "match", "edge", "sigma",
            "alone", "nearness", "far", "thread", "far thread")
WEIGHTS = np.array([1.246, 2.083, -1.368, -1.465, 0.607, 0.356, 0.45, -2.82, 1.154, -1.245, -0.514, 4.601, 0.211,
                    -1.966], np.float32)
TRUSTED = 0.4
"""Least log odds of a pixel that is answered: a confidence of 0.6."""
FILLED = (-0.178, 0.144)
"""Log odds of a pixel whose depth was filled in: the first, and the second times what they were before."""
LOG_COUNT = np.round(np.log1p(np.arange(256)), 4).astype(np.float32)
"""Rounded, so that it is the same on every machine."""
FAR_M = 33.0
"""What lies farther is all the same: any depth beyond it counts as right there."""
SAME = 0.05
"""Share of depth within which the vote has left a picture's own estimate as it was."""


def features(depth: DepthMap, vote: Consensus, gray: Image) -> NDArray[np.float32]:
    """(14, h, w) in the order of FEATURES, of the depth that a vote has made of a picture's own estimate.

    agree, against and support are ln(1 + count); match is what the plane sweep's costs say of its own estimate; edge
    grows to 1 with the relative spread of inverse depth in 3 x 3 pixels; sigma is ten times the relative deviation;
    thread is how far the grey stands out of the median around it, as that of a wire before clouds does.
    """
    near = 1.0 / vote.depth_m
    own = np.abs(depth.depth_m * near - 1.0) < SAME
    window = np.ones((3, 3), np.uint8)
    spread = 10.0 * (cv2.dilate(near, window) - cv2.erode(near, window)) / near
    thread = np.minimum(np.abs(gray - cv2.medianBlur(gray, 5)) / 10.0, 3.0)
    far = vote.depth_m > FAR_M
    rows = [np.ones_like(near), LOG_COUNT[vote.agree], LOG_COUNT[vote.against], LOG_COUNT[vote.support],
            depth.valid & own, ~depth.valid & own, depth.confidence * own, spread / (1.0 + spread),
            10.0 * np.minimum(depth.sigma_per_depth2 * vote.depth_m, 0.3), vote.agree == 0, np.minimum(near, 0.6),
            far, thread, thread * far]
    return np.stack(rows).astype(np.float32)


def log_odds(evidence: NDArray[np.float32]) -> Image:
    """(h, w) of the relative error being below RIGHT, from features (14, h, w); summed in order, alike everywhere."""
    total: Image = np.zeros(evidence.shape[1:], np.float32)
    for weight, row in zip(WEIGHTS, evidence, strict=True):
        total += weight * row
    return total


def probability(odds: Image) -> Image:
    """(h, w) chance, from its log odds."""
    result: Image = (1.0 / (1.0 + np.exp(-odds))).astype(np.float32)
    return result


def fitted(evidence: NDArray[np.float32], right: NDArray[np.bool_], steps: int = 15) -> NDArray[np.float64]:
    """(k,) weights of the logistic regression of right (n,) on evidence (n, k), by Newton's method with a light ridge.

    The first feature is the constant.
    """
    scale = np.maximum(evidence.std(axis=0, dtype=np.float64), 1e-6)
    scale[0] = 1.0
    x, ridge = evidence / scale, 1e-3 * np.eye(evidence.shape[1])
    weights = np.zeros(evidence.shape[1])
    for _ in range(steps):
        p = 1.0 / (1.0 + np.exp(-(x @ weights)))
        slope = x.T @ (right - p) - ridge @ weights
        weights += np.linalg.solve((x * (p * (1.0 - p))[:, None]).T @ x + ridge, slope)
    result: NDArray[np.float64] = weights / scale
    return result
