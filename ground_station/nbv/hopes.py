"""How likely legs of the lattice are open that nobody knows yet."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from missions.pose_lattice import PoseLattice

MAYBE_OPEN = 0.6
"""How likely a leg through unknown space will turn out to be open, at first ..."""
FADING = 0.5
"""... and what is left of that chance each time that a plan counted on the leg soon and it stayed unknown. Without it a
vehicle can wait beside such a leg for good, when what lies behind is worth more than all that can be reached."""
SOON = 4
"""Steps."""


class Hopes:
    """Remembers which legs were counted on in vain."""

    def __init__(self, lattice: PoseLattice) -> None:
        self._lattice = lattice
        self._counted_on = np.zeros(lattice.leg_ends.shape, dtype=np.int64)

    def likely(self, open_: NDArray[np.bool_], known: NDArray[np.bool_]) -> Array:
        """(p, 6) how likely each leg is open: those that are not open_ are not, those that are known as well are."""
        chance = np.where(known, 1.0, MAYBE_OPEN * FADING**self._counted_on)
        return np.where(open_, chance, 0.0)

    def count_on(self, start: int, poses: list[int], likely: Array) -> None:
        """A plan leads from a pose over these: the first leg that is not sure to be open is counted on."""
        positions = [pose // self._lattice.orientations for pose in [start, *poses[:SOON]]]
        for a, b in itertools.pairwise(positions):
            along = int(np.flatnonzero(self._lattice.leg_ends[a] == b)[0])
            if likely[a, along] < 1.0:
                self._counted_on[a, along] += 1
                self._counted_on[b, along ^ 1] += 1
                return
