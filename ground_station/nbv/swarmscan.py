"""The default method: imagine what is not seen yet, and plan several steps over what views of it would show.

A small network imagines the occupancy of unknown voxels from the map (perception.imagination); a view is worth the
surface it is expected to show that no view before it has shown; the way with the best discounted sum is begun, and
planned anew after every step (MAGICIAN, Li et al., CVPR 2026, showed that the planner is what decides). With several
vehicles each plans on what the plans of the others leave to see.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from ground_station.nbv.explored import RANGE, VOXEL, Explored
from ground_station.nbv.hopes import Hopes
from ground_station.nbv.look_out import LookOut
from ground_station.nbv.options import options_of
from missions.frames import Array
from missions.nbv_trial import Choice, Frame, TrialBrief
from missions.pose_lattice import Index5
from perception.imagination.adapt import make_imagination
from planning.nbv.coverage import SurfaceTally, surface_tally
from planning.nbv.horizon import HorizonSpec, Way, best_way, promises
from planning.nbv.shown import ShownFaces
from planning.nbv.sights import ImaginedMap, Orientations, Sights, sights
from planning.nbv.stopping import Price, Returns, pays

BLOCKED = 1e-3
SHOWN_RAYS_ACROSS = 120
SHUT_IN = 0.5
"""A vehicle is shut in when the best that it surely reaches is worth less than this share of the best that it may."""


class SwarmscanOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What `--option NAME=VALUE` can change."""

    adapt: bool = False
    """Imagination learns in flight from what its map has come to know."""


@dataclass(frozen=True)
class _Reckoned:
    """What follows from the pictures so far: once for all vehicles that are asked after the same ones."""

    tally: SurfaceTally
    sights: Sights
    open_edges: NDArray[np.bool_]
    known_free_edges: NDArray[np.bool_]


class Swarmscan:
    """See the module."""

    def __init__(self, brief: TrialBrief) -> None:
        """Raises UserError for options that it does not have."""
        options = options_of(brief, SwarmscanOptions)
        self._lattice, self._camera = brief.lattice, brief.camera
        self._explored, self._hopes = Explored(brief), Hopes(brief.lattice)
        self._look_out = LookOut(self._explored.lattice, brief.camera)
        self._imagination, self._spec = make_imagination(options.adapt), HorizonSpec()
        self._at = {vehicle: self._lattice.flat(start) for vehicle, start in enumerate(brief.starts, 1)}
        self._visited = set(self._at.values())
        self._plans: dict[int, list[int]] = {}
        yaw, elevation = self._lattice.yaw_elevation_rad.T
        self._orientations = Orientations.of(yaw, elevation, brief.camera)
        rows = math.ceil(SHOWN_RAYS_ACROSS * brief.camera.height_px / brief.camera.width_px)
        self._shown = ShownFaces(brief.camera.scaled(SHOWN_RAYS_ACROSS, rows), RANGE)
        self._returns, self._price = Returns(), Price()
        self._latest: _Reckoned | None = None

    def see(self, frame: Frame) -> None:
        """Takes a picture in."""
        self._explored.see(frame)
        self._latest = None
        if frame.index is not None:
            self._shown.add(self._explored.pose(frame.index))

    def choose(self, vehicle: int, candidates: list[Index5]) -> Choice:
        """The first step of the best way; the vehicle waits while others block all that are known to be clear."""
        now = self._reckoned()
        tally, way = now.tally, self._plan(vehicle, candidates, now)
        if way is None:
            return Choice(vehicle=vehicle, index=self._lattice.index(self._at[vehicle]),
                          coverage_estimate=tally.coverage)
        legs = self._legs(self._at[vehicle], way.poses)
        expected = self._returns.expected_m2_per_m(way.gains_m2, legs)
        self._returns.promise(way.gains_m2[0], legs[0])
        self._plans[vehicle], self._at[vehicle] = way.poses, way.poses[0]
        self._visited.add(way.poses[0])
        return Choice(vehicle=vehicle, index=self._lattice.index(way.poses[0]),
                      predicted_gain=way.gains_m2[0] / self._explored.scale**2, coverage_estimate=tally.coverage,
                      stop=not pays(expected, self._returns, tally.coverage, self._price))

    def _reckoned(self) -> _Reckoned:
        if self._latest is None:
            self._explored.refresh()
            imagined, positions = self._imagined(), self._explored.lattice.positions_enu_m
            tally = surface_tally(imagined, self._explored.inside_object_box(), positions, RANGE)
            self._returns.settle(tally.seen_m2)
            self._latest = _Reckoned(tally, sights(imagined, positions, self._orientations, RANGE),
                                     self._explored.open_edges(), self._explored.known_free_edges())
        return self._latest

    def _legs(self, start: int, poses: list[int]) -> list[float]:
        """Lengths of the steps of a way, in map units."""
        at = self._explored.lattice.positions_enu_m[np.array([start, *poses]) // self._lattice.orientations]
        return [float(leg) for leg in np.linalg.norm(np.diff(at, axis=0), axis=1)]

    def _imagined(self) -> ImaginedMap:
        """The object as the network imagines it, with what the key poses so far have shown."""
        explored = self._explored
        occupancy = self._imagination.occupancy(explored.grid, explored.object_min, explored.object_max,
                                                explored.ground_up)
        imagined = ImaginedMap.new(explored.grid.origin_enu_m, VOXEL, occupancy, explored.inside_object_box())
        self._shown.take_out(imagined)
        return imagined

    def _plan(self, vehicle: int, candidates: list[Index5], now: _Reckoned) -> Way | None:
        """The best way over what the other vehicles' plans leave to see; None where no step is known to be clear."""
        seen, here, lattice = now.sights, self._at[vehicle], self._lattice
        left = self._left_by_others(vehicle, seen)
        likely = self._hopes.likely(now.open_edges, now.known_free_edges)
        gains = seen.gains_after(left)

        def promised(chance: Array) -> Array:
            return promises(gains, lattice.steps, lattice.per_step(chance), self._spec)

        way = best_way(seen, left, lattice.steps, np.maximum(lattice.per_step(likely), BLOCKED), here,
                       self._first_steps(vehicle, candidates, likely, promised), promised(likely), self._spec)
        if way is not None:
            self._hopes.count_on(here, way.poses, likely)
        return way

    def _left_by_others(self, vehicle: int, seen: Sights) -> NDArray[np.float32]:
        """(cells,) what the plans of the other vehicles leave to see."""
        left = seen.nothing_shown
        for other, poses in self._plans.items():
            if other != vehicle:
                for pose in poses:
                    left = seen.left_after(*divmod(pose, self._lattice.orientations), left)
        return left

    def _first_steps(self, vehicle: int, candidates: list[Index5], likely: Array,
                     promised: Callable[[Array], Array]) -> list[int]:
        """Candidates that are known to be clear: the new ones where there are any; for a vehicle that is shut in the
        one that looks for a way out. Back along the leg that it came by a vehicle can always go.

        promised: (n,) the best that can be had from each pose when legs are open with chances (p, 6).
        """
        lattice, here = self._lattice, self._at[vehicle]
        open_ = lattice.steps[here][lattice.per_step(likely)[here] == 1.0]
        clear = [n for n in map(lattice.flat, candidates) if n in open_]
        new = [n for n in clear if n not in self._visited] or clear
        sure, open_or_unknown = likely == 1.0, likely > 0.0
        perhaps = promised(open_or_unknown.astype(np.float64))
        if promised(sure.astype(np.float64))[here] >= SHUT_IN * perhaps[here]:
            return new
        behind = perhaps.reshape(len(likely), -1).max(axis=1)
        look = self._look_out.first_step(here, sure, open_or_unknown & ~sure, behind, self._explored.not_known_free)
        return [look] if look in clear else new
