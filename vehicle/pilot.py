"""Gets the vehicle to a point or says why not: launches clear legs, watches them, waits, goes around, makes way."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum

import numpy as np

from missions.frames import Array
from missions.messages import AnnouncedTrajectory
from planning.paths import NoPath
from planning.trajectories import Flight, Limits, State, Via, fly_run
from vehicle.avoidance import Avoidance, Knowledge
from vehicle.right_of_way import SAME_PLACE_M, RightOfWayRules, Trail
from vehicle.run_planner import RunPlanner
from vehicle.simulator import NS, KinematicSimulator
from vehicle.teammates import STEP_NS, Rank, announce

LOOK_AHEAD_NS = 200_000_000
RETRY_NS = 500_000_000
AROUND_AGAIN_NS = 8 * NS
"""Ways around resting teammates are looked for at once, then after this long, twice as long, and so on."""
WAIT_FOR_MAP_NS = 2 * NS
MAX_LAUNCHES = 40
"""Legs flown for one waypoint before it counts as blocked."""
DETOUR_SPEED_M_S = 1.5
"""Around things that the map did not show, slow enough to stop within what the sensor sees densely."""
ASIDE_CANDIDATES = 4
CLEAR_OUT_AGAIN_NS = 2 * NS
CORNERED_NS = 45 * NS
"""Who cannot leave a way that was asked for, neither aside nor back, for so long looks for a place farther off."""


class Outcome(Enum):
    """What became of the wish to go somewhere."""

    FLYING = "flying"
    WAITING = "waiting"
    BLOCKED = "blocked"


class Pilot:
    """Moves one vehicle. Clear legs are flown, teammates are waited for or gone around, never a reason to give up."""

    def __init__(self, vehicle_id: int, simulator: KinematicSimulator, avoidance: Avoidance, limits: Limits) -> None:
        self.simulator, self.avoidance, self.limits = simulator, avoidance, limits
        self._id = vehicle_id
        self.slow = replace(limits, speed_m_s=min(limits.speed_m_s, DETOUR_SPEED_M_S))
        self.detour: list[Array] = []
        self.braking = False
        self.why_blocked = ""
        self.trail = Trail()
        self.rules = RightOfWayRules(vehicle_id, avoidance.teammates, avoidance.separation_m)
        self.reaches_ns: list[int] = []
        """When the flight under way reaches the vias that it was asked for; empty for a detour."""
        self._planner = RunPlanner(avoidance, self.rules)
        self._way = simulator.flight.curve.end[None]
        self._news = True
        self._waiting = False
        self._no_way_since: int | None = None
        self._cornered_since: int | None = None
        self._retry_ns = self._make_way_ns = self._clear_out_ns = 0
        self._around_ns = self._around_step_ns = 0
        self._launches = 0
        self._narrow = self._careful = self._fresh_rest = False
        self._passing: list[tuple[int, Array]] = []
        self._checked: Knowledge | None = None
        self._check_ns = 0
        self._fresh = False

    @property
    def waiting(self) -> bool:
        """Whether the vehicle would go somewhere if it could."""
        return self._waiting

    def patient(self, t_ns: int) -> bool:
        """Whether it is too early to try again what did not go."""
        return t_ns < min(self._retry_ns, self._make_way_ns)

    def position(self, t_ns: int) -> Array:
        """(3,) where the vehicle is."""
        return self.simulator.at(t_ns).state.position

    def go(self, vias: list[Via], t_ns: int, wanted: list[Array]) -> Outcome:
        """Start towards the vias (one run); to be asked again at every rest until they are reached. wanted: the way to
        ask for where teammates are in the way, as far as to where the vehicle does some good."""
        if t_ns < self._retry_ns:
            return Outcome.WAITING
        here = self._rest(t_ns)
        if self._launches > MAX_LAUNCHES:
            return self._give_up("too many attempts", t_ns)
        if self.rules.leaves_the_air_to_another(t_ns) or (self.rules.begins_anew(t_ns) and not self._at_hover(here)):
            return self._clear_out(here, t_ns)
        self._cut_short(here, vias[0])
        plan = self._planner.plan(self.simulator.at(t_ns), *self._run(vias), t_ns)
        if plan.flight is not None:
            self._launch(plan.flight, plan.points, t_ns)
            self.reaches_ns = self.reaches_ns[len(self.detour):]
            return Outcome.FLYING
        if plan.solid:
            return self._go_around(vias[0], here, t_ns, wanted)
        if any(c.other_rests for c in plan.conflicts) and self._around_teammates(vias[0], here, t_ns):
            return Outcome.FLYING
        return self._wait(t_ns, [here, *self.detour, *wanted])

    def fly(self, via: Via, limits: Limits, t_ns: int) -> Outcome:
        """A leg that is vouched for (vertical over the own pad), checked against teammates alone."""
        if t_ns < self._retry_ns:
            return Outcome.WAITING
        here = self._rest(t_ns)
        flight = self._flight(via, limits, t_ns)
        if self.avoidance.conflicts(flight, np.stack([here, via.position]), t_ns):
            self._make_way_ns = t_ns + RETRY_NS
            return self._wait(t_ns, [here, via.position])
        self._launch(flight, [via.position], t_ns)
        return Outcome.FLYING

    def stop(self, t_ns: int) -> None:
        """Brake to rest on the way of the flight."""
        if self.braking or t_ns >= self.simulator.end_ns:
            return
        self.simulator.fly(self.simulator.flight.stop(self.simulator.elapsed_s(t_ns)), t_ns)
        self.braking, self._news = True, True

    def look_ahead(self, t_ns: int) -> bool:
        """Check the rest of the leg against what is new; True when that made the vehicle brake."""
        if self.braking or t_ns < self._check_ns or self._checked == self.avoidance.version:
            return False
        before, self._checked = self._checked, self.avoidance.version
        ahead = self.simulator.flight.curve.sample(STEP_NS / NS, self.simulator.elapsed_s(t_ns))[1]
        if self._narrow:
            clear = self.avoidance.may_leave(ahead)
        elif before is not None and before.map == self._checked.map:
            clear = self.avoidance.clear_of_hits(ahead)
        else:
            clear = self.avoidance.still_clear(ahead) and self.avoidance.clear_of_hits(ahead)
        if not clear:
            self.detour, self._careful = [], True
        if not clear or self._must_yield(t_ns):
            self.stop(t_ns)
        return self.braking

    def look_out_for_teammates(self, t_ns: int) -> None:
        """The part of look_ahead that also holds over the own pad."""
        if not self.braking and t_ns >= self._check_ns and self._checked != self.avoidance.version:
            self._checked = self.avoidance.version
            if self._must_yield(t_ns):
                self.stop(t_ns)

    def make_way(self, t_ns: int) -> bool:
        """Leave the place, aside or back, when somebody with a better rank has asked for a way through it."""
        if t_ns < self._make_way_ns:
            return False
        here = self._rest(t_ns)
        self._make_way_ns = t_ns + RETRY_NS
        if self.rules.leaves_the_air_to_another(t_ns) and self._clear_out(here, t_ns) is Outcome.FLYING:
            return True
        asked = self.rules.in_the_way(here)
        if asked is None:
            self._cornered_since = None
            self._behalf(None, [])
            return False
        rank, ways = asked
        if self.rules.may_step_aside(rank):
            for place in self.avoidance.aside(here, ways, t_ns)[:ASIDE_CANDIDATES]:
                if self._yield_to(place, t_ns):
                    self.rules.stepped_aside()
                    return True
        for place in self.trail.back:
            if self.avoidance.clear(here, place) and self._yield_to(place, t_ns):
                return True
        if self._take_refuge(ways, here, t_ns):
            return True
        self._behalf(rank, [here, *self.trail.back[:1]])
        return False

    def arrived(self) -> None:
        """A waypoint is done with: forget the trouble it made."""
        self.detour, self._launches, self._careful = [], 0, False
        self._waiting, self._no_way_since = False, None
        self._retry_ns = self._around_ns = self._around_step_ns = 0
        self._news = self._news or self.rules.wants is not None
        self.rules.done()

    def announcement(self, t_ns: int) -> AnnouncedTrajectory | None:
        """What teammates have to know, when it has changed."""
        if not self._news:
            return None
        self._news = False
        return announce(self._id, self.simulator.flight, self.simulator.start_ns, t_ns, self.rules.told)

    def _rest(self, t_ns: int) -> Array:
        """Where the vehicle rests now; the trail goes on to here."""
        here = self.position(t_ns)
        self.trail.note([p for passed_ns, p in self._passing if passed_ns < t_ns], here)
        self._passing = []
        for n in range(len(self.detour), 0, -1):
            if np.abs(self.detour[n - 1] - here).max() < SAME_PLACE_M:
                self.detour = self.detour[n:]
                break
        return here

    def _cut_short(self, here: Array, via: Via) -> None:
        """Leave out what the detour no longer needs, once at every rest."""
        if self.detour and self._fresh_rest:
            points = [*self.detour, via.position]
            ahead = range(len(self.detour), 0, -1)
            self.detour = self.detour[next((n for n in ahead if self.avoidance.clear(here, points[n])), 0):]
        self._fresh_rest = False

    def _run(self, vias: list[Via]) -> tuple[list[Via], Limits]:
        """Along the detour, if there is one, and on: one leg at a time where the map has proved wrong."""
        if self.detour and self._careful:
            return [_toward(vias[0], self.detour[0])], self.slow
        return [*(replace(_toward(vias[0], p), stop=False) for p in self.detour), *vias], self.limits

    def _flight(self, via: Via, limits: Limits, t_ns: int) -> Flight:
        now = self.simulator.at(t_ns)
        return fly_run(State.at_rest(now.state.position), now.yaw_enu_rad, now.gimbal_elevation_rad, [via], limits)

    def _go_around(self, via: Via, here: Array, t_ns: int, wanted: list[Array]) -> Outcome:
        """What is solid is in the way: plan, past resting teammates if there is such a way."""
        if self._around_teammates(via, here, t_ns):
            return Outcome.FLYING
        try:
            path = self.avoidance.way(here, via.position, t_ns, around_resting=False)
        except NoPath as e:
            self.detour = self.trail.back_to(lambda place: self.avoidance.clear(place, via.position))
            if not self.detour:
                return self._no_way(t_ns, f"no way there: {e}")
        else:
            self._careful = True
            if self._launch_detour(path, via, t_ns):
                return Outcome.FLYING
            self.detour = list(path[1:-1])
        return self._wait(t_ns, [here, *self.detour, *wanted])

    def _around_teammates(self, via: Via, here: Array, t_ns: int) -> bool:
        if t_ns < self._around_ns or self.avoidance.taken(via.position, t_ns):
            return False
        self._around_step_ns = min(2 * self._around_step_ns or AROUND_AGAIN_NS, 60 * NS)
        self._around_ns = t_ns + self._around_step_ns
        try:
            path = self.avoidance.way(here, via.position, t_ns, around_resting=True)
        except NoPath:
            return False
        return self._launch_detour(path, via, t_ns)

    def _launch_detour(self, path: Array, via: Via, t_ns: int) -> bool:
        first = via if len(path) == 2 else _toward(via, path[1])
        flight = self._flight(first, self.slow if self._careful else self.limits, t_ns)
        if self.avoidance.conflicts(flight, path[:2], t_ns) or self.rules.refuses(flight, t_ns):
            return False
        narrow = not self.avoidance.clear(path[0], path[1])
        self._launch(flight, [path[1]], t_ns)
        self._narrow, self.detour = narrow, list(path[1:-1])
        self.reaches_ns = self.reaches_ns[len(self.detour):]
        return True

    def _yield_to(self, place: Array, t_ns: int) -> bool:
        now = self.simulator.at(t_ns)
        flight = self._flight(Via(place, now.yaw_enu_rad, now.gimbal_elevation_rad), self.limits, t_ns)
        if self.avoidance.conflicts(flight, np.stack([now.state.position, place]), t_ns):
            return False
        self.detour = [self.position(t_ns), *self.detour]
        self._launch(flight, [place], t_ns)
        self.reaches_ns = []
        self._launches -= 1
        return True

    def _take_refuge(self, ways: list[Array], here: Array, t_ns: int) -> bool:
        """Who has been cornered for long flies towards the nearest place off all ways that were asked for."""
        if self._cornered_since is None:
            self._cornered_since = t_ns
        if t_ns - self._cornered_since < CORNERED_NS:
            return False
        self._cornered_since = t_ns - CORNERED_NS + AROUND_AGAIN_NS
        way = self.avoidance.refuge(here, ways, t_ns)
        return way is not None and self._fly_way(way, t_ns, come_back=True)

    def _at_hover(self, here: Array) -> bool:
        return self.trail.home is not None and bool(np.abs(self.trail.home - here).max() < SAME_PLACE_M)

    def _clear_out(self, here: Array, t_ns: int) -> Outcome:
        """To the hover point by whatever way is free, and stay there."""
        self._retry_ns, self._waiting = t_ns + RETRY_NS, True
        if t_ns < self._clear_out_ns or self.trail.home is None or self._at_hover(here):
            return Outcome.WAITING
        self._clear_out_ns = t_ns + CLEAR_OUT_AGAIN_NS
        try:
            way = self.avoidance.way(here, self.trail.home, t_ns, around_resting=True)
        except NoPath:
            return Outcome.WAITING
        self.detour = []
        return Outcome.FLYING if self._fly_way(way, t_ns, come_back=False) else Outcome.WAITING

    def _fly_way(self, way: Array, t_ns: int, come_back: bool) -> bool:
        """As much of a way (k, 3) as is free; back along it afterwards, or anew from there."""
        now = self.simulator.at(t_ns)
        vias = [Via(p, now.yaw_enu_rad, now.gimbal_elevation_rad, stop=n == len(way) - 1) for n, p in enumerate(way)]
        plan = self._planner.plan(now, vias[1:], self.limits, t_ns)
        if plan.flight is None:
            return False
        if come_back:
            self.detour = [*way[len(plan.points) - 1::-1], *self.detour]
        self._launch(plan.flight, plan.points, t_ns)
        self.reaches_ns = []
        return True

    def _launch(self, flight: Flight, points: list[Array], t_ns: int) -> None:
        self._way = np.array([self.position(t_ns), *points])
        self.simulator.fly(flight, t_ns)
        self.reaches_ns = [t_ns + round(float(s) * NS) for s in flight.reached_s]
        self._passing = list(zip(self.reaches_ns[:-1], points[:-1], strict=True))
        self.braking, self._narrow = False, False
        self._news = self._fresh = self._fresh_rest = True
        self._launches += 1
        self.rules.on_behalf = None
        self._checked, self._check_ns = self.avoidance.version, t_ns
        self._waiting, self._no_way_since, self._cornered_since = False, None, None
        self._retry_ns = self._make_way_ns = 0

    def _behalf(self, rank: Rank | None, path: list[Array]) -> None:
        before = self.rules.on_behalf
        if rank is None or len(path) < 2:
            self.rules.on_behalf = None
        else:
            self.rules.ask_for(rank, path)
        self._news = self._news or self.rules.on_behalf != before

    def _wait(self, t_ns: int, path: list[Array]) -> Outcome:
        before = self.rules.wants
        self.rules.ask(path, t_ns)
        self._waiting, self._news = True, self._news or before != self.rules.wants
        self._retry_ns = t_ns + RETRY_NS
        return Outcome.WAITING

    def _no_way(self, t_ns: int, why: str) -> Outcome:
        self._waiting, self.detour = True, []
        if self._no_way_since is None:
            self._no_way_since = t_ns
        if t_ns - self._no_way_since >= WAIT_FOR_MAP_NS:
            return self._give_up(why, t_ns)
        self._retry_ns = t_ns + RETRY_NS
        return Outcome.WAITING

    def _give_up(self, why: str, t_ns: int) -> Outcome:
        self.why_blocked = why
        self.arrived()
        self._retry_ns = t_ns + RETRY_NS
        return Outcome.BLOCKED

    def _must_yield(self, t_ns: int) -> bool:
        """When two have set out at once the one that goes first flies on; whoever finds another one braking brakes."""
        simulator = self.simulator
        if self._fresh:
            self._fresh, self._checked = False, None
            self._check_ns = t_ns + LOOK_AHEAD_NS
            conflicts = self.avoidance.conflicts(simulator.flight, self._way, t_ns, simulator.start_ns)
            return any(self.avoidance.teammates.goes_before(c.vehicle_id, self.rules.rank) for c in conflicts)
        return bool(self.avoidance.conflicts_in_flight(simulator.flight, simulator.start_ns, t_ns))


def _toward(via: Via, position: Array) -> Via:
    return replace(via, position=position, settle_s=0.0, pass_m=0.0, speed_m_s=math.inf)
