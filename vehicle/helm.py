"""Flies what has been decided: launches flights from rest, watches them, brakes, and tells the teammates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missions.frames import Array
from missions.messages import AnnouncedTrajectory
from planning.trajectories import Curve, Flight, Limits, State, Via, fly_run
from vehicle.avoidance import Avoidance, Knowledge
from vehicle.body import Body
from vehicle.right_of_way import RightOfWayRules, Trail, same_place
from vehicle.run_planner import Run, RunPlanner
from vehicle.simulator import NS
from vehicle.teammates import STEP_NS, announce

LOOK_AHEAD_NS = 200_000_000
LOOK_AGAIN_S = 1.1
"""From one look ahead to the next, at most: the longest tick that a mission may ask for, and some more."""


@dataclass
class Rest:
    """One rest between two flights: what has been tried, and when something is tried again."""

    waiting: bool = False
    """Whether the vehicle would go somewhere if it could."""
    retry_ns: int = 0
    make_way_ns: int = 0
    no_way_since: int | None = None
    cornered_since: int | None = None
    shortened: bool = False
    """Whether what the detour no longer needs has been left out."""


class Helm:
    """The flight under way, the rest after it, and the detour that leads on to where the vehicle wants to be."""

    def __init__(self, vehicle_id: int, body: Body, avoidance: Avoidance) -> None:
        self.body, self.avoidance = body, avoidance
        self.rules = RightOfWayRules(vehicle_id, avoidance.teammates, avoidance.separation_m)
        self.trail, self.rest = Trail(), Rest()
        self.detour: list[Array] = []
        self.careful = False
        """Whether the map has proved wrong: the detour is flown slowly, one leg at a time."""
        self.reaches_ns: list[int] = []
        """When the flight under way reaches the vias that it was asked for; empty for a detour."""
        self.launches = 0
        self.news = True
        """Whether teammates have to know something."""
        self._id = vehicle_id
        self._planner = RunPlanner(avoidance, self.rules)
        self._way = body.flight.curve.end[None]
        self._passing: list[tuple[int, Array]] = []
        self._braking = self._narrow = self._fresh = False
        self._checked: Knowledge | None = None
        self._check_ns = 0

    def position(self, t_ns: int) -> Array:
        """(3,) where the vehicle is."""
        return self.body.at(t_ns).state.position

    def resting_place(self, t_ns: int) -> Array:
        """(3,) where the vehicle rests now; the trail goes on to here, the detour begins behind it."""
        here = self.position(t_ns)
        self.trail.note([p for passed_ns, p in self._passing if passed_ns < t_ns], here)
        self._passing = []
        for n in range(len(self.detour), 0, -1):
            if same_place(self.detour[n - 1], here):
                self.detour = self.detour[n:]
                break
        return here

    def shorten_detour(self, here: Array, goal: Array) -> None:
        """Leave out what the detour to the goal no longer needs, once at every rest."""
        if self.detour and not self.rest.shortened:
            points = [*self.detour, goal]
            ahead = range(len(self.detour), 0, -1)
            self.detour = self.detour[next((n for n in ahead if self.avoidance.clear(here, points[n])), 0):]
        self.rest.shortened = True

    def run(self, vias: list[Via], limits: Limits, t_ns: int) -> Run:
        """As much of a run along the vias as may be launched now."""
        return self._planner.plan(self.body.at(t_ns), vias, limits, t_ns)

    def leg(self, via: Via, limits: Limits, t_ns: int) -> Flight:
        """The flight straight to the via, whatever is in between."""
        now = self.body.at(t_ns)
        return fly_run(State.at_rest(now.state.position), now.yaw_enu_rad, now.gimbal_elevation_rad, [via], limits)

    def launch(self, flight: Flight, points: list[Array], t_ns: int, before: int = 0, narrow: bool = False) -> None:
        """Fly through the points, so many of them before the vias asked for; narrow: out of a place that has become too
        narrow for the clearance."""
        self._way = np.array([self.position(t_ns), *points])
        self.body.fly(flight, t_ns)
        reaches_ns = [t_ns + round(float(s) * NS) for s in flight.reached_s]
        self._passing = list(zip(reaches_ns[:-1], points[:-1], strict=True))
        self.reaches_ns = reaches_ns[before:]
        self.rest, self.news = Rest(), True
        self._braking, self._narrow, self._fresh = False, narrow, True
        self.launches += 1
        self.rules.on_behalf = None
        self._checked, self._check_ns = self.avoidance.version, t_ns

    def stop(self, t_ns: int) -> None:
        """Brake to rest on the way of the flight."""
        if self._braking or t_ns >= self.body.end_ns:
            return
        self.body.fly(self.body.flight.stop(self.body.elapsed_s(t_ns)), t_ns)
        self._braking, self.news = True, True

    def begin_anew(self, to_rest: Flight, t_ns: int) -> None:
        """The body is not where its flight has it: come to rest from where it is, and tell the teammates."""
        self.body.fly(to_rest, t_ns)
        self._way = np.array([self.position(t_ns), to_rest.curve.end])
        self.detour, self.reaches_ns, self._passing = [], [], []
        self._braking, self._fresh, self.news = True, False, True

    def look_ahead(self, t_ns: int) -> bool:
        """Check the rest of the leg against what is new; True when that made the vehicle brake."""
        if self._braking or t_ns < self._check_ns or self._checked == self.avoidance.version:
            return False
        before, self._checked = self._checked, self.avoidance.version
        ahead = self.body.flight.curve.sample(STEP_NS / NS, self.body.elapsed_s(t_ns))[1]
        if self._narrow:
            clear = self.avoidance.may_leave(ahead)
        elif before is not None and before.map == self._checked.map:
            clear = self.avoidance.clear_of_hits(ahead)
        else:
            clear = self.avoidance.clear_of_hits(ahead) and self._map_allows(ahead, t_ns)
        if not clear:
            self.detour, self.careful = [], True
        if not clear or self._must_yield(t_ns):
            self.stop(t_ns)
        return self._braking

    def _map_allows(self, ahead_enu_m: Array, t_ns: int) -> bool:
        """Whether a changed map leaves the rest of the flight (k, 3) clear; or whether the vehicle, looking again,
        could still stop before what it takes away: often the sensor has swept that clear by then."""
        if self.avoidance.still_clear(ahead_enu_m):
            return True
        self._checked = None
        flight, now_s = self.body.flight, self.body.elapsed_s(t_ns)
        again_s = min(now_s + LOOK_AGAIN_S, flight.duration_s)
        stopping = Curve.chain([flight.curve.part(now_s, again_s), flight.stop(again_s).curve])
        return self.avoidance.still_clear(stopping.sample(STEP_NS / NS)[1])

    def look_out_for_teammates(self, t_ns: int) -> None:
        """The part of look_ahead that also holds over the own pad."""
        if not self._braking and t_ns >= self._check_ns and self._checked != self.avoidance.version:
            self._checked = self.avoidance.version
            if self._must_yield(t_ns):
                self.stop(t_ns)

    def announcement(self, t_ns: int) -> AnnouncedTrajectory | None:
        """What teammates have to know, when it has changed."""
        if not self.news:
            return None
        self.news = False
        return announce(self._id, self.body.flight, self.body.start_ns, t_ns, self.rules.told)

    def _must_yield(self, t_ns: int) -> bool:
        """When two have set out at once the one that goes first flies on; whoever finds another one braking brakes."""
        body = self.body
        if self._fresh:
            self._fresh, self._checked = False, None
            self._check_ns = t_ns + LOOK_AHEAD_NS
            conflicts = self.avoidance.conflicts(body.flight, self._way, t_ns, body.start_ns)
            return any(self.avoidance.teammates.goes_before(c.vehicle_id, self.rules.rank) for c in conflicts)
        return bool(self.avoidance.conflicts_in_flight(body.flight, body.start_ns, t_ns))
