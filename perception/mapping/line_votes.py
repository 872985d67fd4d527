"""Wires, which depth does not resolve: thin lines in the pictures, and how far the pictures agree that one is there.

A cable of 3 cm is half a pixel wide 20 m away and has no depth, but stretches through the picture as a faint line. One
picture's line may be a blade of grass, a kerb or a shadow. A wire is where the lines of all pictures meet: every
picture votes on every point that is asked about, by how much likelier a line of that strength is at its place in the
picture with a wire there than without one.
"""

from __future__ import annotations

from dataclasses import dataclass
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
PLAIN = 5.0
"""A wire shows plainly where its line would be so strong."""
WIRE_M, WIRE_DN = 0.03, 20.0
"""The thinnest wire that is reckoned with, and how much it differs from grass behind it."""
LINE, PLAINLY, BOTH, NONE = 0.25, -3.9, 0.85, -0.33
"""The logarithm of how much likelier a picture is with a wire than without one: NONE + LINE s + PLAINLY p + BOTH s p
for a line of strength s, where a wire would differ p times as much as one that shows plainly."""
MOST = 3.0
"""No picture says more."""
FAINTEST = 0.2
"""Pictures in which a wire would differ less, beside one that shows plainly, have no vote: they hardly tell, and many
of them tell the same."""
UNIT = 32
"""Votes are whole numbers: this many to a unit of the logarithm, and strengths as many to a standard deviation."""
NEAR_M = 9.0
"""Nearer points are farther apart in the picture, so their places are searched more widely."""
WIDE_M = 4.0
"""Of what is nearer, pictures say half as much: there a wire is no thin line any more, and has depth."""
FAR_M, HEARSAY = 30.0, -3.0
"""All that pictures from farther, and those before what hides WIRE_DN from however near, say against a wire counts no
more than this together: a wire that one of them does not show the others hardly do either, and better ones must be able
to say otherwise."""
NEAR_PX = 0.4
"""A picture in which the thinnest wire is at least so wide is a look from nearby."""
HIDDEN, HIDDEN_M = 1.1, 0.5
"""A place is hidden when it lies deeper than so many times what the picture shows there, and so much more."""
UNHIDDEN: Image = np.full((1, 1), np.inf, np.float32)
NEAREST_M = 0.5
"""Only what lies less deep has no vote: well within the clearance, so that a vehicle which looks along a leg from its
start leaves no place on it that nobody looked at."""

Strengths = NDArray[np.uint8]
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Lines:
    """What a picture shows of thin lines, at half its size."""

    strength: Strengths
    """(h, w) how much the best straight line of 2 HALF_LENGTH + 1 pixels through each pixel stands out, in 1 / UNIT
    standard deviations."""
    plain_dn: Image
    """(h, w) how much a line must differ from what is beside it to be as strong as PLAIN."""

    @classmethod
    def of(cls, rgb: NDArray[np.uint8]) -> Lines:
        """Those of a picture (2 h, 2 w, 3)."""
        contrast = _contrast(rgb)
        mean, spread = _around(contrast)
        angle, along = np.pi * np.arange(ANGLES) / ANGLES, np.arange(-HALF_LENGTH, HALF_LENGTH + 1)
        dx, dy = (np.round(np.outer(f(angle), along)).astype(np.int64) for f in (np.cos, np.sin))
        strength = np.zeros_like(contrast)
        _best_lines(np.minimum((contrast - mean) / spread, STRONGEST).astype(np.float32), dx, dy, strength)
        mean, spread = _around(np.minimum(contrast, np.float32(WIRE_DN)))  # or a wire would hide itself
        plain = mean + PLAIN / np.sqrt(2 * HALF_LENGTH + 1) * spread
        return cls(np.asarray(UNIT * np.clip(strength, 0.0, STRONGEST_LINE), dtype=np.uint8),
                   plain.astype(np.float32))


def _around(contrast: Image) -> tuple[Image, Image]:
    """Mean and standard deviation in the window around each pixel, this with the noise of a camera."""
    mean = cv2.blur(contrast, (AROUND, AROUND))
    square = cv2.blur(contrast * contrast, (AROUND, AROUND))
    return mean, np.sqrt(np.maximum(square - mean * mean, 0.0)) + np.float32(NOISE_DN)


def _contrast(rgb: NDArray[np.uint8]) -> Image:
    """(h, w) how much each pixel of a picture (2 h, 2 w, 3) differs from what is beside it, if it is thin."""
    h, w = rgb.shape[0] // 2, rgb.shape[1] // 2
    bright, dark = (cv2.morphologyEx(rgb, hat, np.ones((3, 3), np.uint8))
                    for hat in (cv2.MORPH_TOPHAT, cv2.MORPH_BLACKHAT))
    strongest = reduce(np.maximum, cv2.split(np.maximum(bright, dark)))[: 2 * h, : 2 * w]
    halves = [strongest[i::2, j::2] for i in (0, 1) for j in (0, 1)]
    result: Image = reduce(np.maximum, halves).astype(np.float32)
    return result


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


@dataclass(frozen=True)
class Shown:
    """What a picture shows at n places of points."""

    line: Floats
    """(n,) how strong a line is there, in standard deviations."""
    plainly: Floats
    """(n,) how much a wire would differ from what is beside it, as a share of what shows plainly; 1 at most."""
    weight: Floats
    """(n,) of its vote; 0 where it has none."""
    hearsay: NDArray[np.bool_]
    """(n,) where HEARSAY bounds what it says."""
    nearby: NDArray[np.bool_]
    """(n,) where it has a vote from nearby."""


def log_odds(line: Floats, plainly: Floats) -> Floats:
    """(n,) logarithm of how much likelier it is with a wire than without one that pictures show (n,) lines so strong
    where a wire would differ so much."""
    result: Floats = np.clip(NONE + LINE * line + PLAINLY * plainly + BOTH * line * plainly, -MOST, MOST)
    return result


class LineVotes:
    """The votes of all pictures on some points. Whole numbers, so that the order of pictures does not matter."""

    def __init__(self, points_enu_m: Array, reach_m: float) -> None:
        """For points (n, 3). Pictures from farther than reach_m have no vote. looks (n,): pictures from nearby."""
        self.points_enu_m, self._reach_m = np.ascontiguousarray(points_enu_m), reach_m
        self._told, self._heard, self.looks = np.zeros((3, len(points_enu_m)), np.int32)

    @property
    def log_odds(self) -> Array:
        """(n,) how much speaks for a wire near each point: the logarithm of how much likelier the pictures are with it
        than without it, if they were independent; negative: it speaks against one."""
        return (self._told + np.maximum(self._heard, int(UNIT * HEARSAY))) / UNIT

    def add(self, lines: Lines, camera: Camera, pose: Pose, surface_m: Image = UNHIDDEN) -> None:
        """A picture votes by the lines in it. surface_m: (h, w) of any size, how deep it shows; inf where that is not
        known. On what is hidden it has no vote."""
        shown = self.shown(lines, camera, pose, surface_m)
        votes = np.round(UNIT * shown.weight * log_odds(shown.line, shown.plainly)).astype(np.int32)
        self._heard += np.where(shown.hearsay, votes, 0)
        self._told += np.where(shown.hearsay, 0, votes)
        self.looks += shown.nearby

    def shown(self, lines: Lines, camera: Camera, pose: Pose, surface_m: Image = UNHIDDEN) -> Shown:
        """What a picture shows at the points; as in `add`."""
        levels = np.stack([cv2.dilate(lines.strength, np.ones((edge, edge), np.uint8)) for edge in (5, 3)])
        line, plainly, weight = np.zeros((3, len(self.points_enu_m)), np.float32)
        shown = Shown(line, plainly, weight, *np.zeros((2, len(line)), np.bool_))
        _look(self.points_enu_m, np.array(pose.position_enu_m), np.ascontiguousarray(pose.enu_from_camera.T),
              camera.matrix, levels, lines.plain_dn, surface_m, WIRE_M * camera.fx_px, self._reach_m, shown.line,
              shown.plainly, shown.weight, shown.hearsay, shown.nearby)
        return shown


@compiled
def _look(points: Array, at: Array, camera_from_enu: Array, matrix: Array, levels: Strengths, plain_dn: Image,
          surface: Image, wire_px_m: float, reach: float, line: Floats, plainly: Floats, weight: Floats,
          hearsay: NDArray[np.bool_], nearby: NDArray[np.bool_]) -> None:
    """Shown; levels (2, h, w): line strength at half size, spread out for near points and for far; plain_dn (h, w): of
    Lines; surface: how deep it shows; wire_px_m: pixels that a wire is wide at a distance of 1 m."""
    _, h, w = levels.shape
    for i in range(len(points)):
        x, y, z = points[i, 0] - at[0], points[i, 1] - at[1], points[i, 2] - at[2]
        depth = camera_from_enu[2, 0] * x + camera_from_enu[2, 1] * y + camera_from_enu[2, 2] * z
        if depth < NEAREST_M:
            continue
        right = camera_from_enu[0, 0] * x + camera_from_enu[0, 1] * y + camera_from_enu[0, 2] * z
        down = camera_from_enu[1, 0] * x + camera_from_enu[1, 1] * y + camera_from_enu[1, 2] * z
        column = int(np.floor(0.5 * (matrix[0, 0] * right / depth + matrix[0, 2])))
        row = int(np.floor(0.5 * (matrix[1, 1] * down / depth + matrix[1, 2])))
        distance = np.sqrt(x * x + y * y + z * z)
        if distance > reach or not (2 <= column < w - 2 and 2 <= row < h - 2):
            continue
        if depth > HIDDEN * surface[row * surface.shape[0] // h, column * surface.shape[1] // w] + HIDDEN_M:
            continue
        plainly[i] = min(WIRE_DN * min(1.0, wire_px_m / distance) / plain_dn[row, column], 1.0)
        if plainly[i] >= FAINTEST:
            line[i] = levels[0 if distance < NEAR_M else 1, row, column] / UNIT
            weight[i] = 0.5 if distance < WIDE_M else 1.0
            hearsay[i] = distance > FAR_M or plain_dn[row, column] > WIRE_DN
            nearby[i] = wire_px_m >= NEAR_PX * distance
