"""Who goes first where there is room for one only, decided on board from what the others have told.

A vehicle that is kept from its way by others asks for it (RightOfWay). The longest wait goes first, so the order is
total and the same for all. Everybody who rests in a way asked for with a better rank leaves it: aside where there is
room, else back along the own trail; who is kept from that asks in turn, with the rank of the one made way for (priority
inheritance; after Okumura et al., "Priority Inheritance with Backtracking", Artificial Intelligence 310, 2022). Nobody
sets out into a way that somebody with a better rank has asked for.

Why this ends: flights never pass a place where another one rests or will rest (Teammates.conflicts, ends=True), so the
vehicle that flew last can fly its last leg back while the others rest, then the one before it, until all hover over
their pads, from where the first in rank finds its way free (Cap, Novak, Kleiner and Selecky, "Prioritized Planning
Algorithms for Trajectory Coordination of Multiple Mobile Robots", IEEE T-ASE 12(3), 2015: well-formed
infrastructures). Steps aside and short cuts of the trail break that order, so that two may stand in each other's way
back. Who has been cornered so for long flies to the nearest place off all ways that were asked for, wherever it is.
When somebody has waited for ten minutes all the others go back to their hover points, whoever finds a way there first,
and stay until it is where it wanted to be; after twenty it goes back too. `swarmscan bench deconflict` is the test.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from missions.frames import Array
from missions.messages import RightOfWay, vector
from planning.deconflict import NEVER, distance_to_polyline_m, first_approach
from planning.trajectories import Flight
from vehicle.simulator import NS
from vehicle.teammates import LAST, STEP_NS, Rank, Teammates

EVER = 1 << 30
SAME_PLACE_M = 1e-3
RETREATS = 5
"""Of the trail's last places so many are tried: where it leads to and fro, straight from here is shorter."""
ASK_AFTER_NS, CROSS_NS = 10 * NS, 40 * NS
"""Most waits end by themselves. After the first a vehicle asks for its way, after the second nobody crosses it."""
CLEAR_OUT_NS = 600 * NS
"""Whoever waits for longer than this is alone in the air: all the others go back to their hover points, if need be it
too, to begin anew from there."""
ASIDES = 3
"""So often a vehicle moves aside for the same wait of another one; after that it goes back along its trail."""


class Trail:
    """Where the vehicle rested and turned since take-off: the way back that is known to be free."""

    def __init__(self) -> None:
        self._points: list[Array] = []

    def begin(self, hover_enu_m: Array) -> None:
        """At the hover point."""
        self._points = [hover_enu_m]

    def note(self, passed: list[Array], rest_enu_m: Array) -> None:
        """A flight has ended: the corners that it passed, and where the vehicle rests now."""
        for point in [*passed, rest_enu_m]:
            if self._points and same_place(self._points[0], point):
                self._points = [point]
                continue
            back = next((n for n in range(1, min(RETREATS + 1, len(self._points)) + 1)
                         if same_place(self._points[-n], point)), None)
            if back is None:
                self._points.append(point)
            else:
                del self._points[len(self._points) - back + 1:]

    @property
    def points(self) -> list[Array]:
        """All of it, from the hover point on."""
        return list(self._points)

    def follow(self, points: list[Array]) -> None:
        """This is the way that the vehicle came."""
        self._points = list(points)

    @property
    def home(self) -> Array | None:
        """The hover point; None on the ground."""
        return self._points[0] if self._points else None

    @property
    def back(self) -> list[Array]:
        """The places before this one, the last first; none at the hover point."""
        return self._points[-2:-2 - RETREATS:-1]

    def back_to(self, found: Callable[[Array], bool]) -> list[Array]:
        """Where to fly from here to be at the last place of this kind; empty when there was none."""
        for n in range(len(self._points) - 2, -1, -1):
            if found(self._points[n]):
                return self._points[-2:n - 1 if n else None:-1]
        return []


class RightOfWayRules:
    """One vehicle's part in it: what it asks for, and what it leaves to whom."""

    def __init__(self, vehicle_id: int, teammates: Teammates, apart_m: float) -> None:
        self._id, self._teammates, self._apart_m = vehicle_id, teammates, apart_m
        self.waiting_since: int | None = None
        self.wants: RightOfWay | None = None
        self.on_behalf: RightOfWay | None = None
        self._asides = 0
        self._made_way_for = LAST

    @property
    def rank(self) -> Rank:
        """Of the own wait."""
        return LAST if self.wants is None else Rank(self.wants.since_ns, self.wants.vehicle_id)

    @property
    def told(self) -> RightOfWay | None:
        """What teammates have to know."""
        return self.on_behalf or self.wants

    def ask(self, path: list[Array], t_ns: int) -> None:
        """For the own way; the wait goes on from when it was first asked for."""
        if self.waiting_since is None:
            self.waiting_since = t_ns
        if t_ns - self.waiting_since >= ASK_AFTER_NS:
            self.wants = _request(path, Rank(self.waiting_since, self._id))

    def done(self) -> None:
        """The vehicle is where it wanted to be."""
        self.wants = self.waiting_since = None

    def ask_for(self, rank: Rank, path: list[Array]) -> None:
        """For the way out of somebody's way."""
        self.on_behalf = _request(path, rank)

    def leaves_the_air_to_another(self, t_ns: int) -> bool:
        """Whether somebody with a better rank has waited for so long that all others go to their hover points."""
        others = [r for r, _ in self._teammates.before(self.rank) if r.vehicle_id != self._id]
        return bool(others) and t_ns - others[0].since_ns > CLEAR_OUT_NS

    def begins_anew(self, t_ns: int) -> bool:
        """Whether the own wait has lasted so long that the others' leaving has not helped."""
        return self.wants is not None and t_ns - self.wants.since_ns > 2 * CLEAR_OUT_NS

    def refuses(self, flight: Flight, t_ns: int) -> bool:
        """Whether this flight ends in a way that somebody with a better rank has asked for, or crosses one that was
        asked for long ago."""
        ways = self._teammates.before(self.rank)
        if not ways:
            return False
        mine = flight.curve.sample(STEP_NS / NS)[1]
        for rank, way in ways:
            inside = distance_to_polyline_m(mine[[0, -1]], way) < self._apart_m
            if inside[1]:
                return True
            if t_ns - rank.since_ns > CROSS_NS and not inside[0] \
                    and first_approach(mine, way, EVER, self._apart_m) != NEVER:
                return True
        return False

    def in_the_way(self, place_enu_m: Array) -> tuple[Rank, list[Array]] | None:
        """(rank of the first who asks for a way through this place, all ways to keep off); None when nobody does."""
        ways = self._teammates.before(self.rank)
        through = [rank for rank, way in ways if distance_to_polyline_m(place_enu_m, way)[0] < self._apart_m]
        return (through[0], [way for _, way in ways]) if through else None

    def may_step_aside(self, rank: Rank) -> bool:
        """Whether to look for a place aside, rather than to go back."""
        if rank != self._made_way_for:
            self._made_way_for, self._asides = rank, 0
        return self._asides < ASIDES

    def stepped_aside(self) -> None:
        """Count it."""
        self._asides += 1


def _request(path: list[Array], rank: Rank) -> RightOfWay:
    return RightOfWay(path_enu_m=[vector(p) for p in path], since_ns=rank.since_ns, vehicle_id=rank.vehicle_id)


def same_place(a_enu_m: Array, b_enu_m: Array) -> bool:
    """Whether two places are one but for rounding."""
    return bool(np.abs(a_enu_m - b_enu_m).max() < SAME_PLACE_M)
