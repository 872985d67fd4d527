"""How likely a depth is right: logistic models of what was seen while it was estimated.

`swarmscan bench depth --fit` fits the weights on given scenes; these are of the families of split "train", seed 1.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.depth.depth_map import DepthMap, Image, Mask
from perception.depth.fusion import Consensus

RIGHT = 0.05
"""The relative error below which a depth counts as right."""
FAR_M = 33.0
"""What lies farther is all the same: any depth beyond it counts as right there. Such answers have a model of their own,
for most of them are sky, and a thing before the sky that went unseen is the worst mistake that a map can make."""
FEATURES = ("constant", "agree", "against", "support", "own, passed", "own, not passed", "match", "edge", "sigma",
            "alone", "nearness", "thread")
WEIGHTS_NEAR = np.array([1.253, 1.953, -1.883, -1.277, 0.609, 0.105, 0.141, -2.747, 1.881, -1.174, 0.245, 0.18],
                        np.float32)
WEIGHTS_FAR = np.array([4.446, 1.587, 1.025, -1.541, -0.007, 1.149, 2.841, -3.053, 0.429, -2.137, 12.471, -0.749],
                       np.float32)
TRUSTED_NEAR, TRUSTED_FAR = 0.4, 5.5
"""Least log odds of a pixel that is answered: 0.6 within FAR_M, 0.996 beyond."""
BEYOND = 2.2
"""Least log odds of an answer beyond FAR_M that is good enough to say that nothing is near: 0.9."""
FILLED = (0.571, 0.246)
"""Log odds of a pixel whose depth was filled in: the first, and the second times what they were before."""
LOG_COUNT = np.round(np.log1p(np.arange(256)), 4).astype(np.float32)
"""Rounded, so that it is the same on every machine."""
SAME = 0.05
"""Share of depth within which the vote has left a picture's own estimate as it was."""


def features(depth: DepthMap, vote: Consensus, gray: Image) -> NDArray[np.float32]:
    """(12, h, w) in the order of FEATURES, of the depth that a vote has made of a picture's own estimate.

    agree, against and support are ln(1 + count); match is what the plane sweep's costs say of its own estimate; edge
    grows to 1 with the relative spread of inverse depth in 3 x 3 pixels; sigma is ten times the relative deviation;
    thread is how far the grey stands out of the median around it, as that of a wire before clouds does.
    """
    near = 1.0 / vote.depth_m
    own = np.abs(depth.depth_m * near - 1.0) < SAME
    window = np.ones((3, 3), np.uint8)
    spread = 10.0 * (cv2.dilate(near, window) - cv2.erode(near, window)) / near
    thread = np.minimum(np.abs(gray - cv2.medianBlur(gray, 5)) / 10.0, 3.0)
    rows = [np.ones_like(near), LOG_COUNT[vote.agree], LOG_COUNT[vote.against], LOG_COUNT[vote.support],
            depth.valid & own, ~depth.valid & own, depth.confidence * own, spread / (1.0 + spread),
            10.0 * np.minimum(depth.sigma_per_depth2 * vote.depth_m, 0.3), vote.agree == 0, np.minimum(near, 0.6),
            thread]
    return np.stack(rows).astype(np.float32)


def log_odds(evidence: NDArray[np.float32], depth_m: Image) -> Image:
    """(h, w) of the relative error being below RIGHT, from features (12, h, w); summed in order, alike everywhere."""
    near, far = np.zeros_like(depth_m), np.zeros_like(depth_m)
    for near_weight, far_weight, row in zip(WEIGHTS_NEAR, WEIGHTS_FAR, evidence, strict=True):
        near += near_weight * row
        far += far_weight * row
    result: Image = np.where(depth_m > FAR_M, far, near)
    return result


def trusted(odds: Image, depth_m: Image) -> Mask:
    """(h, w) pixels to be answered, from log odds."""
    result: Mask = odds >= np.where(depth_m > FAR_M, np.float32(TRUSTED_FAR), np.float32(TRUSTED_NEAR))
    return result


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
