"""How good depth is, over which pixels, and whether its confidence tells.

Every pixel of a picture counts whose true surface lies within the sensing range, along its ray. `answered` are those
of them that the method trusts itself; numbers with `_all` judge its best guess on every counted pixel, so that nobody
gains by answering little. Errors are |ours - true| / true.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from perception.depth.depth_map import DepthMap

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]
T = TypeVar("T", bound=np.generic)

DELTA = 1.25
THIN_PX = 5
"""What a square of so many pixels does not fit into, and what stands NEARER times before its surroundings, is thin."""
NEARER = 1.1
COMPLETE = 0.1
"""The relative error up to which an answered pixel counts as surface found."""
RIGHT = 0.05
"""The relative error below which an answer counts as right for the calibration of the confidence."""
SHARES = np.arange(0.0, 1.0, 0.02)
"""Shares of pixels left out in a sparsification curve (Ilg et al., ECCV 2018)."""
BINS = 10


@dataclass(frozen=True)
class Pixels:
    """The counted pixels of some pictures, one entry each."""

    error: Floats
    ratio: Floats
    """max(ours / true, true / ours)."""
    answered: Mask
    confidence: Floats
    on_object: Mask
    on_water: Mask
    thin: Mask
    said_nothing: Mask

    @classmethod
    def joined(cls, parts: list[Pixels]) -> Pixels:
        """All of them, in order."""
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in cls.__dataclass_fields__))


@dataclass(frozen=True)
class Row:
    """One scene, or several."""

    scene: str
    pictures: int
    counted: int
    """Pixels with a true surface in the sensing range."""
    answered: float
    abs_rel: float
    delta_1_25: float
    abs_rel_all: float
    delta_1_25_all: float
    median_all: float
    abs_rel_object: float
    answered_object: float
    abs_rel_thin: float
    answered_thin: float
    thin: float
    """Share of the counted pixels that lie on something thin."""
    complete: float
    """Share of the counted pixels that are answered to COMPLETE ..."""
    complete_thin: float
    """... and of those on something thin."""
    water: float
    """Share of the counted pixels that lie on water."""
    answered_water: float
    abs_rel_water: float
    false_water: float
    """Share of all water pixels, at any distance, that are claimed to be surface in range and are not within COMPLETE:
    what would stand in the map at a wrong place."""
    called_open: float
    """Share of the counted pixels taken for sky or for something far away: the map may carve through them."""
    ghosts: float
    """Share of the pixels answered with a depth in the range where the truth is sky, or 1.25 times as far or more."""
    ause: float
    """Area between the sparsification curve of the confidence and the oracle's, both of abs_rel over all pixels."""
    ause_random: float
    """The same for a confidence that says nothing."""
    oracle: float
    """Area under the oracle's curve."""
    ause_answered: float
    oracle_answered: float
    calibration: float
    """Expected calibration error of the confidence as the probability of an error below 5 %."""
    cpu_seconds: float
    """Processor seconds per picture, sources and checks included."""


def full_size(image: NDArray[T], shape: tuple[int, ...]) -> NDArray[T]:
    """The nearest entry of a depth map for every pixel of the picture it belongs to."""
    rows = np.arange(shape[0]) * image.shape[0] // shape[0]
    columns = np.arange(shape[1]) * image.shape[1] // shape[1]
    result: NDArray[T] = image[rows[:, None], columns]
    return result


def counted(depth_m: Floats, rays_m: Array, range_m: float) -> Mask:
    """(h, w) pixels whose surface lies within the range; rays_m: (h, w) ray lengths per metre of depth."""
    result: Mask = np.isfinite(depth_m) & (depth_m * rays_m <= range_m)
    return result


def thin(depth_m: Floats) -> Mask:
    """(h, w) pixels on something narrower than THIN_PX, by what an opening of the inverse depth takes away."""
    near = 1.0 / depth_m
    opened = cv2.morphologyEx(near, cv2.MORPH_OPEN, np.ones((THIN_PX, THIN_PX), np.uint8))
    result: Mask = near > NEARER * opened
    return result


def judged(ours: DepthMap | None, depth_m: Floats, on_object: Mask, on_water: Mask, count: Mask) -> Pixels:
    """One picture's counted pixels. Without a depth map every pixel is unanswered and as wrong as a depth of zero."""
    true, n = depth_m[count], int(count.sum())
    parts = on_object[count], on_water[count], thin(depth_m)[count]
    if ours is None:
        nothing = np.zeros(n, np.bool_)
        return Pixels(np.ones(n, np.float32), np.full(n, np.inf, np.float32), nothing, np.zeros(n, np.float32), *parts,
                      nothing)
    depth, confidence = (full_size(image, depth_m.shape)[count] for image in (ours.depth_m, ours.confidence))
    valid, none = (full_size(mask, depth_m.shape)[count] for mask in (ours.valid, ours.sky | ours.beyond))
    ratio = np.maximum(depth / true, true / depth)
    return Pixels(np.abs(depth - true) / true, ratio, valid, confidence, *parts, none)


def ghosts(ours: DepthMap, depth_m: Floats, on_water: Mask, rays_m: Array, range_m: float) -> NDArray[np.int64]:
    """(4,) pixels of a picture answered in the range with nothing there, and all that are answered in the range;
    pixels of water claimed to be surface in the range elsewhere, and all of water."""
    depth, valid = full_size(ours.depth_m, depth_m.shape), full_size(ours.valid, depth_m.shape)
    claimed = valid & (depth * rays_m <= range_m)
    elsewhere = claimed & on_water & (np.abs(depth - depth_m) > COMPLETE * depth_m)
    return np.array([(claimed & (depth_m >= DELTA * depth)).sum(), claimed.sum(), elsewhere.sum(), on_water.sum()],
                    np.int64)


def summary(scene: str, pictures: int, p: Pixels, ghost: NDArray[np.int64], cpu_seconds: float) -> Row:
    """The row of a scene; ghost: (4,) sums of `ghosts`."""
    a, own, fine, wet = p.answered, p.on_object, p.thin, p.on_water
    found = a & (p.error < COMPLETE)
    curve, best = sparsification(p.error, -p.confidence), sparsification(p.error, p.error)
    curve_answered = sparsification(p.error[a], -p.confidence[a])
    best_answered = sparsification(p.error[a], p.error[a])
    return Row(scene, pictures, len(a), _mean(a), _mean(p.error[a]), _mean(p.ratio[a] < DELTA), _mean(p.error),
               _mean(p.ratio < DELTA), float(np.median(p.error)) if len(a) else 0.0, _mean(p.error[a & own]),
               _mean(a[own]), _mean(p.error[a & fine]), _mean(a[fine]), _mean(fine), _mean(found), _mean(found[fine]),
               _mean(wet), _mean(a[wet]), _mean(p.error[a & wet]), float(ghost[2] / max(int(ghost[3]), 1)),
               _mean(p.said_nothing),
               float(ghost[0] / max(int(ghost[1]), 1)),
               float((curve - best).mean()), float((_mean(p.error) - best).mean()), float(best.mean()),
               float((curve_answered - best_answered).mean()), float(best_answered.mean()),
               calibration_error(p), cpu_seconds)


def sparsification(error: Floats, order: Floats) -> Array:
    """Mean error of what is left when the SHARES of pixels with the largest `order` are left out."""
    if not len(error):
        return np.zeros(len(SHARES))
    ranked = np.cumsum(error[np.argsort(order, kind="stable")], dtype=np.float64)
    kept = np.maximum(1, np.ceil((1.0 - SHARES) * len(error)).astype(np.int64))
    return np.asarray(ranked[kept - 1] / kept)


def reliability(p: Pixels) -> tuple[Array, Array, Array]:
    """Per bin of confidence: mean confidence, share that is right, share of the pixels."""
    which = np.minimum((p.confidence * BINS).astype(np.int64), BINS - 1)
    size = np.bincount(which, minlength=BINS)
    said = np.bincount(which, p.confidence, BINS) / np.maximum(size, 1)
    right = np.bincount(which, p.error < RIGHT, BINS) / np.maximum(size, 1)
    return said, right, size / max(len(which), 1)


def calibration_error(p: Pixels) -> float:
    """Expected calibration error (Guo et al., ICML 2017)."""
    said, right, share = reliability(p)
    return float((np.abs(said - right) * share).sum())


def _mean(values: NDArray[Any]) -> float:
    return float(np.mean(values, dtype=np.float64)) if len(values) else 0.0
