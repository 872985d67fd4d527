"""Several steps ahead on the lattice of poses: a beam search over what the views of a way would show together.

Close by, the search knows what each view adds after the ones before it; farther than it looks, the best view that can
be reached counts with what it shows alone, discounted by the steps to get there. So a vehicle in a place where nothing
is left to see heads for where there is (receding horizon, Bircher et al., ICRA 2016; beam search as in MAGICIAN,
Li et al., CVPR 2026).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from planning.nbv.horizon_kernels import beam, promise, promise_each
from planning.nbv.sights import Sights

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class HorizonSpec:
    """How far and how widely the search looks."""

    depth: int = 8
    """Steps."""
    width: int = 12
    """Ways that are kept at each depth."""
    finals: int = 4
    """Ways whose ends are looked at again with all that they show taken away."""
    discount: float = 0.92
    """What a square metre is worth one step later."""


@dataclass(frozen=True)
class Way:
    """Poses by flat number, first step first, and what each is expected to add, m^2."""

    poses: list[int]
    gains_m2: list[float]
    value: float
    """Discounted sum, with the promise of where the way ends."""


def promises(gains_m2: Array, steps: Indices, passable: Array, spec: HorizonSpec) -> Array:
    """(n,) for every pose the best view that can be reached from it: max over ways of what the last view shows alone,
    gains_m2 (p, o), times a discount and the passability for each step.

    steps (n, 30): flat number of each pose's neighbours, negative where there is none. passable (n, 30): 0 where a step
    is known to be blocked, 1 where it is known to be free, between them where that is not known.
    """
    result: Array = promise(gains_m2.ravel(), steps, passable, spec.discount)
    return result


def best_way(sights: Sights, left: NDArray[np.float32], steps: Indices, passable: Array, start: int,
             first_steps: list[int], promised: Array, spec: HorizonSpec) -> Way | None:
    """The best way from a pose whose first step leads to one of the poses in first_steps; None when there are none.

    What lies beyond the way is reckoned anew for the best ways at the end, so that nothing it shows counts
    twice. Cost: width * depth * 30 views, each the sum over its rays' entries, and finals times `promises`.
    """
    if not first_steps:
        return None
    o = sights.orientations
    poses, gains, value, sure, after = beam(
        sights.first, sights.cell, sights.area_m2, sights.arrives, left, o.first, o.rays, len(o.directions_enu), steps,
        passable, start, np.array(first_steps), promised, spec.depth, spec.width, spec.discount)
    if not len(poses):
        return None
    lengths = (poses >= 0).sum(axis=1)
    ends = poses[np.arange(len(poses)), lengths - 1]
    weight = sure * spec.discount**lengths
    finals = np.argsort(-(value + weight * promised[ends]), kind="stable")[: spec.finals]
    gains_beyond = np.array([sights.gains_after(after[k]).ravel() for k in finals])
    beyond = promise_each(gains_beyond, steps, passable, spec.discount)[np.arange(len(finals)), ends[finals]]
    total = value[finals] + weight[finals] * beyond
    k = int(finals[total.argmax()])
    n = int(lengths[k])
    return Way([int(p) for p in poses[k, :n]], [float(g) for g in gains[k, :n]], float(total.max()))
