"""Where to look for a vehicle that is shut in: what it surely reaches is worth little beside what it may reach."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from missions.pose_lattice import UNREACHED, Indices, PoseLattice, fewest_steps, way_back
from planning.nbv.lattice import in_view

STEPS_AHEAD = 6
"""A view farther away is not gone to."""
PER_STEP = 0.9
"""What a view is worth one step later."""
IN_VAIN = 0.5
"""What a leg is worth after each view of it that did not open it."""
LEAST = 0.05
"""Views that show less of every leg, after vain ones, are not worth while."""
SETTLED, FEW = 0.8, 12.0
"""Of the places that a view frames it settles this share, the others it does not show well; a leg of which so many are
left then is half as near to being known as one of which none are."""
MOST_PLACES = 80
"""Of more places on a leg that must be seen, as many are looked up."""

Leg = tuple[int, int]
"""A position and an axis step from it."""


class LookOut:
    """The views that show what must be seen before a leg to somewhere new is known to be open."""

    def __init__(self, lattice: PoseLattice, camera: Camera) -> None:
        self._lattice, self._camera = lattice, camera
        self._looks = np.zeros(lattice.leg_ends.shape, dtype=np.int64)

    def first_step(self, here: int, sure: NDArray[np.bool_], maybe: NDArray[np.bool_], behind: Array,
                   not_known_free: Callable[[int, int], Array]) -> int | None:
        """The pose to go to from a pose; None where no view shows enough.

        sure, maybe (p, 6): legs that are open, and that may be. behind: (p,) what may be had from each position.
        not_known_free: (n, 3) what must be seen of the leg between two positions.
        """
        steps = self._lattice.steps_along(sure)
        distance = fewest_steps(steps, here)
        poses = np.flatnonzero((distance > 0) & (distance <= STEPS_AHEAD))
        reached: NDArray[np.bool_] = np.asarray((distance >= 0).reshape(len(sure), -1).any(axis=1))
        legs = self._onward(np.unique(poses // self._lattice.orientations), maybe, reached)
        if not legs or not len(poses):
            return None
        ends = [int(self._lattice.leg_ends[a, k]) for a, k in legs]
        unseen = [not_known_free(a, b) for (a, _), b in zip(legs, ends, strict=True)]
        worth = self._nearer_to_known(poses, legs, unseen) * behind[ends]
        worth *= PER_STEP ** (distance[poses] - 1.0)[:, None]
        best = int(worth.sum(axis=1).argmax())
        leg = int(worth[best].argmax())
        if worth[best, leg] <= 0.0:
            return None
        if distance[poses[best]] == 1:
            self._looks[legs[leg]] += 1
        return way_back(steps, distance, int(poses[best]))[0]

    def _onward(self, places: Indices, maybe: NDArray[np.bool_], reached: NDArray[np.bool_]) -> list[Leg]:
        """Legs that may be open and lead from places to where no sure way leads."""
        ends = self._lattice.leg_ends[places]
        start, step = np.nonzero(maybe[places] & (ends != UNREACHED) & ~reached[ends])
        return [(int(places[a]), int(k)) for a, k in zip(start, step, strict=True)]

    def _nearer_to_known(self, poses: Indices, legs: list[Leg], unseen: list[Array]) -> Array:
        """(poses, legs) how much nearer each pose brings each leg to being known: the more, the more of it is shown and
        the less is left then."""
        shown = self._shown(poses, legs, unseen)
        left = (1.0 - SETTLED * shown) * [len(points) for points in unseen]
        return np.where(shown < LEAST, 0.0, shown / (1.0 + left / FEW))

    def _shown(self, poses: Indices, legs: list[Leg], unseen: list[Array]) -> Array:
        """(poses, legs) share that each pose shows of what must be seen of each leg, less where that was in vain. Only
        poses at a leg's start and beside it count."""
        places, orientation = np.divmod(poses, self._lattice.orientations)
        yaw, elevation = self._lattice.yaw_elevation_rad.T
        result = np.zeros((len(poses), len(legs)))
        for n, ((start, step), points) in enumerate(zip(legs, unseen, strict=True)):
            some = points[:: 1 + len(points) // MOST_PLACES]
            near = np.isin(places, [start, *self._lattice.leg_ends[start]])
            for place in np.unique(places[near]) if len(some) else ():
                share = in_view(some - self._lattice.positions_enu_m[place], yaw, elevation, self._camera).mean(axis=0)
                at = places == place
                result[at, n] = share[orientation[at]] * IN_VAIN ** self._looks[start, step]
        return result
