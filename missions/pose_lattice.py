"""The 5-D lattice of camera poses of MACARONS (Guedon et al., CVPR 2023): index (ix, iy, iz, ie, ia).

Positions are cell centres of a box; ie counts the elevations, ia the azimuths. One step changes exactly one of x, y, z
by one cell and at most one of elevation and azimuth by one: at most 30 neighbours. Azimuth wraps, everything else ends.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missions.camera import Pose
from missions.frames import Array, wrap_pi
from missions.mission_section import Point

Index5 = tuple[int, int, int, int, int]
Indices = NDArray[np.int64]

AXIS_STEPS = ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1))
TURNS = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
STEPS = np.array([(*step, *turn) for step, turn in itertools.product(AXIS_STEPS, TURNS)])
"""(30, 5); step k moves along AXIS_STEPS[k // 5]."""
UNREACHED = -1


@dataclass(frozen=True)
class PoseLattice:
    """Box, cells along x, y, z, elevations and number of azimuths.

    Poses and positions also have flat numbers: those of their indices in C order.
    """

    lower_enu_m: Point
    upper_enu_m: Point
    shape: tuple[int, int, int]
    elevations_deg: tuple[float, ...]
    azimuths: int

    @property
    def shape5(self) -> Index5:
        """Extent along all five axes."""
        return (*self.shape, len(self.elevations_deg), self.azimuths)

    @property
    def orientations(self) -> int:
        """Views per position."""
        return len(self.elevations_deg) * self.azimuths

    def __len__(self) -> int:
        return math.prod(self.shape5)

    def pose(self, index: Index5) -> Pose:
        """The pose of an index. Azimuth a has yaw 2 pi a / azimuths."""
        low, high = self.lower_enu_m, self.upper_enu_m
        x, y, z = (low[a] + (index[a] + 0.5) * (high[a] - low[a]) / self.shape[a] for a in range(3))
        return Pose((x, y, z), wrap_pi(2.0 * math.pi * index[4] / self.azimuths),
                    math.radians(self.elevations_deg[index[3]]))

    def contains(self, index: Index5) -> bool:
        """Whether the lattice has this index."""
        return all(0 <= i < n for i, n in zip(index, self.shape5, strict=True))

    def flat(self, index: Index5) -> int:
        """Flat number of a pose."""
        return int(np.ravel_multi_index(index, self.shape5))

    def index(self, flat: int) -> Index5:
        """Index of a pose's flat number."""
        ix, iy, iz, ie, ia = (int(i) for i in np.unravel_index(flat, self.shape5))
        return ix, iy, iz, ie, ia

    def neighbours(self, index: Index5) -> list[Index5]:
        """At most 30, in the order of STEPS."""
        row = self.steps[self.flat(index)]
        return [self.index(int(n)) for n in row if n != UNREACHED]

    @cached_property
    def positions_enu_m(self) -> Array:
        """(p, 3) positions by flat number, as precise as in `pose`."""
        cells = np.stack(np.meshgrid(*(np.arange(n) for n in self.shape), indexing="ij"), axis=-1).reshape(-1, 3)
        low, high = np.array(self.lower_enu_m), np.array(self.upper_enu_m)
        result: Array = low + (cells + 0.5) * (high - low) / np.array(self.shape)
        return result

    @cached_property
    def yaw_elevation_rad(self) -> Array:
        """(o, 2) yaw and elevation of every orientation, azimuths fastest."""
        return np.array([(wrap_pi(2.0 * math.pi * a / self.azimuths), math.radians(e))
                         for e in self.elevations_deg for a in range(self.azimuths)])

    @cached_property
    def steps(self) -> Indices:
        """(len, 30) flat number of the pose that each of STEPS leads to, UNREACHED where the lattice ends."""
        here = np.stack(np.unravel_index(np.arange(len(self)), self.shape5), axis=-1)
        there = here[:, None] + STEPS
        there[..., 4] %= self.azimuths
        ends = (there < 0).any(axis=2) | (there >= np.array(self.shape5)).any(axis=2)
        there[ends] = 0
        return np.where(ends, UNREACHED, np.ravel_multi_index(np.moveaxis(there, -1, 0), self.shape5))

    @cached_property
    def leg_ends(self) -> Indices:
        """(p, 6) flat number of the position that each of AXIS_STEPS leads to, UNREACHED where the lattice ends."""
        straight = self.steps[::self.orientations, :: len(TURNS)]
        return np.where(straight == UNREACHED, UNREACHED, straight // self.orientations)

    def legs(self, axis: int) -> tuple[Indices, Indices]:
        """(l,) flat numbers of the positions that each leg along an axis begins at, and of those where it ends."""
        number = np.arange(math.prod(self.shape)).reshape(self.shape)
        start, end = (np.delete(number, last, axis=axis).ravel() for last in (-1, 0))
        return start, end

    def steps_along(self, open_edges: NDArray[np.bool_]) -> Indices:
        """`steps` without those that leave a position (p, 6) along an axis step that is not open."""
        return np.where(self.per_step(open_edges), self.steps, UNREACHED)

    def per_step(self, edges: NDArray[Any]) -> NDArray[Any]:
        """(len, 30) per pose and step, from (p, 6) per position and axis step."""
        return np.repeat(np.repeat(edges, self.orientations, axis=0), len(TURNS), axis=1)


def fewest_steps(steps: Indices, start: int) -> Indices:
    """(n,) least number of steps from a pose to every other along (n, 30) steps; UNREACHED where none lead."""
    distance = np.full(len(steps), UNREACHED)
    front, length = np.array([start]), 0
    while len(front):
        distance[front] = length
        length += 1
        ahead = np.unique(steps[front])
        ahead = ahead[ahead != UNREACHED]
        front = ahead[distance[ahead] == UNREACHED]
    return distance


def way_back(steps: Indices, distance: Indices, goal: int) -> list[int]:
    """A shortest way to a goal over flat numbers, the start not included, from `fewest_steps`' answer.

    Steps are their own reverse, so the way is followed backwards; of equals the first of STEPS wins.
    """
    way = [goal]
    while distance[way[-1]] > 1:
        before = steps[way[-1]]
        before = before[before != UNREACHED]
        way.append(int(before[distance[before] == distance[way[-1]] - 1][0]))
    return way[::-1]
