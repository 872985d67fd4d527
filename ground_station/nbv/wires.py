"""Where between the lattice's positions a wire may be strung, as far as the pictures show."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import get_num_threads
from numpy.typing import NDArray

from missions.frames import Array
from missions.nbv_trial import Frame, TrialBrief
from missions.pose_lattice import AXIS_STEPS, PoseLattice
from perception.depth.depth_map import Image
from perception.mapping.line_votes import UNHIDDEN, WIRE_M, Lines, LineVotes

LEAST_PX = 0.15
"""Pictures vote on places where a wire of WIRE_M is at least so wide."""
SPACING_M = 0.25
STRUNG, NONE_STRUNG = 8.0, -2.5
"""Above this logarithm of the odds at any place that the body sweeps there is a wire, below that at all of them there
is none. Between them nobody knows, and a leg is not flown either ..."""
LEAST_LOOKS, HARDLY = 8, 3.0
"""... but where the pictures of two steps from nearby leave the odds below this: most places are on no wire."""
TOO_NEAR, TOO_NEAR_SHARE = 20.0, 0.75
"""Above this logarithm of the odds at any place within this share of the clearance nobody stands at a position. It is
higher than STRUNG, for a vehicle that stands there is safe, only too near to be let fly; and a line is found within a
quarter of a metre of where it is."""


class Wires:
    """Votes on what a vehicle would sweep of the object's box; there is no wire of the object anywhere else."""

    def __init__(self, brief: TrialBrief) -> None:
        self._lattice, self._camera = brief.lattice, brief.camera
        low, high = (np.array(corner) for corner in (brief.object_min_enu_m, brief.object_max_enu_m))
        self._legs = [_swept(self._lattice, axis, low - brief.fleet.radius_m, high + brief.fleet.radius_m)
                      for axis in range(3)]
        around, self._owner = _around(self._lattice, TOO_NEAR_SHARE * brief.fleet.clearance_m, low, high)
        reach_m = min(WIRE_M * brief.camera.fx_px / LEAST_PX, brief.sensing_range_m)
        self._votes = LineVotes(np.concatenate([points for points, _ in self._legs]), reach_m)
        self._around = LineVotes(around, reach_m)
        self._workers, self._new, self._voted = ThreadPoolExecutor(get_num_threads()), list[Frame](), 0
        self._stood = np.zeros(len(self._votes.points_enu_m), dtype=np.bool_)

    def see(self, frame: Frame) -> None:
        """Take a picture in; it has no vote before `update`."""
        self._new.append(frame)

    def update(self, surface_m: Callable[[int], Image] = lambda _: UNHIDDEN) -> None:
        """Every new picture votes. surface_m: how deep the n-th picture shows, as `LineVotes` takes it."""
        lines = self._workers.map(lambda frame: Lines.of(frame.rgb), self._new)
        for n, (frame, found) in enumerate(zip(self._new, lines, strict=True), self._voted):
            for votes in (self._votes, self._around):
                votes.add(found, self._camera, frame.pose, surface_m(n))
        self._voted += len(self._new)
        self._new.clear()

    def was_at(self, position_enu_m: Array, clearance_m: float) -> None:
        """A vehicle stood at (3,): there is nothing so near to it, and no picture needs to say so."""
        self._stood |= np.linalg.norm(self._votes.points_enu_m - position_enu_m, axis=1) <= clearance_m

    def clear_edges(self) -> NDArray[np.bool_]:
        """(p, 6) lattice steps where no wire shows in the pictures, neither on the way nor near its ends."""
        ends, standable = self._lattice.leg_ends, self._standable()
        result: NDArray[np.bool_] = self._edges(self._stood | (self._votes.log_odds <= STRUNG))
        return result & standable[:, None] & standable[ends]

    def _standable(self) -> NDArray[np.bool_]:
        """(p,) positions that no wire shows near to."""
        result = np.ones(len(self._lattice.positions_enu_m), dtype=np.bool_)
        result[self._owner[self._around.log_odds > TOO_NEAR]] = False
        return result

    def looked_at_edges(self) -> NDArray[np.bool_]:
        """(p, 6) lattice steps where wires would show, and none does."""
        return self._edges(self._looked_at)

    def not_looked_at(self, a: int, b: int) -> Array:
        """(n, 3) places on the leg between two positions where a wire would not show yet."""
        begin = 0
        for axis, (points, leg) in enumerate(self._legs):
            start, end = self._lattice.legs(axis)
            between = (start == min(a, b)) & (end == max(a, b))
            if between.any():
                here: Array = points[between[leg] & ~self._looked_at[begin:begin + len(points)]]
                return here
            begin += len(points)
        return np.zeros((0, 3))

    @property
    def _looked_at(self) -> NDArray[np.bool_]:
        odds = self._votes.log_odds
        looked_at = (self._votes.looks >= LEAST_LOOKS) & (odds <= HARDLY)
        result: NDArray[np.bool_] = self._stood | (odds <= NONE_STRUNG) | looked_at
        return result

    def _edges(self, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(p, 6) steps all of whose points are good (n,)."""
        edges = np.zeros((len(self._lattice.positions_enu_m), len(AXIS_STEPS)), dtype=np.bool_)
        begin = 0
        for axis, (points, leg) in enumerate(self._legs):
            a, b = self._lattice.legs(axis)
            bad = np.bincount(leg, ~good[begin:begin + len(points)], len(a)) > 0
            edges[b[~bad], 2 * axis] = edges[a[~bad], 2 * axis + 1] = True
            begin += len(points)
        return edges


def _swept(lattice: PoseLattice, axis: int, low: Array, high: Array) -> tuple[Array, NDArray[np.int64]]:
    """(n, 3) points SPACING_M apart in the tubes that vehicles sweep along the legs of an axis, inside a box, and (n,)
    the leg of each."""
    a, b = lattice.legs(axis)
    start, end = lattice.positions_enu_m[a], lattice.positions_enu_m[b]
    samples = 1 + math.ceil(np.linalg.norm(end - start, axis=1).max(initial=0.0) / SPACING_M)
    along = start[:, None] + np.linspace(0.0, 1.0, samples)[:, None] * (end - start)[:, None]
    across = _cube(1)
    return _inside(along[:, :, None] + across[across[:, axis] == 0.0], low, high)


def _around(lattice: PoseLattice, radius_m: float, low: Array, high: Array) -> tuple[Array, NDArray[np.int64]]:
    """(n, 3) points SPACING_M apart, and no farther than a radius from positions, inside a box, and (n,) the position
    of each."""
    ball = _cube(math.floor(radius_m / SPACING_M))
    return _inside(lattice.positions_enu_m[:, None] + ball[np.linalg.norm(ball, axis=1) <= radius_m], low, high)


def _cube(rings: int) -> Array:
    """(n, 3) offsets SPACING_M apart, so many to each side of the middle."""
    side = SPACING_M * np.arange(-rings, rings + 1.0)
    return np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)


def _inside(points: Array, low: Array, high: Array) -> tuple[Array, NDArray[np.int64]]:
    """(n, 3) those of points (m, ..., 3) that lie in a box, and (n,) which of the m each belongs to."""
    inside = ((points > low) & (points < high)).all(axis=-1)
    return points[inside], np.nonzero(inside)[0]
