"""What any method must beat: a random walk, frontier exploration, and the gain of unknown voxels along rays.

All three see the world through the same voxel map from plane-sweep depth as the default method, and step only where
that map shows nothing in the way.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ground_station.nbv.explored import RANGE, VOXEL, Explored
from missions.frames import Array
from missions.grid import FREE, OCCUPIED, UNKNOWN
from missions.nbv_trial import Choice, Frame, TrialBrief
from missions.pose_lattice import UNREACHED, Index5, Indices, fewest_steps, way_back
from missions.sensors import fibonacci_directions
from planning.nbv.lattice import in_view
from planning.nbv.rays import first_hits, view_gains


class _MapWalker:
    """Common to all: the map, the step that keeps clear of what it shows, no view twice where that can be helped."""

    def __init__(self, brief: TrialBrief) -> None:
        self.brief, self.lattice = brief, brief.lattice
        self.explored = Explored(brief)
        self.random = np.random.default_rng(brief.seed)
        self.at = {vehicle: self.lattice.flat(start) for vehicle, start in enumerate(brief.starts, 1)}
        self.came_from = dict(self.at)
        self.visited = set(self.at.values())

    def see(self, frame: Frame) -> None:
        """Takes a picture in."""
        self.explored.see(frame)

    def choose(self, vehicle: int, candidates: list[Index5]) -> Choice:
        """The step that the method prefers among those that are clear by the map; back where none is."""
        self.explored.refresh()
        here, steps = self.at[vehicle], self.lattice.steps_along(self.explored.open_edges())
        given = [self.lattice.flat(c) for c in candidates]
        clear = [n for n in given if n in steps[here]] or self._retreat(vehicle, given)
        fresh = np.array([n for n in clear if n not in self.visited] or clear)
        chosen, gain = self.prefer(here, fresh, steps)
        self.came_from[vehicle], self.at[vehicle] = here, chosen
        self.visited.add(chosen)
        return Choice(vehicle=vehicle, index=self.lattice.index(chosen), predicted_gain=gain)

    @abstractmethod
    def prefer(self, here: int, options: Indices, steps: Indices) -> tuple[int, float]:
        """One of the options (k,), flat numbers, and the gain that is expected of it. steps: all that are clear."""

    def _retreat(self, vehicle: int, given: list[int]) -> list[int]:
        """Steps to the position that the vehicle came from, where it was free."""
        back = self.came_from[vehicle] // self.lattice.orientations
        return [n for n in given if n // self.lattice.orientations == back] or given


class RandomWalk(_MapWalker):
    """Any clear step to a view not visited yet, as the baseline of MACARONS' successors (MAGICIAN, CVPR 2026)."""

    def prefer(self, here: int, options: Indices, steps: Indices) -> tuple[int, float]:
        """One of them at random."""
        return int(self.random.choice(options)), 0.0


class Frontier(_MapWalker):
    """Yamauchi, "A frontier-based approach for autonomous exploration", CIRA 1997: go to the nearest frontier.

    Frontier are the unknown voxels of the object's box that touch free space; the nearest is that which is in view
    from a lattice pose fewest steps away, of equally near poses that with most frontier in view.
    """

    LEAST = 8
    """Frontier voxels that make a view worth going to; fewer are noise of the map."""
    MOST = 600
    """Frontier voxels that are considered, evenly thinned out."""

    def prefer(self, here: int, options: Indices, steps: Indices) -> tuple[int, float]:
        """The first step of the way to the nearest frontier; at random where there is none."""
        distance = fewest_steps(steps, here)
        goal = self._nearest_view(distance)
        first = way_back(steps, distance, goal)[0] if goal is not None else None
        if first is not None and first in options:
            return first, 0.0
        return int(self.random.choice(options)), 0.0

    def _nearest_view(self, distance: Indices) -> int | None:
        """Of the poses at these distances (n,) the nearest with frontier in view."""
        frontier, found, best = self._frontier(), None, (np.inf, 0)
        by_position = np.where(distance == UNREACHED, np.inf, distance).reshape(-1, self.lattice.orientations)
        nearest = by_position.min(axis=1)
        for p in np.argsort(nearest, kind="stable"):
            if nearest[p] > best[0] or np.isinf(nearest[p]):
                break
            counts = self._in_view(int(p), frontier)
            for o in np.flatnonzero((counts >= self.LEAST) & (by_position[p] > 0)):
                if (rank := (float(by_position[p, o]), -int(counts[o]))) < best:
                    best, found = rank, int(p) * self.lattice.orientations + int(o)
        return found

    def _frontier(self) -> Array:
        """(f, 3) middles of frontier voxels."""
        grid, box = self.explored.grid, self.explored.inside_object_box()
        edge = np.zeros(grid.state.shape, dtype=np.bool_)
        edge[box] = ((grid.state == UNKNOWN) & ndimage.binary_dilation(grid.state == FREE))[box]
        found = grid.centers(np.argwhere(edge))
        return found[::max(1, len(found) // self.MOST)]

    def _in_view(self, position: int, frontier: Array) -> NDArray[np.int64]:
        """(o,) how many frontier points each view at a position shows over free space."""
        grid, eye = self.explored.grid, self.explored.lattice.positions_enu_m[position]
        away = frontier - eye
        length = np.linalg.norm(away, axis=1)
        away = away[(length < RANGE) & (length > VOXEL)] / length[(length < RANGE) & (length > VOXEL), None]
        length = length[(length < RANGE) & (length > VOXEL)]
        barrier = (grid.state != FREE).astype(np.uint8)
        reached = VOXEL * first_hits(barrier, 1, (eye - grid.origin_enu_m) / VOXEL, away, RANGE / VOXEL)
        clear = reached > length - VOXEL
        yaw, elevation = self.lattice.yaw_elevation_rad.T
        result: NDArray[np.int64] = in_view(away[clear], yaw, elevation, self.brief.camera).sum(axis=0)
        return result


class Volumetric(_MapWalker):
    """Occlusion-aware volumetric gain: over all rays of a view the unknown voxels of the object's box, each by the
    chance that the ray gets there, as in Isler et al. (ICRA 2016) and Delmerico et al. (Autonomous Robots 2018).

    Takes the neighbour with the greatest gain, as they do.
    """

    RAYS = 2048
    """Over the whole sphere; a picture takes about 300 of them."""
    SPACE, UNKNOWN_INSIDE, UNKNOWN_OUTSIDE, SOLID = range(4)
    CHANCE = np.array([0.0, 0.5, 0.5, 1.0])
    """Of stopping a ray: their prior of an unknown voxel is one half."""
    VALUE = np.array([0.0, 2.0, 0.0, 0.0])
    """One for every unknown voxel that is reached: chance x value."""

    def __init__(self, brief: TrialBrief) -> None:
        super().__init__(brief)
        self.directions = fibonacci_directions(self.RAYS)
        yaw, elevation = self.lattice.yaw_elevation_rad.T
        self.seen = in_view(self.directions, yaw, elevation, brief.camera)

    def prefer(self, here: int, options: Indices, steps: Indices) -> tuple[int, float]:
        """The option with the greatest gain; of equals at random."""
        positions, where = np.unique(options // self.lattice.orientations, return_inverse=True)
        gain = self._gains(positions)[where, options % self.lattice.orientations]
        return int(self.random.choice(options[gain == gain.max()])), float(gain.max())

    def _gains(self, positions: Indices) -> Array:
        """(p, o) expected unknown voxels along the rays of every view at some positions."""
        explored, grid = self.explored, self.explored.grid
        label = np.full(grid.state.shape, self.UNKNOWN_OUTSIDE, dtype=np.uint8)
        label[explored.inside_object_box()] = self.UNKNOWN_INSIDE
        label[grid.state == FREE], label[grid.state == OCCUPIED] = self.SPACE, self.SOLID
        first = np.concatenate([[0], np.cumsum(self.seen.sum(axis=1))])
        starts = (explored.lattice.positions_enu_m[positions] - grid.origin_enu_m) / VOXEL
        box = [(corner - grid.origin_enu_m) / VOXEL for corner in (explored.object_min, explored.object_max)]
        result: Array = view_gains(label, self.CHANCE, self.VALUE, starts, self.directions, *box, RANGE / VOXEL, 1.0,
                                   first, np.nonzero(self.seen)[1], self.seen.shape[1])
        return result
