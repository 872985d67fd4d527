"""What operators have marked in space: the fence, boxes where nobody may fly, boxes of which more is to be shown.

What is forbidden is taken out of the known-free space, in the map that ways are planned on and in the one that vehicles
get, so that neither plans nor detours on board lead there. Without marks, maps stay the very same objects.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from missions.frames import Array
from missions.grid import FREE, UNKNOWN, VoxelGrid
from missions.live import LiveRegion, MarkRegion
from missions.messages import SiteBrief, Vector
from missions.mission import Mission
from missions.pads import fence_limit, geofence, takeoff_columns
from planning.nbv.interest import Interest

SAME_M = 0.01
"""Corners this near are the same."""


class Regions:
    """The marks, and the operator's fence: inside what the vehicles have on board, which they can be asked to widen."""

    def __init__(self, mission: Mission, site: SiteBrief) -> None:
        self.limit_enu_m = fence_limit(mission, site)
        self.on_board_enu_m = self.fence_enu_m = geofence(mission, site)
        self.marked: list[LiveRegion] = []
        self._columns = takeoff_columns(mission, site)
        self._room_m = mission.fleet.clearance_m
        self._last_id = 0

    @property
    def interest(self) -> Interest | None:
        """What counts more; None when nothing is marked as important."""
        boxes = [r for r in self.marked if r.kind == "important"]
        if not boxes:
            return None
        return Interest(np.array([r.lower_enu_m for r in boxes]), np.array([r.upper_enu_m for r in boxes]))

    @property
    def restrict(self) -> bool:
        """Whether any way is closed that the mission leaves open."""
        return not np.array_equal(self.fence_enu_m, self.limit_enu_m) or any(r.kind == "forbidden" for r in self.marked)

    def applied(self, grid: VoxelGrid) -> VoxelGrid:
        """The map with nothing known to be free where nobody may fly."""
        if not self.restrict:
            return grid
        closed = np.ones(grid.state.shape, dtype=np.bool_)
        closed[_voxels(grid, *self.fence_enu_m, whole=True)] = False
        for region in self._forbidden():
            closed[_voxels(grid, np.array(region.lower_enu_m), np.array(region.upper_enu_m), whole=False)] = True
        return replace(grid, state=np.where(closed & (grid.state == FREE), np.uint8(UNKNOWN), grid.state))

    def mark(self, action: MarkRegion, vehicles_enu_m: dict[int, Array]) -> str:
        """Mark a box; a sentence when it cannot be. vehicles_enu_m: where those are that fly."""
        lower, upper = np.array(action.lower_enu_m), np.array(action.upper_enu_m)
        refusal = _shape(lower, upper)
        if not refusal and action.kind == "forbidden":
            refusal = self._in_the_way(lower, upper, vehicles_enu_m)
        if not refusal:
            self._last_id += 1
            self.marked.append(LiveRegion(region_id=self._last_id, kind=action.kind, lower_enu_m=action.lower_enu_m,
                                          upper_enu_m=action.upper_enu_m))
        return refusal

    def clear(self, region_id: int) -> str:
        """Forget a mark; a sentence when there is none of this number."""
        kept = [r for r in self.marked if r.region_id != region_id]
        if len(kept) == len(self.marked):
            return f"there is no region {region_id}"
        self.marked = kept
        return ""

    def beyond_board(self, lower: Vector, upper: Vector) -> bool:
        """Whether a fence reaches beyond what the vehicles have on board."""
        low, high = self.on_board_enu_m
        return bool((np.array(lower) < low - SAME_M).any() or (np.array(upper) > high + SAME_M).any())

    def accept(self, lower: Vector, upper: Vector) -> None:
        """The vehicles have taken this box on board."""
        self.on_board_enu_m = np.array(lower), np.array(upper)

    def move_fence(self, lower: Vector, upper: Vector) -> None:
        """Fly inside this box from now on, which nothing speaks against."""
        self.fence_enu_m = np.array(lower), np.array(upper)

    def against_fence(self, lower: Vector, upper: Vector, vehicles_enu_m: dict[int, Array]) -> str:
        """Why the fence cannot be this box; "" when it can. vehicles_enu_m: where those are that fly."""
        low, high = np.array(lower), np.array(upper)
        refusal = _shape(low, high)
        least, most = self.limit_enu_m
        if not refusal and ((low < least - SAME_M).any() or (high > most + SAME_M).any()):
            refusal = f"the mission allows no more than {_metres(least)} to {_metres(most)} (site.geofence_room_m)"
        corners = [c for column in self._columns for c in column]
        places = {0: np.array([np.min(corners, axis=0), np.max(corners, axis=0)])} | {
            k: p[None] for k, p in vehicles_enu_m.items()}
        for k, points in places.items():
            room = self._room_m if k else 0.0
            if not refusal and ((points < low + room) | (points > high - room)).any():
                refusal = f"vehicle {k} would be outside; bring it in first" if k else "the pads must stay inside"
        return refusal

    def _forbidden(self) -> list[LiveRegion]:
        return [r for r in self.marked if r.kind == "forbidden"]

    def _in_the_way(self, lower: Array, upper: Array, vehicles_enu_m: dict[int, Array]) -> str:
        """Why a box cannot be forbidden; "" when it can."""
        for k, (low, high) in enumerate(self._columns):
            if (lower < high).all() and (upper > low).all():
                return f"vehicle {k + 1} takes off and lands there; leave its pad and the space over it open"
        for k, position in vehicles_enu_m.items():
            if ((position > lower - self._room_m) & (position < upper + self._room_m)).all():
                return f"vehicle {k} is there; have it leave first"
        return ""


def _metres(corner: Array) -> str:
    return "(" + ", ".join(f"{c:.1f}" for c in corner) + ") m"


def _shape(lower: Array, upper: Array) -> str:
    return "" if (lower < upper).all() else "every lower corner must lie below its upper one"


def _voxels(grid: VoxelGrid, lower: Array, upper: Array, *, whole: bool) -> tuple[slice, ...]:
    """The voxels that lie wholly in a box, or that it touches."""
    first, last = (np.asarray((edge - grid.origin_enu_m) / grid.voxel_m) for edge in (lower, upper))
    low, high = (np.ceil(first - 1e-6), np.floor(last + 1e-6)) if whole else (np.floor(first), np.ceil(last))
    shape: NDArray[np.int64] = np.array(grid.state.shape)
    return tuple(slice(int(a), int(b)) for a, b in zip(np.clip(low, 0, shape), np.clip(high, 0, shape), strict=True))
