"""What the views of a lattice would show, for a search over a few of them: those within reach and those behind space
that is not known yet.

Only what was seen to be free is flown through, so most positions are out of reach at first, and where nothing is left
to see from those within reach, only a look at the space between opens the way. A position that is out of reach counts
with a chance, and with what lies beyond it, so that such a look is weighed like any other view.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from missions.camera import Camera
from missions.frames import Array
from planning.nbv.lattice import Lattice, in_view
from planning.nbv.sights import ImaginedMap, Orientations, Sights, sights
from planning.trajectories import Limits, leg_time_s

Indices = NDArray[np.int64]
BEYOND = 0.5
"""Worth of what lies beyond a position that is not within reach itself."""
CLEAR_ENOUGH = 0.3
"""A look opens the way to a position that it reaches with this probability."""
OPENED_SHARE = 0.5
"""of the sensing range: positions farther from where vehicles can be are not opened by one look."""
SOLID = 0.999
"""Occupancy from which on a voxel is as good as solid."""
TINY = 1e-9
"""Worth, in m^2, of a view that shows nothing: it may still open the way."""
FARTHEST = 200
"""Positions out of reach that are looked at as to what lies beyond others."""


@dataclass(frozen=True)
class AheadSpec:
    """How far and how widely the search looks, and what flying costs."""

    limits: Limits
    separation_m: float
    """Least distance between the goals of two vehicles."""
    depth: int = 3
    """Views of a plan."""
    width: int = 5
    """Plans that are kept at each depth."""
    shortlist: int = 100
    """Positions within reach, for each vehicle, that plans are made of."""
    beyond: int = 40
    """Positions out of reach that plans may open."""
    coarse_rays: int = 512
    """Rays over the whole sphere by which positions come onto the shortlist."""
    rays: int = 2048
    """Rays by which plans are weighed."""
    decay_per_s: float = 0.06
    """A square metre this much later (1 / decay) is worth 1 / e."""
    detour: float = 1.15
    """Ways between two views are taken to be this much longer than a straight line."""
    handling_s: float = 0.8
    """From the end of one flight to the start of the next."""

    def seconds(self, way_m: Array) -> Array:
        """Of flying ways of these lengths from rest to rest and of what is between two flights; inf stays inf."""
        finite = np.isfinite(way_m)
        flight_s = leg_time_s(np.where(finite, way_m, 0.0), self.limits)
        return np.where(finite, flight_s + self.handling_s, np.inf)

    def later(self, duration_s: Array) -> Array:
        """What is left of a square metre after this time."""
        return np.asarray(np.exp(-self.decay_per_s * duration_s))


@dataclass(frozen=True)
class Outlook:
    """The shortlisted positions and what is to be seen from them."""

    numbers: Indices
    """(k,) of the lattice."""
    positions_enu_m: Array
    onward_m: Array
    """(k, k) way from one to another; inf from each to itself, since depth needs a baseline."""
    sights: Sights
    chance: Array
    """(k, o) 1 for views within somebody's reach; how likely others can be had once looked at; 0 for views that may not
    be given."""
    opened: Indices
    """(f,) which of the shortlist are out of reach."""
    opens: NDArray[np.bool_]
    """(k, o, f) which of those a view looks at, with likely nothing between."""
    promise_m2: Array
    """(k, o) what a view opens: the best of it, discounted by the time to get there."""
    promise_way_m: Array
    """(k, o) the way to it."""


def outlook(imagined: ImaginedMap, lattice: Lattice, camera: Camera, range_m: float, way_s: Array, chance: Array,
            spec: AheadSpec) -> Outlook:
    """way_s (v, p): seconds from each vehicle to each position, inf where it may not go. chance: as in `plan_views`."""
    at, views = lattice.positions_enu_m, (lattice.yaw_enu_rad, lattice.elevation_rad, camera)
    given = np.flatnonzero(chance.any(axis=1))
    coarse = sights(imagined, at[given], Orientations.of(*views, spec.coarse_rays), range_m)
    gain = np.zeros(len(at))
    gain[given] = np.where(chance[given] > 0.0, coarse.gains_m2, 0.0).max(axis=1)
    within = np.asarray(np.isfinite(way_s).any(axis=0))
    near = _union(_largest(np.where(np.isfinite(way), gain + TINY, 0.0) * spec.later(way), spec.shortlist)
                  for way in way_s)
    ahead = _ahead(at, np.where(within, 0.0, gain), spec) * chance.max(axis=1)
    away = cdist(at, at[near]).min(axis=1)
    openable = ~within & (away < OPENED_SHARE * range_m)
    far = _largest(np.where(openable, ahead * spec.later(spec.seconds(away)), 0.0), spec.beyond)
    numbers = _union([near, far])
    chosen = at[numbers]
    onward_m = spec.detour * cdist(chosen, chosen)
    np.fill_diagonal(onward_m, np.inf)
    opened = np.flatnonzero(~within[numbers])
    opens = _opens(imagined, lattice, numbers, opened, camera, range_m)
    promise_m2, promise_way_m = _promises(opens, ahead[numbers[opened]], onward_m[:, opened], spec)
    known = np.where(within[numbers, None], chance[numbers] > 0.0, chance[numbers])
    return Outlook(numbers, chosen, onward_m, sights(imagined, chosen, Orientations.of(*views, spec.rays), range_m),
                   known, opened, opens, promise_m2, promise_way_m)


def _ahead(at: Array, gains_m2: Array, spec: AheadSpec) -> Array:
    """(p,) the best view that can be had from positions or, straight through space not known yet, beyond them."""
    far = _largest(gains_m2, FARTHEST)
    onward = gains_m2[far] * spec.later(spec.seconds(spec.detour * cdist(at, at[far])))
    return np.asarray(np.maximum(gains_m2, BEYOND * onward.max(axis=1, initial=0.0)))


def _promises(opens: NDArray[np.bool_], ahead_m2: Array, onward_m: Array, spec: AheadSpec) -> tuple[Array, Array]:
    """(k, o) the best of what each view opens, discounted, and the way to it."""
    if not len(ahead_m2):
        return np.zeros(opens.shape[:2]), np.zeros(opens.shape[:2])
    worth = opens * (ahead_m2 * spec.later(spec.seconds(onward_m)))[:, None]
    best = worth.argmax(axis=-1)
    way_m = np.take_along_axis(onward_m, best, axis=1)
    return worth.max(axis=-1), np.where(worth.max(axis=-1) > 0.0, way_m, 0.0)


def _opens(imagined: ImaginedMap, lattice: Lattice, numbers: Indices, opened: Indices, camera: Camera,
           range_m: float) -> NDArray[np.bool_]:
    """(k, o, f) which of the positions out of reach each view shows with likely nothing between."""
    at = lattice.positions_enu_m[numbers]
    away = at[opened][None] - at[:, None]
    length = np.linalg.norm(away, axis=-1)
    k, f = np.nonzero((length < range_m) & (length > 0.0))
    steps = np.linspace(0.0, 1.0, math.ceil(range_m / imagined.voxel_m))
    points = at[k, None] + steps[:, None] * away[k, f, None]
    index = np.floor((points - imagined.origin_enu_m) / imagined.voxel_m).astype(np.int64)
    index = np.clip(index, 0, np.array(imagined.occupancy.shape) - 1)
    passing = np.log1p(-np.minimum(imagined.occupancy[tuple(np.moveaxis(index, -1, 0))], SOLID))
    clear = passing.mean(axis=-1) * length[k, f] / imagined.voxel_m > math.log(CLEAR_ENOUGH)
    k, f = k[clear], f[clear]
    result = np.zeros((len(at), len(lattice.yaw_enu_rad), len(opened)), dtype=np.bool_)
    result[k, :, f] = in_view(away[k, f], lattice.yaw_enu_rad, lattice.elevation_rad, camera)
    return result


def _largest(worth: Array, count: int) -> Indices:
    """(n,) numbers of the largest that are not nothing."""
    order = np.argsort(-worth, kind="stable")[:count]
    result: Indices = order[worth[order] > 0.0]
    return result


def _union(numbers: Iterable[Indices]) -> Indices:
    """All of them in ascending order."""
    return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *numbers]))
