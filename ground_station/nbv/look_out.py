"""Where to look for a vehicle that is shut in: between places where it was, with no known way to any other."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from missions.pose_lattice import TURNS, PoseLattice
from planning.nbv.lattice import in_view

ALONG = np.array([0.3, 0.6, 1.0])
"""Places on a leg that a view should show."""


def shut_in(lattice: PoseLattice, sure: NDArray[np.bool_], here: int, been: Collection[int]) -> bool:
    """Whether legs that are sure to be open (p, 6) lead from a position to none but those where a vehicle was."""
    ends, known, front = leg_ends(lattice), set(been), [here]
    found = {here}
    while front:
        at = front.pop()
        onward = [int(n) for n in ends[at][sure[at] & (ends[at] >= 0)] if int(n) not in found]
        if any(n not in known for n in onward):
            return False
        found.update(onward)
        front += onward
    return True


def looking_out(lattice: PoseLattice, maybe: NDArray[np.bool_], been: Collection[int], poses: list[int],
                camera: Camera) -> list[int]:
    """Those of the poses that look at most of the legs (p, 6) that may be open and lead from where a vehicle was to
    where none was."""
    ends, at, places = leg_ends(lattice), lattice.positions_enu_m, np.array(sorted(been))
    start, step = np.nonzero(maybe[places] & (ends[places] >= 0) & ~np.isin(ends[places], places))
    if not len(start) or not poses:
        return poses
    start, end = at[places[start]], at[ends[places[start], step]]
    targets = (start + ALONG[:, None, None] * (end - start)).reshape(-1, 3)
    shown = [_shown(lattice, pose, targets, camera) for pose in poses]
    return [pose for pose, count in zip(poses, shown, strict=True) if count == max(shown)]


def leg_ends(lattice: PoseLattice) -> NDArray[np.int64]:
    """(p, 6) position to which each axis step leads; negative where there is none."""
    straight = lattice.steps[::lattice.orientations, :: len(TURNS)]
    return np.where(straight >= 0, straight // lattice.orientations, -1)


def _shown(lattice: PoseLattice, pose: int, targets: Array, camera: Camera) -> int:
    position, orientation = divmod(pose, lattice.orientations)
    yaw, elevation = lattice.yaw_elevation_rad[orientation]
    away = targets - lattice.positions_enu_m[position]
    return int(in_view(away, np.array([yaw]), np.array([elevation]), camera).sum())
