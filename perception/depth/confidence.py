"""How likely a depth is right: a small perceptron over what was seen while it was estimated, and how it looks there.

`swarmscan bench depth --fit FILE` trains it (`learning.py`); weights/confidence.md says on what the one that ships was.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from missions.errors import UserError
from perception.depth.compiled import compiled
from perception.depth.depth_map import DepthMap, Image, Mask
from perception.depth.fusion import Consensus
from perception.depth.plane_sweep import Frame
from perception.depth.texture import deviation_dn
from perception.imagination.layers import logits

Evidence = NDArray[np.float32]

WEIGHTS = Path(__file__).parent / "weights" / "confidence.safetensors"
RIGHT = 0.05
"""The relative error below which a depth counts as right."""
FAR_M = 33.0
"""What lies farther is all the same: any depth beyond it counts as right there."""
FEATURES = ("nearness", "deviation", "agree", "against", "support", "own", "own, passed", "match", "texture",
            "contrast", "blue", "colour", "grey", "alike in 5", "alike in 9", "measured", "nearer", "farther", "sky",
            "thread", "sight", "in sight")
NAMES = ("mean", "scale", "first", "first_bias", "second", "second_bias", "last", "last_bias", "filled")
TRUSTED, TRUSTED_EDGE, TRUSTED_PER_M, TRUSTED_FAR = 0.2, -1.2, 0.08, 8.0
"""Least log odds of a pixel that is answered; the same where it stands before something else, for members are thin and
rare; what is added per metre of its depth, for the farther it is said to be, the more it costs if something stands
before it; and the least beyond FAR_M, for a thing before the sky that went unseen is the worst mistake of a map."""
EDGE = 0.1
"""A pixel stands before something else when its inverse depth falls by this share within three pixels."""
BEYOND = 2.2
"""Least log odds of an answer beyond FAR_M that is good enough to say that nothing is near: 0.9."""
SAME = 0.05
"""Share of depth within which the vote has left a picture's own estimate as it was."""
ALIKE = np.float32(0.06)
"""Share of inverse depth by which neighbouring pixels of one surface differ at most."""
LOG_COUNT = np.round(np.log1p(np.arange(256)), 4).astype(np.float32)
"""Rounded, so that it is the same on every machine."""


@dataclass(frozen=True)
class Confidence:
    """A trained perceptron; filled (2,) turns its log odds into those of a pixel whose depth was filled in."""

    layers: tuple[NDArray[np.float32], ...]
    """Mean and scale of the features, then weights (in, out) and biases (out,) of two hidden layers and the last."""
    filled: NDArray[np.float32]

    @classmethod
    def load(cls, path: Path = WEIGHTS) -> Confidence:
        """From a safetensors file. Raises UserError naming it."""
        try:
            tensors = load_file(path)
            *layers, fill = (tensors[name] for name in NAMES)
        except (SafetensorError, KeyError, OSError) as e:
            raise UserError(f"{path} holds no weights for the confidence of depth: {e}") from e
        if layers[0].shape != (len(FEATURES),):
            raise UserError(f"{path} holds weights for {layers[0].size} features, not {len(FEATURES)}; fit anew.")
        return cls(tuple(layers), fill)

    def save(self, path: Path) -> None:
        """Write the weights."""
        save_file(dict(zip(NAMES, (*self.layers, self.filled), strict=True)), path)

    def log_odds(self, evidence: Evidence) -> Image:
        """(h, w) of the relative error being below RIGHT, from features (22, h, w)."""
        result: Image = logits(evidence.reshape(len(evidence), -1), *self.layers).reshape(evidence.shape[1:])
        return result


@functools.cache
def shipped() -> Confidence:
    """The confidence that ships."""
    return Confidence.load()


def features(depth: DepthMap, vote: Consensus, frame: Frame) -> Evidence:
    """(22, h, w) in the order of FEATURES, of the depth that a vote has made of a picture's own estimate.

    Counts are ln(1 + count). own: the vote left the picture's own estimate as it was; match is what the plane sweep's
    costs say of that, measured the share of trusted estimates around. alike: share of the pixels around at a like
    depth; nearer and farther: the relative step to what is nearest and farthest in 7 x 7. texture, contrast, blue,
    colour and grey tell the sky and bare surfaces from members before them; thread is how far the grey stands out of
    the median around it, as that of a wire before clouds does. sight: how near a thing other pictures would have seen;
    in sight: how near the depth is beside that.
    """
    near, gray = 1.0 / vote.depth_m, frame.gray
    red, blue = frame.rgb[..., 0].astype(np.float32), frame.rgb[..., 2].astype(np.float32)
    colour = frame.rgb.max(axis=-1).astype(np.float32) - frame.rgb.min(axis=-1)
    own = np.abs(depth.depth_m * near - 1.0) < SAME
    around, wide = np.ones((7, 7), np.uint8), np.ones((9, 9), np.uint8)
    texture, contrast = deviation_dn(gray, 5), cv2.dilate(gray, around) - cv2.erode(gray, around)
    thread = np.minimum(np.abs(gray - cv2.medianBlur(gray, 5)) / 10.0, 3.0)
    rows = [8.0 / (8.0 + vote.depth_m), 10.0 * np.minimum(depth.sigma_per_depth2 * vote.depth_m, 0.3),
            LOG_COUNT[vote.agree], LOG_COUNT[vote.against], LOG_COUNT[vote.support], own, depth.valid & own,
            depth.confidence, texture / (4.0 + texture), contrast / (20.0 + contrast), (blue - red) / 50.0,
            colour / 50.0, gray / 100.0, *_alike(near), cv2.blur(depth.valid.astype(np.float32), (9, 9)),
            np.minimum(cv2.dilate(near, around) / near - 1.0, 2.0), 1.0 - cv2.erode(near, around) / near,
            cv2.dilate(depth.sky.astype(np.uint8), wide), thread, np.broadcast_to(depth.sight, near.shape),
            np.minimum(near / np.maximum(depth.sight, 0.01), 1.5)]
    return np.stack(rows).astype(np.float32)


def trusted(odds: Image, depth_m: Image, evidence: Evidence) -> Mask:
    """(h, w) pixels to be answered, from log odds and features (22, h, w)."""
    least = np.where(evidence[FEATURES.index("farther")] > EDGE, np.float32(TRUSTED_EDGE), np.float32(TRUSTED))
    least += np.float32(TRUSTED_PER_M) * depth_m
    result: Mask = odds >= np.where(depth_m > FAR_M, np.float32(TRUSTED_FAR), least)
    return result


def right(depth_m: NDArray[np.float32], true_m: NDArray[np.float32]) -> Mask:
    """Whether depths are right; beyond FAR_M all are alike."""
    goal = np.minimum(true_m, FAR_M)
    result: Mask = np.abs(np.minimum(depth_m, FAR_M) - goal) < RIGHT * goal
    return result


def probability(odds: Image) -> Image:
    """(h, w) chance, from its log odds."""
    result: Image = (1.0 / (1.0 + np.exp(-odds))).astype(np.float32)
    return result


@compiled
def _alike(near: Image) -> NDArray[np.float32]:
    """(2, h, w) share of 25 pixels at a like depth: all of 5 x 5, and every second of 9 x 9; the rim repeats."""
    h, w = near.shape
    result = np.empty((2, h, w), np.float32)
    for k in range(2):
        for y in range(h):
            for x in range(w):
                alike, limit = 0, ALIKE * near[y, x]
                for dy in range(-2, 3):
                    v = min(max(y + (k + 1) * dy, 0), h - 1)
                    for dx in range(-2, 3):
                        u = min(max(x + (k + 1) * dx, 0), w - 1)
                        alike += abs(near[v, u] - near[y, x]) < limit
                result[k, y, x] = np.float32(alike) * np.float32(0.04)
    return result
