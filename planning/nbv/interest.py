"""Places that count more than others: boxes that somebody has marked as important."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missions.frames import Array


@dataclass(frozen=True)
class Interest:
    """What is shown inside any of these boxes counts `weight` times."""

    lower_enu_m: Array
    """(b, 3)"""
    upper_enu_m: Array
    """(b, 3)"""
    weight: float = 3.0

    def weights_at(self, points_enu_m: Array) -> Array:
        """(n,) weights of what is shown at points (n, 3)."""
        points = points_enu_m[:, None]
        inside = np.all((points >= self.lower_enu_m) & (points <= self.upper_enu_m), axis=2)
        return np.where(np.any(inside, axis=1), self.weight, 1.0)
