"""Training samples: unknown voxels of partial maps, what is known around them, and what they truly are."""

from __future__ import annotations

import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from scipy import ndimage

from missions.grid import UNKNOWN, VoxelGrid
from missions.training_walks import walk_files
from perception.imagination.partial_maps import load_maps
from perception.imagination.surroundings import COUNT, Floats, surroundings, unknown_voxels
from perception.imagination.window import Window

RIM_M = 1.5
"""Unknown voxels as near as this to known ones are the first that a ray meets."""
PER_MAP = 750
"""Voxels drawn from the rim of each map, and as many from all of it."""


@dataclass(frozen=True)
class Samples:
    """n voxels."""

    known: Floats
    """(n, COUNT) see `surroundings`."""
    solid: NDArray[np.bool_]

    @classmethod
    def joined(cls, parts: list[Samples]) -> Samples:
        """All in one."""
        return cls(np.concatenate([p.known for p in parts]), np.concatenate([p.solid for p in parts]))


def rim(grid: VoxelGrid) -> NDArray[np.bool_]:
    """(i, j, k) unknown voxels within RIM_M of known ones."""
    known = grid.state != UNKNOWN
    result: NDArray[np.bool_] = ndimage.binary_dilation(known, iterations=round(RIM_M / grid.voxel_m)) & ~known
    return result


def samples_of(path: Path, seed: int) -> Samples:
    """Voxels of all maps along one walk. Raises UserError."""
    maps, parts = load_maps(path), [Samples(np.zeros((0, COUNT), np.float32), np.zeros(0, np.bool_))]
    rng = np.random.default_rng([seed, zlib.crc32(path.name.encode())])
    for grid in maps.grids:
        window = Window.around(grid, maps.box)
        near, solid = (window.cut(values.astype(np.uint8)).ravel() for values in (rim(grid), maps.solid))
        unknown = unknown_voxels(grid, window)
        drawn = [rng.permutation(choice)[:PER_MAP] for choice in (unknown[near[unknown] > 0], unknown)]
        where = np.unique(np.concatenate(drawn))
        parts.append(Samples(surroundings(grid, window, maps.box, where), solid[where] > 0))
    return Samples.joined(parts)


def load_samples(folder: Path, seed: int, workers: int) -> Samples:
    """Voxels of all walks in a folder, in the order of their names. Raises UserError."""
    paths = walk_files(folder)
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        found = pool.map(partial(samples_of, seed=seed), paths)
        return Samples.joined(list(track(found, "looking around", len(paths), console=Console(stderr=True))))
