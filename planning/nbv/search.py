"""Choosing the next views: every idle vehicle at once, over one shared map.

Utility of a view is its expected new surface discounted exponentially by the way to it, as in Bircher et al. (ICRA
2016, receding-horizon next-best-view) and the cost-aware utilities compared by Schmid et al. (RA-L 2020). Views are
given out one at a time, best utility first over all vehicles, and what a view will show is worth nothing to the views
chosen after it: the sequential greedy scheme of Burgard et al. (T-RO 2005) for co-ordinated exploration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from missions.frames import Array
from planning.nbv.gain import GainField, lattice_gains, with_claims
from planning.nbv.lattice import Lattice

REFRESHED_AT_ONCE = 24


@dataclass(frozen=True)
class VehicleQuery:
    """An idle vehicle asking for a view."""

    vehicle_id: int
    position_enu_m: Array
    """(3,)"""
    distance_m: Array
    """(p,) way to every lattice position; inf where it cannot be reached."""
    affordable: NDArray[np.bool_] | None = None
    """(p,) from which positions the battery still brings it home; None: from all."""


@dataclass(frozen=True)
class SearchSpec:
    """How the next views are weighed."""

    decay_per_m: float = 0.02
    """A view this much farther away (1 / decay) must promise e times the surface."""
    separation_m: float = 5.0
    """Least distance between the goals of two vehicles."""
    stop_gain: float = 0.01
    """No view is given whose gain falls below this share of the largest gain so far."""
    least_gain_m2: float = 0.5
    """Nor one that promises less than this."""


@dataclass(frozen=True)
class Assignment:
    """A view given to a vehicle."""

    vehicle_id: int
    pose: Pose
    gain_m2: float
    position_index: int
    orientation_index: int


@dataclass(frozen=True)
class Decision:
    """The views given out, and the largest gain that any reachable view promised before any was given."""

    assignments: list[Assignment]
    best_gain_m2: float


def next_views(field: GainField, lattice: Lattice, camera: Camera, vehicles: list[VehicleQuery],
               claimed: list[Pose], spec: SearchSpec, taken: NDArray[np.bool_] | None = None,
               largest_gain_m2: float = 0.0) -> Decision:
    """One next view for each idle vehicle that a worthwhile view exists for.

    claimed: views that busy vehicles are on their way to. taken: (p, o) candidates never to be given again.
    largest_gain_m2: the largest Decision.best_gain_m2 so far, for the stop rule. A vehicle without an assignment has
    nothing worthwhile within reach; when no vehicle is busy or served, exploration is over.
    """
    field = with_claims(field, claimed, camera)
    cost = np.array([_cost(v) for v in vehicles]).reshape(len(vehicles), len(lattice.positions_enu_m))
    for pose in claimed:
        cost[:, _near(lattice, np.array(pose.position_enu_m), spec)] = np.inf
    gains = _gains(field, lattice, camera, np.flatnonzero(np.isfinite(cost).any(axis=0)), taken)
    best = float(gains[np.isfinite(cost).any(axis=0)].max(initial=0.0))
    least = max(spec.least_gain_m2, spec.stop_gain * max(largest_gain_m2, best))
    assignments: list[Assignment] = []
    fresh = np.ones(len(gains), dtype=bool)
    while len(assignments) < len(vehicles):
        pick = _pick(field, lattice, camera, gains, fresh, cost, spec, least, taken)
        if pick is None:
            break
        v, p, o = pick
        chosen = Assignment(vehicles[v].vehicle_id, lattice.pose(p, o), float(gains[p, o]), p, o)
        assignments.append(chosen)
        cost[v] = np.inf
        cost[:, _near(lattice, lattice.positions_enu_m[p], spec)] = np.inf
        field = with_claims(field, [chosen.pose], camera)
        fresh[:] = False
    return Decision(assignments, best)


def _pick(field: GainField, lattice: Lattice, camera: Camera, gains: Array, fresh: NDArray[np.bool_], cost: Array,
          spec: SearchSpec, least: float, taken: NDArray[np.bool_] | None) -> tuple[int, int, int] | None:
    """Best (vehicle, position, orientation) under the field, refreshing stale gains only where they could win.

    Claims only lower gains, so a stale gain bounds the true one from above (lazy greedy, Minoux 1978).
    """
    while True:
        best = gains.max(axis=1, initial=0.0)
        utility = np.where(best[None, :] >= least, best[None, :] * np.exp(-spec.decay_per_m * cost), 0.0)
        bound = utility.max(axis=0, initial=0.0)
        p = int(bound.argmax())
        if bound[p] <= 0.0:
            return None
        if fresh[p]:
            return int(utility[:, p].argmax()), p, int(gains[p].argmax())
        order = np.argsort(-bound, kind="stable")
        stale = order[~fresh[order] & (bound[order] > 0.0)][:REFRESHED_AT_ONCE]
        gains[stale] = _gains(field, lattice, camera, stale, taken)[stale]
        fresh[stale] = True


def _gains(field: GainField, lattice: Lattice, camera: Camera, positions: NDArray[np.int64],
           taken: NDArray[np.bool_] | None) -> Array:
    gains = np.zeros((len(lattice.positions_enu_m), len(lattice.yaw_enu_rad)))
    gains[positions] = lattice_gains(field, lattice, camera, positions)
    if taken is not None:
        gains[taken] = 0.0
    return gains


def _cost(vehicle: VehicleQuery) -> Array:
    """(p,) way to every position, inf where the vehicle could not reach it and still fly home."""
    way = np.asarray(vehicle.distance_m, dtype=np.float64)
    return way if vehicle.affordable is None else np.where(vehicle.affordable, way, np.inf)


def _near(lattice: Lattice, position_enu_m: Array, spec: SearchSpec) -> NDArray[np.bool_]:
    near: NDArray[np.bool_] = np.linalg.norm(lattice.positions_enu_m - position_enu_m, axis=1) < spec.separation_m
    return near
