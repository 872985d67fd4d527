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

PATCHES = ((48, 48, 40), (48, 48, 40), (48, 48, 40), (96, 96, 64))
"""Voxels of a patch at most: mostly small, for many steps, sometimes large, for the far view."""
RIM_M = 1.5
"""Unknown voxels as near as this to known ones are the first that a ray meets."""
FAR_WEIGHT = 0.25


@dataclass(frozen=True)
class Sample:
    """One window: state and place as the network is told; solid where it is judged, which is where unknown holds."""

    state: NDArray[np.uint8]
    place: Floats
    solid: NDArray[np.uint8]
    unknown: NDArray[np.uint8]
    """(i, j, k) 0 where known, and beyond the grid."""
    rim_voxels: int

    def patch(self, rng: np.random.Generator) -> Sample:
        """A part as large as one of PATCHES, turned about the vertical by so many right angles, perhaps mirrored."""
        size = [min(n, m) for n, m in zip(self.state.shape, PATCHES[rng.integers(len(PATCHES))], strict=True)]
        spare = [n - s for n, s in zip(self.state.shape, size, strict=True)]
        first = [MULTIPLE * int(rng.integers(n // MULTIPLE + 1)) for n in spare]
        fine = tuple(slice(a, a + s) for a, s in zip(first, size, strict=True))
        coarse = (slice(None), *(slice(a // CELL, (a + s) // CELL) for a, s in zip(first, size, strict=True)))
        turns, mirrored = int(rng.integers(4)), bool(rng.integers(2))

        def placed(values: NDArray[np.generic], axis: int) -> NDArray[np.generic]:
            turned = np.rot90(values, turns, axes=(axis, axis + 1))
            return np.ascontiguousarray(np.flip(turned, axis) if mirrored else turned)

        return Sample(placed(self.state[fine], 0), placed(self.place[coarse], 1),  # type: ignore[arg-type]
                      placed(self.solid[fine], 0), placed(self.unknown[fine], 0),  # type: ignore[arg-type]
                      self.rim_voxels)

    @property
    def known(self) -> Floats:
        """(2, i, j, k) see `window.known`."""
        return known(self.state)

    @property
    def weight(self) -> Floats:
        """(i, j, k) what each voxel counts in the loss."""
        rim = ndimage.binary_dilation(self.state != UNKNOWN, iterations=self.rim_voxels)
        return np.where(rim, 1.0, FAR_WEIGHT).astype(np.float32) * self.unknown


def samples_of(maps: Iterable[PartialMaps]) -> list[Sample]:
    """One sample per map."""
    samples = []
    for m in maps:
        box = (m.object_min_enu_m, m.object_max_enu_m, m.ground_up_m)
        for grid in m.grids:
            window = Window.around(grid, *box)
            unknown = window.cut((grid.state == UNKNOWN).astype(np.uint8))
            samples.append(Sample(window.cut(grid.state), window.place(grid, *box),
                                  window.cut(m.solid.astype(np.uint8)), unknown, round(RIM_M / grid.voxel_m)))
    return samples
