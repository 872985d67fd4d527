"""Which of the map's surface hangs in the air by itself, though pictures looked through where it is.

Two depth maps from neighbouring places err alike now and then, and agree on a surface of a few voxels where there is
nothing. What is solid hangs on something, or is seen by whoever looks there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

BLOCK_VOXELS = 2
"""Voxels hang together when they lie in blocks of this edge that touch."""
MOST_VOXELS = 16
"""More that hang together are no stray depth."""


def adrift(occupied: NDArray[np.int64], shape: tuple[int, ...], free_pictures: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(n,) which of the occupied voxels, by flat number (n,) in a grid of this shape, belong to so small a piece, some
    voxel of which a picture saw to be free; free_pictures (n,): how many did."""
    block = tuple(np.stack(np.unravel_index(occupied, shape)) // BLOCK_VOXELS)
    blocks = np.zeros([-(-n // BLOCK_VOXELS) for n in shape], dtype=np.bool_)
    blocks[block] = True
    pieces, _ = ndimage.label(blocks, np.ones((3, 3, 3)))
    piece = pieces[block]
    small, looked_through = np.bincount(piece) <= MOST_VOXELS, np.bincount(piece, free_pictures) > 0.0
    result: NDArray[np.bool_] = (small & looked_through)[piece]
    return result
