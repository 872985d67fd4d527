"""Training samples: windows of partial maps with what is truly there, turned and mirrored at random."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from missions.grid import UNKNOWN
from perception.imagination.partial_maps import PartialMaps
from perception.imagination.window import CELL, MULTIPLE, Floats, Window, known

LARGEST = (48, 48, 40)
"""Voxels of a patch at most."""
RIM_M = 1.5
"""Unknown voxels as near as this to known ones are the first that a ray meets."""
FAR_WEIGHT = 0.25


@dataclass(frozen=True)
class Sample:
    """One window: state and place as the network is told, solid and weight as it is judged."""

    state: NDArray[np.uint8]
    place: Floats
    solid: NDArray[np.uint8]
    judged: NDArray[np.uint8]
    """0 where known or beyond the grid, 1 where unknown, 2 where unknown and near to something known."""

    def patch(self, rng: np.random.Generator) -> Sample:
        """A part of at most LARGEST, turned about the vertical by a multiple of 90 degrees, perhaps mirrored."""
        size = [min(n, m) for n, m in zip(self.state.shape, LARGEST, strict=True)]
        spare = [n - s for n, s in zip(self.state.shape, size, strict=True)]
        first = [MULTIPLE * int(rng.integers(n // MULTIPLE + 1)) for n in spare]
        fine = tuple(slice(a, a + s) for a, s in zip(first, size, strict=True))
        coarse = (slice(None), *(slice(a // CELL, (a + s) // CELL) for a, s in zip(first, size, strict=True)))
        turns, mirrored = int(rng.integers(4)), bool(rng.integers(2))

        def placed(values: NDArray[np.generic], axis: int) -> NDArray[np.generic]:
            turned = np.rot90(values, turns, axes=(axis, axis + 1))
            return np.ascontiguousarray(np.flip(turned, axis) if mirrored else turned)

        return Sample(placed(self.state[fine], 0), placed(self.place[coarse], 1),  # type: ignore[arg-type]
                      placed(self.solid[fine], 0), placed(self.judged[fine], 0))  # type: ignore[arg-type]

    @property
    def known(self) -> Floats:
        """(2, i, j, k) see `window.known`."""
        return known(self.state)

    @property
    def weight(self) -> Floats:
        """(i, j, k) what each voxel counts in the loss."""
        return np.array([0.0, FAR_WEIGHT, 1.0], dtype=np.float32)[self.judged]


def samples_of(maps: Iterable[PartialMaps]) -> list[Sample]:
    """One sample per map."""
    samples = []
    for m in maps:
        box = (m.object_min_enu_m, m.object_max_enu_m, m.ground_up_m)
        for grid in m.grids:
            window = Window.around(grid, *box)
            state = window.cut(grid.state)
            unknown = window.cut((grid.state == UNKNOWN).astype(np.uint8))
            rim = ndimage.binary_dilation(state != UNKNOWN, iterations=round(RIM_M / grid.voxel_m))
            samples.append(Sample(state, window.place(grid, *box), window.cut(m.solid.astype(np.uint8)),
                                  unknown + (unknown & rim)))
    return samples
