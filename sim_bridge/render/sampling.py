"""Texture look-ups in numpy, as a graphics driver would do them: bilinear or trilinear, in the nearest mipmap level."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
from numpy.typing import NDArray

from sim_bridge.render.light import Bytes, Floats, sky_map_scale


class Pyramid:
    """A picture that repeats, with its mipmap levels."""

    def __init__(self, texture: Bytes) -> None:
        """texture: (h, w, 3) uint8, first row at v = 1."""
        self._levels = [np.ascontiguousarray(texture[::-1])]
        while max(self._levels[-1].shape[:2]) > 1:
            h, w = self._levels[-1].shape[:2]
            half = max(1, w // 2), max(1, h // 2)
            self._levels.append(np.asarray(cv2.resize(self._levels[-1], half, interpolation=cv2.INTER_AREA), np.uint8))

    def sample(self, uv: Floats, footprint_uv: NDArray[np.floating]) -> Floats:
        """(n, 3) colours 0-1 at uv (n, 2), averaged over about footprint_uv (n,)."""
        h, w = self._levels[0].shape[:2]
        level = _nearest_level(footprint_uv * np.sqrt(h * w), len(self._levels))
        out = np.empty((len(uv), 3), np.float32)
        for k in np.unique(level):
            mine = np.flatnonzero(level == k)
            out[mine] = _sample_repeating(self._levels[k], uv[mine, ::-1])
        return out * np.float32(1 / 255)


class Volume:
    """A cube of noise that repeats, with its mipmap levels."""

    def __init__(self, cube: Bytes) -> None:
        """cube: (n, n, n, channels) uint8, n a power of two; array order z, y, x."""
        self._levels = [cube]
        while len(self._levels[-1]) > 1:
            n = len(self._levels[-1]) // 2
            halves = self._levels[-1].reshape(n, 2, n, 2, n, 2, -1).mean(axis=(1, 3, 5))
            self._levels.append(np.rint(halves).astype(np.uint8))

    def sample(self, xyz: NDArray[np.floating], footprint: NDArray[np.floating]) -> Floats:
        """(n, channels) values 0-1 at xyz (n, 3), in periods, averaged over about footprint (n,) periods."""
        level = _nearest_level(footprint * len(self._levels[0]), len(self._levels))
        out = np.empty((len(xyz), self._levels[0].shape[-1]), np.float32)
        for k in np.unique(level):
            mine = np.flatnonzero(level == k)
            out[mine] = _sample_repeating(self._levels[k], xyz[mine, ::-1])
        return out * np.float32(1 / 255)


def sample_dome(sky: Bytes, direction_enu: NDArray[np.float64]) -> Floats:
    """(n, 3) sky colours 0-1 seen along unit directions (n, 3); below the horizon, the colour above it."""
    up = np.maximum(direction_enu[:, 2:], 0)
    level = direction_enu[:, :2] / np.maximum(np.linalg.norm(direction_enu[:, :2], axis=1, keepdims=True), 1e-12)
    at = level * (np.sqrt(1 - up**2) * sky_map_scale() / np.sqrt(1 + up))
    return _sample_repeating(sky, 0.5 + 0.5 * at[:, ::-1]) * np.float32(1 / 255)


def _nearest_level(footprint_texels: NDArray[np.floating], levels: int) -> NDArray[np.intp]:
    level = np.rint(np.log2(np.maximum(footprint_texels, 1e-9)))
    return np.asarray(np.clip(level, 0, levels - 1), np.intp)


def _sample_repeating(level: Bytes, at: NDArray[np.floating]) -> Floats:
    """Multilinear look-up; at (n, axes) in periods, in the order of the array's axes."""
    axes = [_neighbours(at[:, axis], size) for axis, size in enumerate(level.shape[:-1])]
    flat = level.reshape(-1, level.shape[-1])
    out = np.zeros((len(at), level.shape[-1]), np.float32)
    for corner in itertools.product((0, 1), repeat=len(axes)):
        index, weight = np.zeros(len(at), np.int32), np.ones(len(at), np.float32)
        for size, (indices, weights), side in zip(level.shape, axes, corner, strict=False):
            index = index * np.int32(size) + indices[side]
            weight = weight * weights[side]
        out += weight[:, None] * flat.take(index, axis=0)
    return out


def _neighbours(at: NDArray[np.floating], size: int) -> tuple[list[NDArray[np.int32]], list[Floats]]:
    """Indices of the texels on both sides of each coordinate, and their weights."""
    position = ((at - np.floor(at)) * size - 0.5).astype(np.float32)
    low = np.floor(position)
    part = position - low
    first = low.astype(np.int32) % np.int32(size)
    return [first, (first + np.int32(1)) % np.int32(size)], [1 - part, part]
