"""What a trial is judged by: true coverage, collisions, metres and seconds of flight."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np

from missions.camera import Pose
from missions.pose_lattice import Index5
from planning.trajectories import Limits, State, Via, fly_run
from sim_bridge.nbv.arena import Arena
from sim_bridge.nbv.clearance import segments_clear
from sim_bridge.nbv.visibility import Bits

SETTLE_S = 0.2
"""Rest at a key pose, as in exploration."""


@dataclass
class Score:
    """Grows with every key pose at which a vehicle arrives, in the order of arrival."""

    arena: Arena
    covered: Bits = field(init=False)
    curve: list[float] = field(default_factory=list)
    """Coverage after each key pose."""
    seconds: list[float] = field(default_factory=list)
    """Simulated time of each key pose."""
    metres: list[float] = field(default_factory=list)
    """What all vehicles together had flown by then, completed legs only."""
    visited: list[Index5] = field(default_factory=list)
    collisions: int = 0
    """Legs that came nearer to the scene than the vehicle's radius."""
    unsafe_views: int = 0
    """Key poses where nobody can safely stand; they see nothing."""

    def __post_init__(self) -> None:
        self.covered = np.zeros_like(self.arena.seen[0])

    def arrive(self, index: Index5, seconds: float, leg: tuple[Pose, Pose] | None) -> None:
        """A vehicle has come to a key pose over a leg, or begins there."""
        arena, flat = self.arena, self.arena.lattice.flat(index)
        self.covered |= arena.seen[flat]
        self.unsafe_views += not arena.standable[flat // arena.lattice.orientations]
        flown = self.metres[-1] if self.metres else 0.0
        if leg is not None:
            start, end = (np.array([pose.position_enu_m]) for pose in leg)
            flown += float(np.linalg.norm(end - start))
            self.collisions += not segments_clear(arena.truth, start, end, arena.rules.fleet.radius_m)[0]
        self.curve.append(arena.share(self.covered))
        self.seconds.append(seconds)
        self.metres.append(flown)
        self.visited.append(index)

    def seconds_to(self, share_of_ceiling: float) -> float | None:
        """When coverage reached this share of the ceiling; None if never."""
        reached = np.array(self.curve) >= share_of_ceiling * self.arena.ceiling
        return round(self.seconds[int(reached.argmax())], 2) if reached.any() else None


def flight_s(start: Pose, end: Pose, limits: Limits) -> float:
    """Seconds from rest at one key pose to rest at the next, camera turned."""
    offset = np.subtract(end.position_enu_m, start.position_enu_m)
    return _flight_s(tuple(np.round(offset, 6).tolist()), start.yaw_enu_rad, end.yaw_enu_rad, start.elevation_rad,
                     end.elevation_rad, limits)


@cache
def _flight_s(offset_m: tuple[float, ...], yaw: float, to_yaw: float, elevation: float, to_elevation: float,
              limits: Limits) -> float:
    via = Via(np.array(offset_m), to_yaw, to_elevation, stop=True, settle_s=SETTLE_S)
    return fly_run(State.at_rest(np.zeros(3)), yaw, elevation, [via], limits).duration_s
