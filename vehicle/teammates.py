"""The other vehicles: where they are, where they said they would be, and whether that is too near."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from missions.clock import vehicle_name
from missions.frames import Array
from missions.messages import AnnouncedTrajectory, VehicleState
from planning.trajectories import Flight
from vehicle.simulator import NS, vector

STEP_NS = 200_000_000


@dataclass
class Teammate:
    """What another vehicle has told."""

    vehicle_id: int
    alive: bool = True
    state: VehicleState | None = None
    announced: AnnouncedTrajectory | None = None

    @property
    def known(self) -> bool:
        """Whether it has told anything."""
        return self.state is not None or self.announced is not None

    def end_ns(self) -> int:
        """When it comes to rest; 0 when it rests already for all we know."""
        if not self.alive or self.announced is None:
            return 0
        return self.announced.t_start_ns + self.announced.step_ns * (len(self.announced.positions_enu_m) - 1)

    def positions_at(self, t_ns: NDArray[np.int64]) -> Array:
        """(n, 3) where it will be at these times (n,); a dead one stays where it was last seen."""
        if self.announced is None or (not self.alive and self.state is not None):
            assert self.state is not None, "asked about a teammate that has told nothing"
            return np.broadcast_to(np.array(self.state.position_enu_m), (len(t_ns), 3))
        points = np.array(self.announced.positions_enu_m)
        if len(points) == 1:
            return np.broadcast_to(points[0], (len(t_ns), 3))
        index = (t_ns - self.announced.t_start_ns) / self.announced.step_ns
        knots = np.arange(len(points))
        return np.stack([np.interp(index, knots, points[:, axis]) for axis in range(3)], axis=1)


@dataclass(frozen=True)
class Conflict:
    """Two vehicles would come too near: who, in how many seconds, and whether the other one is at rest by now."""

    vehicle_id: int
    in_s: float
    other_rests: bool


@dataclass
class Teammates:
    """All the others. `version` changes whenever one of them changes its plan of motion."""

    own_id: int
    version: int = 0
    members: dict[int, Teammate] = field(default_factory=dict)

    def hear(self, message: VehicleState | AnnouncedTrajectory) -> None:
        """Take note of a message of another vehicle."""
        mate = self.members.setdefault(message.vehicle_id, Teammate(message.vehicle_id))
        if isinstance(message, AnnouncedTrajectory):
            mate.announced = message
            self.version += 1
        else:
            mate.state = message

    def note_participants(self, participants: frozenset[str]) -> None:
        """Who still lives."""
        for mate in self.members.values():
            alive = vehicle_name(mate.vehicle_id) in participants
            if alive != mate.alive:
                mate.alive = alive
                self.version += 1

    def positions(self, t_ns: int) -> Array:
        """(m, 3) of all known teammates now."""
        mates = [m.positions_at(np.array([t_ns]))[0] for m in self._known()]
        return np.array(mates).reshape(-1, 3)

    def resting(self, t_ns: int) -> Array:
        """(m, 3) of those that do not move."""
        mates = [m.positions_at(np.array([t_ns]))[0] for m in self._known() if m.end_ns() <= t_ns]
        return np.array(mates).reshape(-1, 3)

    def wanted(self) -> list[tuple[int, Array]]:
        """(vehicle id, place) of those that wait for a place to become free."""
        return [(m.vehicle_id, np.array(m.announced.wants_enu_m)) for m in self._known()
                if m.alive and m.announced is not None and m.announced.wants_enu_m is not None]

    def conflicts(self, flight: Flight, start_ns: int, now_ns: int, separation_m: float) -> list[Conflict]:
        """With whom this flight, and resting at its end, comes nearer than separation_m from now on."""
        found = []
        for mate in self._known():
            horizon_ns = max(start_ns + round(flight.duration_s * NS), mate.end_ns(), now_ns)
            steps = (horizon_ns - now_ns) // STEP_NS + 2
            t = now_ns + np.arange(steps, dtype=np.int64) * STEP_NS
            mine = flight.curve.at((t - start_ns) / NS)[0]
            gap = np.linalg.norm(mine - mate.positions_at(t), axis=1)
            limit = separation_m if gap[0] >= separation_m else float(gap[0]) - 1e-6  # moving apart is no conflict
            near = np.flatnonzero(gap < limit)
            if len(near):
                found.append(Conflict(mate.vehicle_id, float(t[near[0]] - now_ns) / NS, mate.end_ns() <= now_ns))
        return found

    def _known(self) -> list[Teammate]:
        return [self.members[i] for i in sorted(self.members) if self.members[i].known]


def announce(vehicle_id: int, flight: Flight, start_ns: int, now_ns: int,
             wants_enu_m: Array | None) -> AnnouncedTrajectory:
    """The rest of a flight as teammates and referee get it."""
    elapsed_s = (now_ns - start_ns) / NS
    steps = max(0, math.ceil((flight.duration_s - elapsed_s) * NS / STEP_NS))
    times = elapsed_s + np.arange(steps + 1, dtype=np.float64) * (STEP_NS / NS)
    positions = flight.curve.at(times)[0]
    return AnnouncedTrajectory(
        vehicle_id=vehicle_id, t_start_ns=now_ns, step_ns=STEP_NS,
        positions_enu_m=[vector(p) for p in positions],
        wants_enu_m=None if wants_enu_m is None else vector(wants_enu_m))
