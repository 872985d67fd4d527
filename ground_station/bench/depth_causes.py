"""What goes wrong with depth, and where: a verdict on every pixel of a picture, and errors summed by their cause."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ground_station.bench.depth_scores import DELTA, RIGHT, Floats, Mask, counted, full_size, thin
from missions.frames import Array
from perception.depth.confidence import FAR_M
from perception.depth.depth_map import DepthMap

Marks = NDArray[np.uint8]

ELSEWHERE, RIGHT_, NEARLY, SILENT, BEHIND, OPEN, BEFORE, GHOST = range(8)
VERDICTS = (
    ("out of range, nothing claimed", (225, 228, 232)), ("right: within 5 %", (46, 125, 50)),
    ("within a factor of 1.25", (165, 205, 110)), ("in range, no answer", (120, 126, 134)),
    ("too far: measured what is behind it", (214, 48, 39)), ("taken for open space beyond 33 m", (200, 30, 200)),
    ("too near: measured what is before or beside it", (49, 90, 220)),
    ("ghost: surface in range claimed before something far or the sky", (250, 190, 20)))
"""What each number means and its colour."""
PLACES = ("on water", "on a thin member", "within 3 pixels of an edge in depth", "on bare surface", "elsewhere")
EDGE_PX, EDGE = 7, 0.15
"""An edge: inverse depth changes by this share within a window of so many pixels."""
BARE_DN = 2.0
"""Standard deviation of grey in 9 x 9 pixels below which there is little to match."""


@dataclass(frozen=True)
class Causes:
    """Answered pixels in range, and the sum of their relative errors, by verdict and place: both (8, 5)."""

    pixels: NDArray[np.int64]
    error: Array

    def __add__(self, other: Causes) -> Causes:
        return Causes(self.pixels + other.pixels, self.error + other.error)


def verdicts(ours: DepthMap, depth_m: Floats, rays_m: Array, range_m: float) -> Marks:
    """(h, w) what became of every pixel of a picture."""
    depth = full_size(ours.depth_m, depth_m.shape)
    valid, none = (full_size(mask, depth_m.shape) for mask in (ours.valid, ours.sky | ours.beyond))
    count = counted(depth_m, rays_m, range_m)
    error = np.abs(depth - np.where(count, depth_m, depth)) / depth_m
    claimed = valid & (depth * rays_m <= range_m) & (depth_m >= DELTA * depth)
    conditions = [~count & claimed, ~count, none | (valid & (depth > FAR_M)), ~valid, error < RIGHT,
                  depth >= DELTA * depth_m, depth_m >= DELTA * depth]
    return np.select(conditions, [GHOST, ELSEWHERE, OPEN, SILENT, RIGHT_, BEHIND, BEFORE], NEARLY).astype(np.uint8)


def places(rgb: NDArray[np.uint8], depth_m: Floats, on_water: Mask) -> Marks:
    """(h, w) what kind of place every pixel shows."""
    near, gray = 1.0 / depth_m, cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32)
    window = np.ones((EDGE_PX, EDGE_PX), np.uint8)
    edge = cv2.dilate(near, window) - cv2.erode(near, window) > EDGE * near
    mean = cv2.blur(gray, (9, 9))
    bare = cv2.blur(gray * gray, (9, 9)) - mean * mean < BARE_DN**2
    return np.select([on_water, thin(depth_m), edge, bare], [0, 1, 2, 3], 4).astype(np.uint8)


def causes(verdict: Marks, place: Marks, ours: DepthMap, depth_m: Floats) -> Causes:
    """One picture's answered pixels in range."""
    depth, valid = full_size(ours.depth_m, depth_m.shape), full_size(ours.valid, depth_m.shape)
    use = valid & np.isin(verdict, (RIGHT_, NEARLY, BEHIND, OPEN, BEFORE))
    flat = verdict[use].astype(np.int64) * len(PLACES) + place[use]
    error = np.abs(depth[use] - depth_m[use]) / depth_m[use]
    size, shape = len(VERDICTS) * len(PLACES), (len(VERDICTS), len(PLACES))
    total = np.asarray(np.bincount(flat, error, size), np.float64)
    return Causes(np.bincount(flat, minlength=size).reshape(shape), total.reshape(shape))
