"""Where exploration's views may stand: what the planner searches, and what the referee judges the search against."""

from __future__ import annotations

import numpy as np

from missions.frames import Array
from missions.mission import ExploreSpec

MOST_POSITIONS = 4000
"""Around a large object the step grows until there are no more: each position costs thousands of rays per decision."""
STEP_GROWTH = 1.02


def lattice_positions(lower_enu_m: Array, upper_enu_m: Array, step_m: float) -> Array:
    """(p, 3) cell centres of the box, x slowest, with max(1, round(extent / step)) cells along each axis.

    lower + (i + 0.5) * extent / n, as in MACARONS (Guédon et al., CVPR 2023).
    """
    axes = [low + (np.arange(n) + 0.5) * (high - low) / n
            for low, high, n in zip(lower_enu_m, upper_enu_m, _cells(lower_enu_m, upper_enu_m, step_m), strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def view_positions(lower_enu_m: Array, upper_enu_m: Array, spec: ExploreSpec) -> Array:
    """(p, 3) positions of exploration views in the camera bounds: the mission's step, or the least one beyond it that
    leaves at most MOST_POSITIONS."""
    step_m = spec.lattice_step_m
    while int(np.prod(_cells(lower_enu_m, upper_enu_m, step_m))) > MOST_POSITIONS:
        step_m *= STEP_GROWTH
    return lattice_positions(lower_enu_m, upper_enu_m, step_m)


def _cells(lower_enu_m: Array, upper_enu_m: Array, step_m: float) -> list[int]:
    return [max(1, round(float(high - low) / step_m)) for low, high in zip(lower_enu_m, upper_enu_m, strict=True)]
