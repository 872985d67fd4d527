"""Gets the vehicle to a point or says why not: launches clear legs, watches them, brakes, waits, goes around."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum

import numpy as np

from missions.frames import Array
from missions.messages import AnnouncedTrajectory
from planning.paths import NoPath
from planning.trajectories import Flight, Limits, State, Via, brake, fly_run
from vehicle.avoidance import Avoidance, Knowledge
from vehicle.simulator import NS, KinematicSimulator, coasting
from vehicle.teammates import Conflict, announce

LOOK_AHEAD_NS = 200_000_000
RETRY_NS = 500_000_000
WAIT_FOR_TEAMMATE_NS = 20 * NS
WAIT_FOR_MAP_NS = 2 * NS
MAX_LAUNCHES = 40
"""Legs flown for one waypoint before it counts as blocked."""
DETOUR_SPEED_M_S = 1.5
"""Around things that the map did not show, slow enough to stop within what the sensor sees densely."""
IN_FLIGHT_SPARE_M = 0.1
REACTION_S = 0.5


class Outcome(Enum):
    """What became of the wish to go somewhere."""

    FLYING = "flying"
    WAITING = "waiting"
    BLOCKED = "blocked"


class Pilot:
    """Moves one vehicle. Clear legs are flown, moving teammates are waited for, what rests is gone around."""

    def __init__(self, vehicle_id: int, simulator: KinematicSimulator, avoidance: Avoidance, limits: Limits) -> None:
        self.simulator, self.avoidance, self.limits = simulator, avoidance, limits
        self._id = vehicle_id
        self.slow = replace(limits, speed_m_s=min(limits.speed_m_s, DETOUR_SPEED_M_S))
        self.detour: list[Array] = []
        self.braking = False
        self.why_blocked = ""
        self._wants: Array | None = None
        self._news = True
        self._waiting_since: int | None = None
        self._retry_ns = 0
        self._launches = 0
        self._narrow = False
        self._checked: Knowledge | None = None
        self._check_ns = 0

    @property
    def waiting(self) -> bool:
        """Whether the vehicle would go somewhere if it could."""
        return self._waiting_since is not None

    def position(self, t_ns: int) -> Array:
        """(3,) where the vehicle is."""
        return self.simulator.at(t_ns).state.position

    def go(self, vias: list[Via], t_ns: int) -> Outcome:
        """Start towards the vias (a straight run); to be asked again at every rest until they are reached."""
        if t_ns < self._retry_ns:
            return Outcome.WAITING
        here = self.position(t_ns)
        if self._launches > MAX_LAUNCHES:
            return self._give_up("too many attempts")
        run, limits = ([self._toward(vias[0], self.detour[0])], self.slow) if self.detour else (vias, self.limits)
        flight = self._flight(run, limits, t_ns)
        hindrance = self._hindrance(flight, here, t_ns)
        if hindrance == "":
            self._launch(flight, t_ns)
            return Outcome.FLYING
        if hindrance == "moving":
            return self._wait(t_ns, WAIT_FOR_TEAMMATE_NS, "a teammate crosses", None)
        return self._go_around(vias[0], here, t_ns)

    def fly(self, via: Via, limits: Limits, t_ns: int) -> Outcome:
        """A leg that is vouched for (vertical over the own pad), checked against teammates alone."""
        if t_ns < self._retry_ns:
            return Outcome.WAITING
        flight = self._flight([via], limits, t_ns)
        if self.avoidance.conflicts(flight, t_ns, t_ns):
            self._wait(t_ns, WAIT_FOR_TEAMMATE_NS, "a teammate is over the pad", None)
            return Outcome.WAITING
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
        self.detour = []

    def look_ahead(self, t_ns: int) -> bool:
        """Check the rest of the leg against what is new; True when that made the vehicle brake."""
        if self.braking or t_ns < self._check_ns or self._checked == self.avoidance.version:
            return False
        before, self._checked = self._checked, self.avoidance.version
        self._check_ns = t_ns + LOOK_AHEAD_NS
        here, end = self.position(t_ns), self.simulator.flight.curve.end
        if self._narrow:
            clear = self.avoidance.may_leave(here, end)
        elif before is not None and before.map == self._checked.map:
            clear = self.avoidance.clear_of_hits(here, end)
        else:
            clear = self.avoidance.clear(here, end)
        if not clear or self._must_yield(t_ns):
            self.stop(t_ns)
        return self.braking

    def look_out_for_teammates(self, t_ns: int) -> None:
        """The part of look_ahead that also holds over the own pad."""
        if not self.braking and t_ns >= self._check_ns:
            self._check_ns = t_ns + LOOK_AHEAD_NS
            if self._must_yield(t_ns):
                self.stop(t_ns)

    def make_room(self, t_ns: int, idle: bool) -> bool:
        """Move aside when a teammate wants the place where this one rests without need, or with the higher id."""
        here = self.position(t_ns)
        near = self.avoidance.separation_m
        for vehicle_id, place in self.avoidance.teammates.wanted():
            if (idle or vehicle_id < self._id) and float(np.linalg.norm(here - place)) < near:
                aside = self.avoidance.room_for(here, place, t_ns)
                if aside is None:
                    continue
                now = self.simulator.at(t_ns)
                flight = self._flight([Via(aside, now.yaw_enu_rad, now.gimbal_elevation_rad)], self.slow, t_ns)
                if not self._hindrance(flight, here, t_ns):
                    self._launch(flight, t_ns)
                    return True
        return False

    def arrived(self) -> None:
        """A waypoint is done with: forget the trouble it made."""
        self.detour, self._launches = [], 0
        self._stop_waiting()
        self._retry_ns = 0

    def announcement(self, t_ns: int) -> AnnouncedTrajectory | None:
        """What teammates have to know, when it has changed."""
        if not self._news:
            return None
        self._news = False
        return announce(self._id, self.simulator.flight, self.simulator.start_ns, t_ns, self._wants)

    def _toward(self, via: Via, position: Array) -> Via:
        return replace(via, position=position, settle_s=0.0)

    def _flight(self, vias: list[Via], limits: Limits, t_ns: int) -> Flight:
        now = self.simulator.at(t_ns)
        return fly_run(State.at_rest(now.state.position), now.yaw_enu_rad, now.gimbal_elevation_rad, vias, limits)

    def _hindrance(self, flight: Flight, here: Array, t_ns: int) -> str:
        """ "", "moving" (a teammate will be in the way for a while) or "solid"."""
        if not self.avoidance.clear(here, flight.curve.end):
            return "solid"
        conflicts = self.avoidance.conflicts(flight, t_ns, t_ns)
        if not conflicts:
            return ""
        return "solid" if any(c.other_rests for c in conflicts) else "moving"

    def _go_around(self, via: Via, here: Array, t_ns: int) -> Outcome:
        try:
            path = self.avoidance.way(here, via.position, t_ns)
        except NoPath as e:
            if self.avoidance.blocked_by_teammate(via.position, t_ns):
                return self._wait(t_ns, WAIT_FOR_TEAMMATE_NS, "a teammate rests there", via.position)
            return self._wait(t_ns, WAIT_FOR_MAP_NS, f"no way there ({e.reason})", None)
        first = via if len(path) == 2 else self._toward(via, path[1])
        flight = self._flight([first], self.slow, t_ns)
        narrow = not self.avoidance.clear(here, path[1])
        if self.avoidance.conflicts(flight, t_ns, t_ns):
            outcome = self._wait(t_ns, WAIT_FOR_TEAMMATE_NS, "a teammate crosses the way around", via.position)
            self._retry_ns += RETRY_NS  # planning around is the costliest thing a vehicle does
            return outcome
        self._launch(flight, t_ns)
        self._narrow, self.detour = narrow, list(path[1:-1])
        return Outcome.FLYING

    def _launch(self, flight: Flight, t_ns: int) -> None:
        self.simulator.fly(flight, t_ns)
        self.braking, self._news, self._narrow = False, True, False
        self._launches += 1
        self._checked, self._check_ns = self.avoidance.version, t_ns + LOOK_AHEAD_NS
        if self.detour and np.array_equal(flight.curve.end, self.detour[0]):
            self.detour = self.detour[1:]
        self._stop_waiting()

    def _wait(self, t_ns: int, limit_ns: int, why: str, wants: Array | None) -> Outcome:
        if self._waiting_since is None:
            self._waiting_since = t_ns
        if t_ns - self._waiting_since >= limit_ns:
            return self._give_up(why)
        self._retry_ns, self.detour = t_ns + RETRY_NS, []
        if (wants is None) != (self._wants is None):
            self._wants, self._news = wants, True
        return Outcome.WAITING

    def _give_up(self, why: str) -> Outcome:
        self.why_blocked = why
        self.arrived()
        return Outcome.BLOCKED

    def _stop_waiting(self) -> None:
        self._waiting_since = None
        if self._wants is not None:
            self._wants, self._news = None, True

    def _must_yield(self, t_ns: int) -> bool:
        simulator = self.simulator
        conflicts = self.avoidance.conflicts(simulator.flight, simulator.start_ns, t_ns, IN_FLIGHT_SPARE_M)
        return any(self._yields_to(c) for c in conflicts)

    def _yields_to(self, conflict: Conflict) -> bool:
        """The higher id brakes; so does anybody when the other cannot, or when it is nearly too late."""
        stopping_s = self.limits.speed_m_s / self.limits.acceleration_m_s2 + REACTION_S
        return conflict.vehicle_id < self._id or conflict.other_rests or conflict.in_s < stopping_s
