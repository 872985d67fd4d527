"""Gets the vehicle to a point or says why not: launches clear legs, watches them, waits, goes around, makes way."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum

import numpy as np

from missions.frames import Array
from missions.messages import AnnouncedTrajectory
from planning.paths import NoPath
from planning.trajectories import Flight, Limits, State, Via, brake, fly_run
from vehicle.avoidance import Avoidance, Knowledge
from vehicle.right_of_way import SAME_PLACE_M, RightOfWayRules, Trail
from vehicle.simulator import NS, KinematicSimulator, coasting
from vehicle.teammates import Rank, announce

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
        self._news = True
        self._waiting = False
        self._no_way_since: int | None = None
        self._retry_ns = self._make_way_ns = 0
        self._around_ns = self._around_step_ns = 0
        self._launches = 0
        self._narrow = self._careful = self._shortcut = False
        self._passing: list[tuple[int, Array]] = []
        self._told_rank = self.rules.rank
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

    def go(self, vias: list[Via], t_ns: int, onward: list[Array]) -> Outcome:
        """Start towards the vias (one run); to be asked again at every rest until they are reached. onward: where the
        vehicle has to go on to before it does anybody any good."""
        if t_ns < self._retry_ns:
            return Outcome.WAITING
        here = self._rest(t_ns)
        if self._launches > MAX_LAUNCHES:
            return self._give_up("too many attempts")
        if self.detour and self._shortcut:
            self._shortcut = False
            points = [*self.detour, vias[0].position]
            self.detour = self.detour[next((n for n in range(len(self.detour), 0, -1)
                                            if self.avoidance.clear(here, points[n])), 0):]
        run = [self._toward(vias[0], self.detour[0])] if self.detour else vias
        limits = self.slow if self.detour and self._careful else self.limits
        if not self.avoidance.clear(here, run[-1].position):
            return self._go_around(vias, here, t_ns, onward)
        flight = self._flight(run, limits, t_ns)
        conflicts = self.avoidance.conflicts(flight, t_ns)
        if not conflicts and not self.rules.refuses(flight, t_ns):
            self._launch(flight, t_ns)
            return Outcome.FLYING
        if any(c.other_rests for c in conflicts) and self._around_teammates(vias[0], here, t_ns):
            return Outcome.FLYING
        return self._wait(t_ns, [here, *self.detour, *(v.position for v in vias), *onward])

    def fly(self, via: Via, limits: Limits, t_ns: int) -> Outcome:
        """A leg that is vouched for (vertical over the own pad), checked against teammates alone."""
        if t_ns < self._retry_ns:
            return Outcome.WAITING
        here = self._rest(t_ns)
        flight = self._flight([via], limits, t_ns)
        if self.avoidance.conflicts(flight, t_ns):
            return self._wait(t_ns, [here, via.position])
        self._launch(flight, t_ns)
        return Outcome.FLYING

    def stop(self, t_ns: int) -> None:
        """Brake to rest on the line of flight."""
        if self.braking or t_ns >= self.simulator.end_ns:
            return
        now = self.simulator.at(t_ns)
        flight = coasting(brake(now.state, self.limits), now.yaw_enu_rad, now.gimbal_elevation_rad)
        self.simulator.fly(flight, t_ns)
        self.braking, self._news = True, True

    def look_ahead(self, t_ns: int) -> bool:
        """Check the rest of the leg against what is new; True when that made the vehicle brake."""
        if self.braking or t_ns < self._check_ns or self._checked == self.avoidance.version:
            return False
        before, self._checked = self._checked, self.avoidance.version
        here, end = self.position(t_ns), self.simulator.flight.curve.end
        if self._narrow:
            clear = self.avoidance.may_leave(here, end)
        elif before is not None and before.map == self._checked.map:
            clear = self.avoidance.clear_of_hits(here, end)
        else:
            clear = self.avoidance.clear(here, end)
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
        asked = self.rules.in_the_way(here)
        if asked is None:
            self._behalf(None, [])
            return False
        rank, ways = asked
        if self.rules.may_step_aside(rank):
            for place in self.avoidance.aside(here, ways, t_ns)[:ASIDE_CANDIDATES]:
                if self._yield_to(place, t_ns):
                    self.rules.stepped_aside()
                    return True
        back = self.trail.back
        if back is not None and self.avoidance.clear(here, back) and self._yield_to(back, t_ns):
            return True
        self._behalf(rank, [] if back is None else [here, back])
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

    def _toward(self, via: Via, position: Array) -> Via:
        return replace(via, position=position, settle_s=0.0)

    def _flight(self, vias: list[Via], limits: Limits, t_ns: int) -> Flight:
        now = self.simulator.at(t_ns)
        return fly_run(State.at_rest(now.state.position), now.yaw_enu_rad, now.gimbal_elevation_rad, vias, limits)

    def _go_around(self, vias: list[Via], here: Array, t_ns: int, onward: list[Array]) -> Outcome:
        """What is solid is in the way: plan, past resting teammates if there is such a way."""
        if self._around_teammates(vias[0], here, t_ns):
            return Outcome.FLYING
        try:
            path = self.avoidance.way(here, vias[0].position, t_ns, around_resting=False)
        except NoPath as e:
            self.detour = self.trail.back_to(lambda place: self.avoidance.clear(place, vias[0].position))
            if self.detour:
                return self._wait(t_ns, [here, *self.detour, *(v.position for v in vias), *onward])
            return self._no_way(t_ns, f"no way there ({e.reason})")
        self._careful = True
        if self._launch_detour(path, vias[0], t_ns):
            return Outcome.FLYING
        self.detour = list(path[1:-1])
        return self._wait(t_ns, [*path, *(v.position for v in vias[1:]), *onward])

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
        first = via if len(path) == 2 else self._toward(via, path[1])
        flight = self._flight([first], self.slow if self._careful else self.limits, t_ns)
        if self.avoidance.conflicts(flight, t_ns) or self.rules.refuses(flight, t_ns):
            return False
        narrow = not self.avoidance.clear(path[0], path[1])
        self._launch(flight, t_ns)
        self._narrow, self.detour = narrow, list(path[1:-1])
        return True

    def _yield_to(self, place: Array, t_ns: int) -> bool:
        now = self.simulator.at(t_ns)
        flight = self._flight([Via(place, now.yaw_enu_rad, now.gimbal_elevation_rad)], self.limits, t_ns)
        if self.avoidance.conflicts(flight, t_ns):
            return False
        self.detour = [self.position(t_ns), *self.detour]
        self._launch(flight, t_ns)
        self._launches -= 1
        return True

    def _launch(self, flight: Flight, t_ns: int) -> None:
        self.simulator.fly(flight, t_ns)
        self.braking, self._narrow = False, False
        self._news = self._fresh = self._shortcut = True
        self._launches += 1
        self.rules.on_behalf = None
        self._checked, self._check_ns = self.avoidance.version, t_ns
        self._waiting, self._no_way_since = False, None
        self._retry_ns = self._make_way_ns = 0

    def _behalf(self, rank: Rank | None, path: list[Array]) -> None:
        before = self.rules.on_behalf
        if rank is None or not path:
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
            return self._give_up(why)
        self._retry_ns = t_ns + RETRY_NS
        return Outcome.WAITING

    def _give_up(self, why: str) -> Outcome:
        self.why_blocked = why
        self.arrived()
        return Outcome.BLOCKED

    def _must_yield(self, t_ns: int) -> bool:
        """When two have set out at once the one that goes first flies on; whoever finds another one braking brakes."""
        simulator = self.simulator
        if self._fresh:
            self._fresh, self._checked = False, None
            self._check_ns = t_ns + LOOK_AHEAD_NS
            conflicts = self.avoidance.conflicts(simulator.flight, t_ns, simulator.start_ns)
            return any(self.avoidance.teammates.goes_before(c.vehicle_id, self.rules.rank) for c in conflicts)
        return bool(self.avoidance.conflicts_in_flight(simulator.flight, simulator.start_ns, t_ns))
