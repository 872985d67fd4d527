"""The other vehicles: where they are, where they said they would be, what they ask for, whether that is near."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from missions.clock import vehicle_name
from missions.frames import Array
from missions.messages import AnnouncedTrajectory, RightOfWay, VehicleState, vector
from planning.deconflict import NEVER, meeting
from planning.trajectories import Flight
from vehicle.simulator import NS

STEP_NS = 200_000_000
NO_WAY = np.zeros((0, 3))
LOST_TEAMMATE = "a teammate that was lost there"
"""It hovers on, dead, or nobody knows what it does; nobody goes near."""


class Rank(NamedTuple):
    """Who goes first: the smaller."""

    since_ns: int
    vehicle_id: int


LAST = Rank(1 << 62, 1 << 30)
"""Of who waits for nothing."""


@dataclass
class Teammate:
    """What another vehicle has told."""

    vehicle_id: int
    alive: bool = True
    state: VehicleState | None = None
    announced: AnnouncedTrajectory | None = None
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(n, 3) of the announced trajectory."""
    lower: Array = field(default_factory=lambda: np.full(3, -np.inf))
    upper: Array = field(default_factory=lambda: np.full(3, np.inf))
    """(3,) box around these points; everything while they are not known."""
    way: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(k, 3) that it asks for."""

    @property
    def known(self) -> bool:
        """Whether it has told anything."""
        return self.state is not None or self.announced is not None

    def end_ns(self) -> int:
        """When it comes to rest; 0 when it rests already for all we know."""
        if not self.alive or self.announced is None:
            return 0
        return self.announced.t_start_ns + self.announced.step_ns * (len(self.points) - 1)

    def positions_at(self, t_ns: NDArray[np.int64]) -> Array:
        """(n, 3) where it will be at these times (n,); a dead one stays where it was last seen."""
        if self.announced is None or (not self.alive and self.state is not None):
            assert self.state is not None, "asked about a teammate that has told nothing"
            return np.broadcast_to(np.array(self.state.position_enu_m), (len(t_ns), 3))
        along = np.clip((t_ns - self.announced.t_start_ns) / self.announced.step_ns, 0.0, len(self.points) - 1.0)
        knot = np.minimum(along.astype(np.int64), len(self.points) - 1)
        ahead = np.minimum(knot + 1, len(self.points) - 1)
        return np.asarray(self.points[knot] + (along - knot)[:, None] * (self.points[ahead] - self.points[knot]))

    def ahead(self, now_ns: int) -> Array:
        """(n, 3) where it will be from now on in steps of STEP_NS; it stays at the last one."""
        steps = max(0, -(-(self.end_ns() - now_ns) // STEP_NS))
        return np.ascontiguousarray(self.positions_at(now_ns + np.arange(steps + 1, dtype=np.int64) * STEP_NS))

    @property
    def stopping_s(self) -> float:
        """By how much it is late at a place at which it stops, at most."""
        return self.announced.stopping_s if self.announced is not None else 0.0

    @property
    def end(self) -> Array:
        """(3,) where it will rest."""
        if len(self.points) and (self.alive or self.state is None):
            return np.asarray(self.points[-1])
        return np.array(self.positions_at(np.zeros(1, dtype=np.int64))[0])


@dataclass(frozen=True)
class Conflict:
    """Two vehicles would come too near: who, in how many seconds, and whether the other one rests in the way."""

    vehicle_id: int
    in_s: float
    other_rests: bool


@dataclass
class Teammates:
    """All the others. `version` changes whenever one of them changes its plan of motion or what it asks for."""

    own_id: int
    version: int = 0
    members: dict[int, Teammate] = field(default_factory=dict)

    def hear(self, message: VehicleState | AnnouncedTrajectory) -> None:
        """Take note of a message of another vehicle."""
        mate = self.members.setdefault(message.vehicle_id, Teammate(message.vehicle_id))
        if isinstance(message, AnnouncedTrajectory):
            mate.announced, mate.points = message, np.array(message.positions_enu_m, dtype=np.float64)
            mate.lower, mate.upper = mate.points.min(axis=0), mate.points.max(axis=0)
            mate.way = np.array(message.wants.path_enu_m if message.wants is not None else []).reshape(-1, 3)
            self.version += 1
        else:
            mate.state = message

    def note_participants(self, participants: frozenset[str]) -> bool:
        """Who still lives; whether somebody does again, who has to be told everything anew."""
        returned = False
        for mate in self.members.values():
            alive = vehicle_name(mate.vehicle_id) in participants
            if alive != mate.alive:
                mate.alive = alive
                self.version += 1
                returned = returned or alive
        return returned

    def positions(self, t_ns: int) -> Array:
        """(m, 3) of all known teammates now."""
        return _stacked([m.positions_at(np.array([t_ns]))[0] for m in self._known()])

    def resting(self, t_ns: int) -> Array:
        """(m, 3) of those that do not move now; not of the dead."""
        return _stacked([m.positions_at(np.array([t_ns]))[0] for m in self._known() if m.alive and m.end_ns() <= t_ns])

    def dead(self) -> Array:
        """(m, 3) of those that will not move any more."""
        return _stacked([m.end for m in self._known() if not m.alive])

    def places(self, t_ns: int) -> Array:
        """(m, 3) where they are and (m, 3) where they will rest."""
        return np.concatenate([self.positions(t_ns), _stacked([m.end for m in self._known()])])

    def before(self, rank: Rank) -> list[tuple[Rank, Array]]:
        """(rank, (k, 3) way asked for) of everybody who goes before `rank`, and of all who ask on the own behalf; best
        first."""
        asked = [(Rank(m.announced.wants.since_ns, m.announced.wants.vehicle_id), m.way) for m in self._known()
                 if m.alive and m.announced is not None and m.announced.wants is not None]
        return sorted(((r, way) for r, way in asked if r < rank or r.vehicle_id == self.own_id), key=lambda a: a[0])

    def goes_before(self, vehicle_id: int, rank: Rank) -> bool:
        """Whether this one goes first when both have set out at once."""
        announced = self.members[vehicle_id].announced
        wants = announced.wants if announced is not None else None
        other = LAST if wants is None else Rank(wants.since_ns, wants.vehicle_id)
        return (other, vehicle_id) < (rank, self.own_id)

    def conflicts(self, flight: Flight, start_ns: int, now_ns: int, separation_m: float,
                  reaction_s: float | None = None, way_enu_m: Array | None = None,
                  dead_m: float | None = None) -> list[Conflict]:
        """With whom this flight, and resting at its end, comes nearer than separation_m from now on.

        reaction_s: even when either stops, and the other one begins to stop so much later. way_enu_m: (k, 3) the way
        back of this flight: not even before others rest may it pass where they will rest. dead_m: the separation from
        the dead, where it is another one.
        """
        own_stop_s, found = stopping_s(flight), []
        mine = flight.curve.sample(STEP_NS / NS, max(0.0, (now_ns - start_ns) / NS))[1]
        way = NO_WAY if way_enu_m is None else way_enu_m
        for mate in self._near(mine.min(axis=0) - separation_m, mine.max(axis=0) + separation_m):
            theirs = mate.ahead(now_ns)
            slack_s = 0.0 if reaction_s is None else max(own_stop_s, mate.stopping_s) + reaction_s
            apart_m = separation_m if mate.alive or dead_m is None else dead_m
            at, rests = meeting(mine, theirs, math.ceil(slack_s * NS / STEP_NS), apart_m, way)
            if at != NEVER:
                found.append(Conflict(mate.vehicle_id, at * STEP_NS / NS, rests))
        return found

    def _near(self, lower: Array, upper: Array) -> list[Teammate]:
        """Those that come into a box, for all that they told; the dead always."""
        mates = self._known()
        if not mates:
            return []
        below, above = np.array([m.upper for m in mates]) < lower, np.array([m.lower for m in mates]) > upper
        far = np.any(below | above, axis=1)
        return [m for m, away in zip(mates, far, strict=True) if not (away and m.alive)]

    def _known(self) -> list[Teammate]:
        return [self.members[i] for i in sorted(self.members) if self.members[i].known]


def announce(vehicle_id: int, flight: Flight, start_ns: int, now_ns: int,
             wants: RightOfWay | None) -> AnnouncedTrajectory:
    """The rest of a flight as teammates and referee get it."""
    elapsed_s = (now_ns - start_ns) / NS
    steps = max(0, math.ceil((flight.duration_s - elapsed_s) * NS / STEP_NS))
    times = elapsed_s + np.arange(steps + 1, dtype=np.float64) * (STEP_NS / NS)
    positions = flight.curve.at(times)[0]
    return AnnouncedTrajectory(vehicle_id=vehicle_id, t_start_ns=now_ns, step_ns=STEP_NS, stopping_s=stopping_s(flight),
                               positions_enu_m=[vector(p) for p in positions], wants=wants)


def stopping_s(flight: Flight) -> float:
    """How far ahead of the flight the place lies at which it can rest: through the longest blend, then braking. At a
    steady speed v braking takes a way of v / 2 (v / a + a / j), which the flight would pass in half of that time."""
    if flight.limits is None:
        return 0.0
    speed, acceleration, jerk = flight.limits.motion
    blends = flight.straights_s[1:, 0] - flight.straights_s[:-1, 1]
    return 0.5 * (speed / acceleration + acceleration / jerk) + float(blends.max(initial=0.0))


def _stacked(positions: list[Array]) -> Array:
    return np.array(positions).reshape(-1, 3)
