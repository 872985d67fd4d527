"""Gets the vehicle to a point or says why not: flies clear legs, waits for teammates, goes around what is solid."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum

import numpy as np

from missions.frames import Array
from planning.paths import NoPath
from planning.trajectories import Limits, Via
from planning.trajectories.homing import DETOUR_SPEED_M_S
from vehicle.avoidance import Avoidance
from vehicle.body import Body
from vehicle.give_way import RETRY_NS, GiveWay
from vehicle.helm import Helm
from vehicle.simulator import NS
from vehicle.teammates import LOST_TEAMMATE

AROUND_AGAIN_NS = 8 * NS
"""Ways around resting teammates are looked for at once, then after this long, twice as long, and so on."""
WAIT_FOR_MAP_NS = 2 * NS
MAX_LAUNCHES = 40
"""Legs flown for one waypoint before it counts as blocked."""


class Outcome(Enum):
    """What became of the wish to go somewhere."""

    FLYING = "flying"
    WAITING = "waiting"
    BLOCKED = "blocked"


class Pilot:
    """Moves one vehicle. Clear legs are flown, teammates are waited for or gone around, never a reason to give up."""

    def __init__(self, vehicle_id: int, body: Body, avoidance: Avoidance, limits: Limits) -> None:
        self.body, self.avoidance, self.limits = body, avoidance, limits
        self.slow = replace(limits, speed_m_s=min(limits.speed_m_s, DETOUR_SPEED_M_S))
        self.helm = Helm(vehicle_id, body, avoidance)
        self.why_blocked = ""
        self._give_way = GiveWay(self.helm, limits)
        self._around_ns = self._around_step_ns = 0

    def obey(self, limits: Limits) -> None:
        """Keep these limits from the next flight on."""
        self.limits, self.slow = limits, replace(limits, speed_m_s=min(limits.speed_m_s, DETOUR_SPEED_M_S))
        self._give_way.limits = limits

    @property
    def waiting(self) -> bool:
        """Whether the vehicle would go somewhere if it could."""
        return self.helm.rest.waiting

    def patient(self, t_ns: int) -> bool:
        """Whether it is too early to try again what did not go."""
        return t_ns < min(self.helm.rest.retry_ns, self.helm.rest.make_way_ns)

    def position(self, t_ns: int) -> Array:
        """(3,) where the vehicle is."""
        return self.helm.position(t_ns)

    def go(self, vias: list[Via], t_ns: int, wanted: list[Array]) -> Outcome:
        """Start towards the vias (one run); to be asked again at every rest until they are reached. wanted: the way to
        ask for where teammates are in the way, as far as to where the vehicle does some good."""
        helm = self.helm
        if t_ns < helm.rest.retry_ns:
            return Outcome.WAITING
        here = helm.resting_place(t_ns)
        if helm.launches > MAX_LAUNCHES:
            return self._give_up("too many attempts", t_ns)
        if self._give_way.must_clear_out(here, t_ns):
            return Outcome.FLYING if self._give_way.clear_out(here, t_ns) else Outcome.WAITING
        helm.shorten_detour(here, vias[0].position)
        run = helm.run(*self._along_detour(vias), t_ns)
        if run.flight is not None:
            helm.launch(run.flight, run.points, t_ns, before=len(helm.detour))
            return Outcome.FLYING
        if run.solid:
            return self._go_around(vias[0], here, t_ns, wanted)
        if any(c.other_rests for c in run.conflicts) and self._around_teammates(vias[0], here, t_ns):
            return Outcome.FLYING
        return self._wait([here, *helm.detour, *wanted], t_ns)

    def fly(self, via: Via, limits: Limits, t_ns: int) -> Outcome:
        """A leg that is vouched for (vertical over the own pad), checked against teammates alone."""
        if t_ns < self.helm.rest.retry_ns:
            return Outcome.WAITING
        here = self.helm.resting_place(t_ns)
        flight = self.helm.leg(via, limits, t_ns)
        if self.avoidance.conflicts(flight, np.stack([here, via.position]), t_ns):
            self.helm.rest.make_way_ns = t_ns + RETRY_NS
            return self._wait([here, via.position], t_ns)
        self.helm.launch(flight, [via.position], t_ns)
        return Outcome.FLYING

    def make_way(self, t_ns: int) -> bool:
        """At rest: leave the place when somebody with a better rank has asked for a way through it."""
        return self._give_way.make_way(t_ns)

    def arrived(self) -> None:
        """A waypoint is done with: forget the trouble it made."""
        helm, rest = self.helm, self.helm.rest
        helm.detour, helm.launches, helm.careful = [], 0, False
        rest.waiting, rest.no_way_since, rest.retry_ns = False, None, 0
        self._around_ns = self._around_step_ns = 0
        helm.news = helm.news or helm.rules.wants is not None
        helm.rules.done()

    def _along_detour(self, vias: list[Via]) -> tuple[list[Via], Limits]:
        """Along the detour, if there is one, and on: one leg at a time where the map has proved wrong."""
        detour = self.helm.detour
        if detour and self.helm.careful:
            return [_toward(vias[0], detour[0])], self.slow
        return [*(replace(_toward(vias[0], p), stop=False) for p in detour), *vias], self.limits

    def _go_around(self, via: Via, here: Array, t_ns: int, wanted: list[Array]) -> Outcome:
        """What is solid is in the way: plan, past resting teammates if there is such a way."""
        helm = self.helm
        if self._around_teammates(via, here, t_ns):
            return Outcome.FLYING
        try:
            path = self.avoidance.way(here, via.position, t_ns, around_resting=False)
        except NoPath as e:
            helm.detour = helm.trail.back_to(lambda place: self.avoidance.clear(place, via.position))
            if not helm.detour:
                shut = self.avoidance.shut_by_dead(here, via.position)
                return self._no_way(t_ns, f"no way there past {LOST_TEAMMATE}" if shut else f"no way there: {e}")
        else:
            helm.careful = True
            if self._launch_detour(path, via, t_ns):
                return Outcome.FLYING
            helm.detour = list(path[1:-1])
        return self._wait([here, *helm.detour, *wanted], t_ns)

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
        """The first leg of a path (k, 3) to the via; what comes after it is the detour."""
        helm = self.helm
        first = via if len(path) == 2 else _toward(via, path[1])
        flight = helm.leg(first, self.slow if helm.careful else self.limits, t_ns)
        if self.avoidance.conflicts(flight, path[:2], t_ns) or helm.rules.refuses(flight, t_ns):
            return False
        narrow = not self.avoidance.clear(path[0], path[1])
        helm.detour = list(path[1:-1])
        helm.launch(flight, [path[1]], t_ns, before=len(helm.detour), narrow=narrow)
        return True

    def _wait(self, path: list[Array], t_ns: int) -> Outcome:
        self._give_way.wait(path, t_ns)
        return Outcome.WAITING

    def _no_way(self, t_ns: int, why: str) -> Outcome:
        rest = self.helm.rest
        rest.waiting, self.helm.detour = True, []
        if rest.no_way_since is None:
            rest.no_way_since = t_ns
        if t_ns - rest.no_way_since >= WAIT_FOR_MAP_NS:
            return self._give_up(why, t_ns)
        rest.retry_ns = t_ns + RETRY_NS
        return Outcome.WAITING

    def _give_up(self, why: str, t_ns: int) -> Outcome:
        self.why_blocked = why
        self.arrived()
        self.helm.rest.retry_ns = t_ns + RETRY_NS
        return Outcome.BLOCKED


def _toward(via: Via, position: Array) -> Via:
    return replace(via, position=position, settle_s=0.0, pass_m=0.0, speed_m_s=math.inf)
