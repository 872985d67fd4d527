"""Greedy choice of survey views, compiled: after each choice only the sightings of the patches it shows are valued
anew. Every sum goes in a fixed order; ties go to the earlier position, then the earlier orientation."""
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from planning.nbv.rays import first_hit

Rows = NDArray[np.int64]
PARALLAX_KEPT = 8
"""Pictures per patch whose directions are remembered for parallax."""
SPARE_WORTH = 0.1
"""What a picture counts beyond those that a patch needs: enough to break ties, too little to leave another patch
without its third."""


class Sight(NamedTuple):
    """s sightings, each of a patch from a position, sorted by patch, then position."""

    patch: Rows
    position: Rows
    towards_position_enu: Array
    """(s, 3) unit."""
    quality: Array
    direction_bin: Rows
    """(s,) of the direction from the position to the patch."""
    first_of_patch: Rows
    """(k + 1,) where each patch's sightings begin."""
    by_position: Rows
    """(s,) sightings sorted by position."""
    first_of_position: Rows
    """(n + 1,) where each position's begin in by_position."""
    first_view: Rows
    """(b + 1,) where the orientations that show each bin of directions begin in `views`."""
    views: Rows


class Want(NamedTuple):
    """What patches want."""

    pictures: int
    goal: int
    """Pictures beyond which another one is worth nothing."""
    near: float
    far: float
    """Cosines of the smallest and the largest useful parallax."""


class Known(NamedTuple):
    """What a picture must hold of known surface, whatever surface that is."""

    state: NDArray[np.uint8]
    """(x, y, z) of the map."""
    occupied: int
    eyes: Array
    """(n, 3) positions, in voxels."""
    rays_enu: Array
    """(o, r, 3) unit directions, spread evenly over the picture of each orientation."""
    reach: float
    """Voxels."""
    least: int
    """Rays that must end at an occupied voxel."""


class Tally(NamedTuple):
    """How things stand after some views; changed in place."""

    pictures: Rows
    """(k,) pictures that show each patch."""
    paired: Rows
    """(k,) of these, pictures with useful parallax to an earlier one."""
    towards_enu: Array
    """(k, PARALLAX_KEPT, 3) unit directions to the first pictures of each patch."""
    value: Array
    """(s,) what each sighting would add."""
    gains: Array
    """(n, o) what each view would add."""


@nb.njit(cache=True)
def worth(had, want, others, towards):
    """Worth of one more picture at full resolution of a patch that has `had`, by its best parallax to those.

    The first counts 1, each further one 0.9 of the one before, spare ones a tenth; without useful parallax a fifth of
    that or less.
    """
    if had >= want.goal:
        return 0.0
    if had == 0:
        return 1.0
    best = 0.05
    for d in range(min(had, len(others))):
        cosine = others[d, 0] * towards[0] + others[d, 1] * towards[1] + others[d, 2] * towards[2]
        if want.far <= cosine <= want.near:
            best = 1.0
        elif cosine < want.far:
            best = max(best, 0.2)
    return (0.9**had if had < want.pictures else SPARE_WORTH) * best


@nb.njit(cache=True)
def _change(sight, tally, s, value):
    """A sighting adds so much from now on; the gains of the views that show it follow."""
    change = value - tally.value[s]
    tally.value[s] = value
    if change != 0.0 and sight.position[s] < len(tally.gains):
        for at in range(sight.first_view[sight.direction_bin[s]], sight.first_view[sight.direction_bin[s] + 1]):
            tally.gains[sight.position[s], sight.views[at]] += change


@nb.njit(cache=True)
def take(sight, want, tally, position, shown):
    """A picture from a position, in which the bins of directions `shown` lie, is taken."""
    for at in range(sight.first_of_position[position], sight.first_of_position[position + 1]):
        s = sight.by_position[at]
        if not shown[sight.direction_bin[s]]:
            continue
        k, towards = sight.patch[s], sight.towards_position_enu[s]
        had, others = tally.pictures[k], tally.towards_enu[k]
        if had > 0 and worth(1, want, others[:had], towards) > 0.5:
            tally.paired[k] += 1
        if had < PARALLAX_KEPT:
            others[had] = towards
        tally.pictures[k] += 1
        for other in range(sight.first_of_patch[k], sight.first_of_patch[k + 1]):
            _change(sight, tally, other, sight.quality[other] *
                    worth(tally.pictures[k], want, others, sight.towards_position_enu[other]))


@nb.njit(cache=True)
def begin(sight, tally):
    """Before any picture every sighting adds its quality."""
    for s in range(len(sight.patch)):
        _change(sight, tally, s, sight.quality[s])


@nb.njit(cache=True)
def _holds_enough(known, position, orientation):
    """Whether a view holds as much known surface as asked for."""
    ends = 0
    for r in range(known.rays_enu.shape[1]):
        ray = known.rays_enu[orientation, r]
        ends += first_hit(known.state, known.occupied, known.eyes[position], ray, known.reach) < known.reach
        if ends >= known.least:
            return True
    return known.least == 0


@nb.njit(cache=True)
def _best(tally, away, near_m, thrift, least, barred):
    """Position and orientation of the view with the greatest gain for its way; -1 where none gains `least`."""
    best, p, o = 0.0, -1, -1
    for i in range(len(tally.gains)):
        ease = 1.0 if away[i] == np.inf else max(near_m, away[i]) ** -thrift
        for j in range(tally.gains.shape[1]):
            if tally.gains[i, j] >= least and tally.gains[i, j] * ease > best and not barred[i, j]:
                best, p, o = tally.gains[i, j] * ease, i, j
    return p, o


@nb.njit(cache=True)
def choose(sight, want, known, tally, shows, places, near_m, thrift, max_views, least):
    """(m, 2) position and orientation of at most max_views views, each the one with the greatest gain per
    max(near_m, way from the nearest chosen view) ** thrift among those that hold enough known surface, until none gains
    `least`. shows: (o, b) bins in each view.
    """
    chosen = np.zeros((max_views, 2), dtype=np.int64)
    away, barred, n = np.full(len(tally.gains), np.inf), np.zeros(tally.gains.shape, dtype=np.bool_), 0
    while n < max_views:
        p, o = _best(tally, away, near_m, thrift, least, barred)
        if p < 0:
            break
        if not _holds_enough(known, p, o):
            barred[p, o] = True
            continue
        chosen[n, 0], chosen[n, 1] = p, o
        n += 1
        for i in range(len(away)):
            away[i] = min(away[i], np.linalg.norm(places[i] - places[p]))
        take(sight, want, tally, p, shows[o])
    return chosen[:n]
