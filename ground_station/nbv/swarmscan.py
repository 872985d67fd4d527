"""The default method: the expected new surface of every view within reach, and the first step of the way to the best."""

from __future__ import annotations

import numpy as np

from ground_station.nbv.explored import RANGE, Explored
from missions.camera import Pose
from missions.frames import Array
from missions.nbv_trial import Choice, Frame, TrialBrief
from missions.pose_lattice import UNREACHED, Index5, Indices, fewest_steps, way_back
from planning.nbv.gain import GainField, GainSpec, count_looks, gain_field, lattice_gains, with_claims
from planning.nbv.lattice import Lattice

DECAY_PER_STEP = 0.2
"""A view this many steps farther (1 / decay) must promise e times the surface."""
RAYS = 1024
STOP_SHARE = 0.01
"""Exploration no longer pays when the best view promises less than this share of the best so far."""


class Swarmscan:
    """See the module."""

    def __init__(self, brief: TrialBrief) -> None:
        self._brief, self._lattice = brief, brief.lattice
        self._explored = Explored(brief)
        scaled = self._explored.lattice
        self._views = Lattice(scaled.positions_enu_m, *scaled.yaw_elevation_rad.T)
        self._spec = GainSpec(sensing_range_m=RANGE)
        self._looks = np.zeros(self._explored.grid.state.shape, dtype=np.uint8)
        self._new_keys: list[Pose] = []
        self._at = {vehicle: self._lattice.flat(start) for vehicle, start in enumerate(brief.starts, 1)}
        self._goals: dict[int, Pose] = {}
        self._came_from = dict(self._at)
        self._visited = np.zeros(len(self._lattice), dtype=np.bool_)
        self._largest = 0.0

    def see(self, frame: Frame) -> None:
        """Takes a picture in."""
        self._explored.see(frame)
        if frame.index is not None:
            self._new_keys.append(self._explored.pose(frame.index))
            self._visited[self._lattice.flat(frame.index)] = True

    def choose(self, vehicle: int, candidates: list[Index5]) -> Choice:
        """One step on the way to the view whose gain, discounted by the way there, is greatest."""
        self._explored.refresh()
        here = self._at[vehicle]
        steps = self._lattice.steps_along(self._explored.open_edges())
        given = np.array([self._lattice.flat(c) for c in candidates])
        clear = given[np.isin(given, steps[here])]
        distance = fewest_steps(steps, here)
        gains = self._gains(distance, [pose for k, pose in self._goals.items() if k != vehicle])
        self._largest = max(self._largest, float(gains.max()))
        chosen = self._first_step(vehicle, clear if len(clear) else given, steps, distance, gains)
        self._came_from[vehicle], self._at[vehicle] = here, chosen
        self._goals[vehicle] = self._explored.pose(self._lattice.index(chosen))
        area = 1.0 / self._explored.scale**2
        return Choice(vehicle=vehicle, index=self._lattice.index(chosen), predicted_gain=area * float(gains[chosen]),
                      coverage_estimate=self._explored.coverage,
                      stop=bool(gains.max() < STOP_SHARE * self._largest))

    def _first_step(self, vehicle: int, options: Indices, steps: Indices, distance: Indices, gains: Array) -> int:
        """The option on the way to the best view; where that is taken the best option, back where nothing promises."""
        worth = np.where(distance > 0, gains * np.exp(-DECAY_PER_STEP * distance), 0.0)
        if worth.max() > 0.0:
            first = way_back(steps, distance, int(worth.argmax()))[0]
            return first if first in options else int(options[gains[options].argmax()])
        back = self._came_from[vehicle] // self._lattice.orientations
        home = options[options // self._lattice.orientations == back]
        return int(home[0]) if len(home) else int(options[0])

    def _gains(self, distance: Indices, claimed: list[Pose]) -> Array:
        """(n,) expected new surface of every view that can be reached, in the map's square units."""
        field = with_claims(self._field(), claimed, self._brief.camera)
        reached = np.flatnonzero((distance.reshape(-1, self._lattice.orientations) != UNREACHED).any(axis=1))
        gains = np.zeros((len(self._views.positions_enu_m), self._lattice.orientations))
        gains[reached] = lattice_gains(field, self._views, self._brief.camera, reached, RAYS)
        flat = gains.ravel()
        flat[self._visited] = 0.0
        return flat

    def _field(self) -> GainField:
        explored = self._explored
        surface = explored.surface
        box = explored.object_min, explored.object_max
        field = gain_field(explored.grid, surface, *box, self._spec, self._looks)
        if self._new_keys:
            for pose in self._new_keys:
                self._looks = count_looks(field, self._looks, pose, self._brief.camera)
            self._new_keys.clear()
            field = gain_field(explored.grid, surface, *box, self._spec, self._looks)
        return field
