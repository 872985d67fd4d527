"""How to reconstruct, and what of space to keep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from missions.frames import Array

Progress = Callable[[str, int, int], None]
"""Is told the stage, how much of it is done, and of how much."""


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """How to reconstruct. Lengths in metres."""

    depth_width_px: int = 960
    pairs_per_picture: int = 4
    min_confidence: int = 3
    spacing_m: float = 0.03
    distance_m: float = 7.0
    """Usual distance of the surface."""
    near_m: float = 2.0
    far_m: float = 60.0
    check_against: int = 22
    """Depth maps that each depth map is checked against."""
    threads: int = 4
    memory_gib: float = 4.0


@dataclass(frozen=True)
class Region:
    """The part of space to keep: points between two corners (ENU, metres)."""

    lower_enu_m: Array
    upper_enu_m: Array

    def contains(self, points_enu_m: NDArray[np.float32]) -> NDArray[np.bool_]:
        """(n,) mask of points (n, 3)."""
        return np.asarray(np.all((points_enu_m >= self.lower_enu_m) & (points_enu_m <= self.upper_enu_m), axis=1))
