"""What a method knows of the space around the lattice: the voxel map from plane-sweep depth, and where it may fly.

Depth and map are tuned for a sensing range of about 25 m. A trial's scene may be a chapel or a power station, so the
map is kept in units of its own, in which the trial's sensing range measures 25: every pose is scaled on its way in.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
from numba import get_num_threads
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ground_station.nbv.wires import Wires
from missions.camera import Pose
from missions.frames import Array
from missions.grid import UNKNOWN, SurfaceVoxels, VoxelGrid
from missions.nbv_trial import Frame, TrialBrief
from missions.pose_lattice import AXIS_STEPS, Index5, Indices, PoseLattice
from perception.depth.depth_map import Image
from perception.depth.plane_sweep import SweepSettings
from perception.mapping.explorer_map import ExplorerMap
from perception.mapping.line_votes import UNHIDDEN
from perception.mapping.voxel_map import MapSettings

RANGE = 25.0
"""The sensing range in the map's units."""
VOXEL = 0.5
SWEEP = SweepSettings(shrink=3, planes=80)
"""A third of the time of the default sweep; which views to take hardly depends on the difference."""
MEASURED = 0.1
"""Error of the measured places of surface that is allowed for."""
SLIVER = 0.1 * VOXEL
"""Voxels into which the object's box reaches no farther than this hold nothing of it: its ends are not known better,
and every leg outwards would wait until a layer of such voxels was seen."""
RIM = 3.0
"""How far the map reaches beyond lattice and object."""


class Explored:
    """The map of one trial, in map units (`scale` of them per metre)."""

    def __init__(self, brief: TrialBrief) -> None:
        self.scale = RANGE / brief.sensing_range_m
        self.lattice = _scaled_lattice(brief.lattice, self.scale)
        self.object_min, self.object_max = (self.scale * np.array(corner)
                                            for corner in (brief.object_min_enu_m, brief.object_max_enu_m))
        self.ground_up = self.scale * brief.ground_up_m
        self.clearance, self.radius = self.scale * brief.fleet.clearance_m, self.scale * brief.fleet.radius_m
        lower = np.minimum(self.object_min, self.lattice.lower_enu_m) - RIM
        upper = np.maximum(self.object_max, self.lattice.upper_enu_m) + RIM
        self._camera = brief.camera
        self._map = ExplorerMap(lower, upper, VOXEL, self.radius, MapSettings(sensing_range_m=RANGE), SWEEP,
                                workers=get_num_threads())
        for start in brief.starts:
            at = np.array(self.pose(start).position_enu_m)
            self._map.mark_free(at - self.clearance / math.sqrt(3.0), at + self.clearance / math.sqrt(3.0))
        self.grid: VoxelGrid = self._map.grid()
        self._stale = False
        self._wires, self._clearance_m = Wires(brief), brief.fleet.clearance_m
        self._at: dict[int, int] = {}
        """Position by flat number where each vehicle was last."""
        self._flown = np.zeros((len(self.lattice.positions_enu_m), len(AXIS_STEPS)), dtype=np.bool_)

    def see(self, frame: Frame) -> None:
        """Take a picture in."""
        self._map.add_picture(frame.rgb, self._camera, self.scaled(frame.pose))
        self._wires.see(frame)
        self._stale = True
        if frame.vehicle not in self._at:  # its first picture is from where it comes to its start
            away = np.linalg.norm(self.lattice.positions_enu_m - self.scaled(frame.pose).position_enu_m, axis=1)
            self._at[frame.vehicle] = int(away.argmin())
        if frame.index is not None:
            self._wires.was_at(np.array(frame.pose.position_enu_m), self._clearance_m)
            there = self.lattice.flat(frame.index) // self.lattice.orientations
            self._flew(self._at[frame.vehicle], there)
            self._at[frame.vehicle] = there

    def _flew(self, start: int, end: int) -> None:
        """A leg that was flown is open, whatever a stray depth says: a vehicle can always go back as it came."""
        a, b = (np.stack(np.unravel_index(at, self.lattice.shape)) for at in (start, end))
        step = tuple((b - a).tolist())
        if step in AXIS_STEPS:
            along = AXIS_STEPS.index(step)
            self._flown[start, along] = self._flown[end, along ^ 1] = True

    def refresh(self) -> None:
        """Bring the map up to date with the pictures."""
        if self._stale:
            self._map.update()
            self._wires.update(self._surface_m)
            self.grid = self._map.grid()
            self._stale = False

    def _surface_m(self, picture: int) -> Image:
        """(h, w) how deep a picture shows, in metres; inf where that is not known."""
        depth = self._map.depth(picture)
        return UNHIDDEN if depth is None else np.where(depth.valid, depth.depth_m / np.float32(self.scale), np.inf)

    def pose(self, index: Index5) -> Pose:
        """A view of the lattice, in map units."""
        return self.lattice.pose(index)

    def scaled(self, pose: Pose) -> Pose:
        """A pose given in metres, in map units."""
        x, y, z = pose.position_enu_m
        return Pose((x * self.scale, y * self.scale, z * self.scale), pose.yaw_enu_rad, pose.elevation_rad)

    @property
    def surface(self) -> SurfaceVoxels:
        """Known surface."""
        return self._map.surface()

    def inside_object_box(self) -> tuple[slice, ...]:
        """The part of the grid that the object's box reaches into."""
        low = np.maximum(self.grid.index(self.object_min + SLIVER), 0)
        high = self.grid.index(self.object_max - SLIVER) + 1
        return tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))

    def open_edges(self) -> NDArray[np.bool_]:
        """(p, 6) lattice steps between positions that keep the clearance from all that was measured, and that pass it
        by twice the vehicle's radius at least, where no wire shows; and those that were flown. What is likelier stray
        depth is only not to be touched."""
        points, adrift = self._map.surface_points(), self._map.adrift()
        solid, stray = cKDTree(points[~adrift]), cKDTree(points[adrift])
        reach = self.clearance + MEASURED
        passing = min(2.0 * self.radius + MEASURED, reach)
        touching = min(self.radius + VOXEL / 2.0 + MEASURED, passing)

        def is_open(along: Array) -> NDArray[np.bool_]:
            near, _ = solid.query(along, distance_upper_bound=reach)
            touched, _ = stray.query(along, distance_upper_bound=touching)
            result: NDArray[np.bool_] = np.isinf(near[[0, -1]]).all(axis=0) & (near >= passing).all(axis=0)
            result &= np.isinf(touched).all(axis=0)
            return result

        return (self._edges(is_open) & self._wires.clear_edges()) | self._flown

    def known_free_edges(self) -> NDArray[np.bool_]:
        """(p, 6) lattice steps along which all that the vehicle's body sweeps of the object's box was seen to be free,
        and from so near that wires would have shown; or that were flown. Unknown space elsewhere is taken for free: the
        object is not there."""
        holds = box_counter(self._unknown())

        def is_free(along: Array) -> NDArray[np.bool_]:
            ends = along[[0, -1]]
            swept = ends.min(axis=0) - self.radius, ends.max(axis=0) + self.radius
            result: NDArray[np.bool_] = holds(self.grid.index(swept[0]), self.grid.index(swept[1]) + 1) == 0
            return result

        return (self._edges(is_free) & self._wires.looked_at_edges()) | self._flown

    def not_known_free(self, a: int, b: int) -> Array:
        """(n, 3) places that must be looked at before the leg between two positions can be in `known_free_edges`."""
        ends = self.lattice.positions_enu_m[[a, b]]
        first = np.maximum(self.grid.index(ends.min(axis=0) - self.radius), 0)
        swept = tuple(slice(int(low), int(high) + 1)
                      for low, high in zip(first, self.grid.index(ends.max(axis=0) + self.radius), strict=True))
        return np.concatenate([self.grid.centers(np.argwhere(self._unknown()[swept]) + first),
                               self.scale * self._wires.not_looked_at(a, b)])

    def _unknown(self) -> NDArray[np.bool_]:
        """(i, j, k) voxels of the object's box of which nothing is known."""
        unknown, box = np.zeros(self.grid.state.shape, dtype=np.bool_), self.inside_object_box()
        unknown[box] = self.grid.state[box] == UNKNOWN
        return unknown

    def _edges(self, is_open: Callable[[Array], NDArray[np.bool_]]) -> NDArray[np.bool_]:
        """(p, 6) lattice steps that are open; is_open: which of e legs are, from points (s, e, 3) along them."""
        edges = np.zeros((len(self.lattice.positions_enu_m), len(AXIS_STEPS)), dtype=np.bool_)
        for axis in range(3):
            a, b = self.lattice.legs(axis)
            if len(a):
                open_ = is_open(self._along(a, b))
                edges[b[open_], 2 * axis] = edges[a[open_], 2 * axis + 1] = True
        return edges

    def _along(self, a: Indices, b: Indices) -> Array:
        """(s, e, 3) points on the legs between positions (e,) each."""
        start, end = self.lattice.positions_enu_m[a], self.lattice.positions_enu_m[b]
        samples = 2 + int(np.linalg.norm(end - start, axis=1).max(initial=0.0) / VOXEL)
        return start + np.linspace(0.0, 1.0, samples)[:, None, None] * (end - start)


def box_counter(voxels: NDArray[np.bool_]) -> Callable[[Indices, Indices], Indices]:
    """A function that counts the true ones in boxes from voxels (n, 3) to before voxels (n, 3), from a summed table."""
    table = np.pad(voxels.astype(np.int64).cumsum(axis=0).cumsum(axis=1).cumsum(axis=2), ((1, 0),) * 3)

    def count(first: Indices, end: Indices) -> Indices:
        corners = np.clip(np.stack([first, end]), 0, np.array(voxels.shape))
        total = np.zeros(len(first), dtype=np.int64)
        for i, j, k in itertools.product((0, 1), repeat=3):
            at = corners[i, :, 0], corners[j, :, 1], corners[k, :, 2]
            total += (-1) ** (i + j + k + 1) * table[at]
        return total

    return count


def _scaled_lattice(lattice: PoseLattice, scale: float) -> PoseLattice:
    (a, b, c), (d, e, f) = lattice.lower_enu_m, lattice.upper_enu_m
    return PoseLattice((a * scale, b * scale, c * scale), (d * scale, e * scale, f * scale), lattice.shape,
                       lattice.elevations_deg, lattice.azimuths)
