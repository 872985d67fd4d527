"""What a leg costs: 3-D length, or the thesis's Eq. 4.4."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from missions.frames import Array


@dataclass(frozen=True)
class LegCost:
    """"distance": 3-D length. "distance_elevation": alpha * horizontal length + beta * |height difference|."""

    kind: Literal["distance", "distance_elevation"] = "distance"
    alpha: float = 1.0
    beta: float = 0.5

    def between(self, from_enu_m: Array, to_enu_m: Array) -> Array:
        """(a, b) costs from every position (a, 3) to every position (b, 3)."""
        gap = np.asarray(from_enu_m, dtype=np.float64)[:, None, :] - np.asarray(to_enu_m, dtype=np.float64)[None, :, :]
        if self.kind == "distance":
            length: Array = np.linalg.norm(gap, axis=-1)
            return length
        return self.alpha * np.hypot(gap[..., 0], gap[..., 1]) + self.beta * np.abs(gap[..., 2])
