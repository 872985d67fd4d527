"""Imagination that learns in flight from its own map: what was unknown in an earlier state and is known now is a label.

Every state leaves some of its unknown voxels behind, with what was known around them then. Those that have become known
since say whether they are solid. The others, most of which no picture will ever show, hold the network to what it said
before the flight: what becomes known is mostly air, and must not talk the inside of things away.

It learns besides how far the object is alike left and right, front and back (`perception.imagination.symmetry`).
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from missions.grid import OCCUPIED, UNKNOWN, VoxelGrid
from perception.imagination.imagine import Imagination, Unseen
from perception.imagination.layers import gradients
from perception.imagination.surroundings import COUNT, Floats
from perception.imagination.symmetry import evidence

DECAY, SQUARE_DECAY, SMALL = 0.9, 0.999, 1e-8
"""Of Adam (Kingma & Ba, 2015)."""


class AdaptSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How fast imagination learns in flight."""

    rate: float = 3e-4
    steps: int = 8
    """Per state of the map."""
    batch: int = 256
    """Labels per step, and as many voxels that are unknown still."""
    hold: float = 3.0
    """Weight of those, beside labels."""
    kept: int = 3000
    """Unknown voxels remembered from every state."""
    least: int = 500
    """Labels before learning begins."""


class AdaptiveImagination:
    """Imagination of one flight. Equal states of the map, in the same order, give equal chances."""

    def __init__(self, start: Imagination, settings: AdaptSettings | None = None, seed: int = 1) -> None:
        self.now, self._start, self._s = start, start, settings or AdaptSettings()
        self._rng = np.random.default_rng([seed, 0x4144])
        self._index = np.zeros((3, 0), dtype=np.int64)
        self._known: Floats = np.zeros((0, COUNT), dtype=np.float32)
        self._before: Floats = np.zeros(0, dtype=np.float32)
        self._moments = [(np.zeros_like(w), np.zeros_like(w)) for w in start.layers]
        self._updates = 0

    def occupancy(self, grid: VoxelGrid, object_min_enu_m: Array, object_max_enu_m: Array,
                  ground_up_m: float) -> NDArray[np.float32]:
        """As Imagination's, by a network that has learnt from all states of the map so far, and by opposites."""
        self._learn(grid)
        unseen = Unseen.of(grid, object_min_enu_m, object_max_enu_m, ground_up_m)
        self._remember(unseen)
        opposites = evidence(grid, unseen.index, object_min_enu_m, object_max_enu_m)
        return self.now.occupancy_of(grid, unseen, ground_up_m, opposites)

    def _remember(self, unseen: Unseen) -> None:
        some = self._rng.permutation(len(unseen.known))[:self._s.kept]
        known = unseen.known[some]
        self._index = np.concatenate([self._index, unseen.index[:, some]], axis=1)
        self._known = np.concatenate([self._known, known])
        self._before = np.concatenate([self._before, self._start.chance(known)])

    def _learn(self, grid: VoxelGrid) -> None:
        state = grid.state[tuple(self._index)]
        labelled, open_ = np.flatnonzero(state != UNKNOWN), np.flatnonzero(state == UNKNOWN)
        if len(labelled) < self._s.least:
            return
        target: Floats = np.where(state == UNKNOWN, self._before, state == OCCUPIED).astype(np.float32)
        for _ in range(self._s.steps):
            drawn = np.concatenate([some[self._rng.integers(len(some), size=self._s.batch)]
                                    for some in (labelled, open_) if len(some)])
            weight: Floats = np.where(state[drawn] == UNKNOWN, self._s.hold, 1.0).astype(np.float32)
            weight /= np.float32(self._s.batch)
            self._step(gradients(self._known[drawn], target[drawn], weight, self.now.mean, self.now.scale,
                                 *self.now.layers))

    def _step(self, slopes: tuple[Floats, ...]) -> None:
        """One step of Adam."""
        self._updates += 1
        bias, square_bias = 1.0 - DECAY**self._updates, 1.0 - SQUARE_DECAY**self._updates
        layers = []
        for values, slope, (mean, square) in zip(self.now.layers, slopes, self._moments, strict=True):
            mean += np.float32(1.0 - DECAY) * (slope - mean)
            square += np.float32(1.0 - SQUARE_DECAY) * (slope * slope - square)
            layers.append(values - np.float32(self._s.rate / bias) * mean
                          / (np.sqrt(square / np.float32(square_bias)) + np.float32(SMALL)))
        self.now = replace(self.now, layers=tuple(layers))


def make_imagination(adapt: bool) -> Imagination | AdaptiveImagination:
    """The network that ships, as it is or learning in flight."""
    shipped = Imagination.load()
    return AdaptiveImagination(shipped) if adapt else shipped
