"""Occupancy of a map with the unseen imagined. Needs no torch."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file

from missions.errors import UserError
from missions.frames import Array
from missions.grid import FREE, OCCUPIED, VoxelGrid
from perception.imagination.layers import logits
from perception.imagination.surroundings import COUNT, Floats, surroundings, unknown_voxels
from perception.imagination.window import Box, Window

WEIGHTS = Path(__file__).parent / "weights" / "imagination.safetensors"
OUTSIDE_PER_M = 0.03
"""Chance per metre that unknown space far from the object's box stops a ray."""
THREADS = 2
LAYERS = ("hidden.0", "hidden.1", "out")


@dataclass(frozen=True)
class Unseen:
    """The n unknown voxels of the window around an object's box."""

    index: NDArray[np.int64]
    """(3, n) in the grid."""
    known: Floats
    """(n, COUNT) see `surroundings`."""

    @classmethod
    def of(cls, grid: VoxelGrid, object_min_enu_m: Array, object_max_enu_m: Array, ground_up_m: float) -> Unseen:
        """Those of a map."""
        box = Box(np.asarray(object_min_enu_m, float), np.asarray(object_max_enu_m, float), ground_up_m)
        window = Window.around(grid, box)
        where = unknown_voxels(grid, window)
        index = np.stack(np.unravel_index(where, window.shape)) + window.first[:, None]
        return cls(index, surroundings(grid, window, box, where))


@dataclass(frozen=True)
class Imagination:
    """A trained network."""

    mean: Floats
    scale: Floats
    layers: tuple[Floats, ...]
    """Weights (in, out) and biases (out,) in turn, as `logits` takes them."""

    @classmethod
    def load(cls, path: Path | None = None) -> Imagination:
        """The network that ships, or that in a safetensors file. Raises UserError naming the file."""
        path = path or WEIGHTS
        if not path.is_file():
            raise UserError(f"there are no weights at {path}; train some with python -m perception.imagination.train.")
        try:
            t = load_file(path)
            parts = ((np.ascontiguousarray(t[f"{n}.weight"].T.squeeze()), t[f"{n}.bias"]) for n in LAYERS)
            net = cls(t["mean"], t["scale"], tuple(itertools.chain.from_iterable(parts)))
        except (SafetensorError, KeyError) as e:
            raise UserError(f"{path} holds no weights for imagination: {e}") from e
        if net.mean.shape != (COUNT,):
            raise UserError(f"{path} holds weights for {net.mean.shape} numbers, not {COUNT}; train anew.")
        return net

    def occupancy(self, grid: VoxelGrid, object_min_enu_m: Array, object_max_enu_m: Array,
                  ground_up_m: float) -> NDArray[np.float32]:
        """(i, j, k) probability that each voxel of the grid is solid: 0 where known free, 1 where known occupied.

        In the window around the object's box the network says; beyond it OUTSIDE_PER_M, and 1 under the ground. It was
        trained on voxels of 0.4 to 0.6 m where cameras see 25 m far.
        """
        return self.occupancy_of(grid, Unseen.of(grid, object_min_enu_m, object_max_enu_m, ground_up_m), ground_up_m)

    def occupancy_of(self, grid: VoxelGrid, unseen: Unseen, ground_up_m: float,
                     log_odds: Floats | None = None) -> NDArray[np.float32]:
        """As `occupancy`, where what is known around the n unknown voxels has been gathered before; log_odds (n,):
        what speaks for solid besides."""
        result = np.full(grid.state.shape, 1.0 - math.exp(-OUTSIDE_PER_M * grid.voxel_m), dtype=np.float32)
        under = int(np.clip((ground_up_m - grid.origin_enu_m[2]) // grid.voxel_m, 0, grid.state.shape[2]))
        result[:, :, :under] = 1.0
        result[tuple(unseen.index)] = self.chance(unseen.known, log_odds)
        result[grid.state == FREE] = 0.0
        result[grid.state == OCCUPIED] = 1.0
        return result

    def chance(self, known: Floats, log_odds: Floats | None = None) -> Floats:
        """(n,) probability of solid from (n, COUNT) numbers, and (n,) log odds that are added."""
        parts = np.array_split(np.ascontiguousarray(known.T), THREADS, axis=1)
        with ThreadPoolExecutor(THREADS) as pool:
            logit = np.concatenate(list(pool.map(lambda k: logits(k, self.mean, self.scale, *self.layers), parts)))
        logit = logit if log_odds is None else logit + log_odds
        result: Floats = np.float32(1.0) / (np.float32(1.0) + np.exp(-logit))
        return result
