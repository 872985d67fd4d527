"""Wires, which depth does not resolve: thin lines in the pictures, and how far the pictures agree that one is there.

A cable of 3 cm is half a pixel wide 20 m away and has no depth, but stretches through the picture as a faint line. One
picture's line may be a blade of grass, a kerb or a shadow. A wire is where the lines of all pictures meet: every
picture votes on every point that is asked about, for a wire where a line passes its place in the picture, against one
elsewhere.
"""

from __future__ import annotations

from functools import reduce

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.frames import Array
from perception.depth.compiled import compiled
from perception.depth.depth_map import Image

ANGLES = 16
HALF_LENGTH = 8
"""Lines are summed over this many pixels of a picture at half its size to each side."""
AROUND = 21
"""Edge of the window that contrast is compared with, in such pixels."""
NOISE_DN = 2.0
STRONGEST, STRONGEST_LINE = 3.0, 7.0
"""What a pixel, and a line, counts at most, in standard deviations."""
SEEN = 0.3
"""A line is looked for through pixels that stand out by this much."""
UNLIKELY = 3.3
"""A line of this strength speaks neither for a wire nor against it."""
UNIT = 32
"""Votes are whole numbers: this many to a standard deviation."""
NEAR_M = 9.0
"""Nearer points are farther apart in the picture, so their places are searched more widely."""

Strengths = NDArray[np.uint8]
Counts = NDArray[np.int32]


def line_strength(rgb: NDArray[np.uint8]) -> Strengths:
    """(h / 2, w / 2) how much the best straight line of 2 HALF_LENGTH + 1 pixels through each pixel stands out, in
    1 / UNIT standard deviations, from a picture (h, w, 3)."""
    h, w = rgb.shape[0] // 2, rgb.shape[1] // 2
    bright, dark = (cv2.morphologyEx(rgb, hat, np.ones((3, 3), np.uint8))
                    for hat in (cv2.MORPH_TOPHAT, cv2.MORPH_BLACKHAT))
    thin = np.maximum(bright, dark)
    strongest = reduce(np.maximum, cv2.split(thin))[: 2 * h, : 2 * w]
    contrast = reduce(np.maximum, [strongest[i::2, j::2] for i in (0, 1) for j in (0, 1)]).astype(np.float32)
    mean = cv2.blur(contrast, (AROUND, AROUND))
    spread = np.sqrt(np.maximum(cv2.blur(contrast * contrast, (AROUND, AROUND)) - mean * mean, 0.0)) + NOISE_DN
    angle, along = np.pi * np.arange(ANGLES) / ANGLES, np.arange(-HALF_LENGTH, HALF_LENGTH + 1)
    dx, dy = (np.round(np.outer(f(angle), along)).astype(np.int64) for f in (np.cos, np.sin))
    strength = np.zeros((h, w), np.float32)
    _best_lines(np.minimum((contrast - mean) / spread, STRONGEST).astype(np.float32), dx, dy, strength)
    return np.asarray(UNIT * np.clip(strength, 0.0, STRONGEST_LINE), dtype=np.uint8)


@compiled
def _best_lines(contrast: Image, dx: NDArray[np.int64], dy: NDArray[np.int64], strength: Image) -> None:
    """Sum of the contrast along the best line through each pixel, over the root of its length."""
    h, w = contrast.shape
    angles, length = dx.shape
    flat, along = contrast.reshape(-1), dy * w + dx
    whole = np.float32(np.sqrt(length))
    for y in range(h):
        for x in range(w):
            if contrast[y, x] < SEEN:
                continue
            if HALF_LENGTH <= y < h - HALF_LENGTH and HALF_LENGTH <= x < w - HALF_LENGTH:
                for a in range(angles):
                    total = np.float32(0.0)
                    for k in range(length):
                        total += flat[np.uint64(y * w + x + along[a, k])]
                    strength[y, x] = max(strength[y, x], total / whole)
                continue
            for a in range(angles):
                total, n = np.float32(0.0), 0
                for k in range(length):
                    i, j = y + dy[a, k], x + dx[a, k]
                    if 0 <= i < h and 0 <= j < w:
                        total += contrast[i, j]
                        n += 1
                if n > length // 2 + 2:
                    strength[y, x] = max(strength[y, x], total / np.float32(np.sqrt(n)))


class LineVotes:
    """The votes of all pictures on some points. Whole numbers, so that the order of pictures does not matter."""

    def __init__(self, points_enu_m: Array, reach_m: float, sure_m: float) -> None:
        """For points (n, 3); pictures from farther away than reach_m have no vote, and those from farther than sure_m
        show no wire surely."""
        self.points_enu_m, self._reach_m, self._sure_m = np.ascontiguousarray(points_enu_m), reach_m, sure_m
        self._sums, self._counts, self._sure_counts = (np.zeros(len(points_enu_m), np.int32) for _ in range(3))

    def add(self, strength: Strengths, camera: Camera, pose: Pose) -> None:
        """A picture votes by the `line_strength` of it."""
        levels = np.stack([cv2.dilate(strength, np.ones((edge, edge), np.uint8)) for edge in (5, 3)])
        _vote(self.points_enu_m, np.array(pose.position_enu_m), np.ascontiguousarray(pose.enu_from_camera.T),
              camera.matrix, levels, self._reach_m, self._sure_m, self._sums, self._counts, self._sure_counts)

    @property
    def sigmas(self) -> Array:
        """(n,) how much speaks for a wire near each point, as a sum of standard deviations; negative: none."""
        return self._sums / UNIT

    @property
    def counts(self) -> Counts:
        """(n,) pictures that voted on each point."""
        return self._counts

    @property
    def sure_counts(self) -> Counts:
        """(n,) those of them that would have shown a wire surely."""
        return self._sure_counts


@compiled
def _vote(points: Array, at: Array, camera_from_enu: Array, matrix: Array, levels: Strengths, reach: float,
          sure: float, sums: Counts, counts: Counts, sure_counts: Counts) -> None:
    """One picture's votes; levels (2, h, w): line strength at half size, spread out for near points and for far."""
    _, h, w = levels.shape
    for i in range(len(points)):
        x, y, z = points[i, 0] - at[0], points[i, 1] - at[1], points[i, 2] - at[2]
        distance = np.sqrt(x * x + y * y + z * z)
        depth = camera_from_enu[2, 0] * x + camera_from_enu[2, 1] * y + camera_from_enu[2, 2] * z
        if distance > reach or depth < 1.0:
            continue
        right = camera_from_enu[0, 0] * x + camera_from_enu[0, 1] * y + camera_from_enu[0, 2] * z
        down = camera_from_enu[1, 0] * x + camera_from_enu[1, 1] * y + camera_from_enu[1, 2] * z
        column = int(np.floor(0.5 * (matrix[0, 0] * right / depth + matrix[0, 2])))
        row = int(np.floor(0.5 * (matrix[1, 1] * down / depth + matrix[1, 2])))
        if 2 <= column < w - 2 and 2 <= row < h - 2:
            counts[i] += 1
            sure_counts[i] += distance <= sure
            sums[i] += levels[0 if distance < NEAR_M else 1, row, column] - int(UNLIKELY * UNIT)
