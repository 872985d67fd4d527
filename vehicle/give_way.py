"""What a vehicle at rest does about the others: waits for them, leaves their ways, clears out for the longest wait."""

from __future__ import annotations

import numpy as np

from missions.frames import Array
from planning.paths import NoPath
from planning.trajectories import Limits, Via
from vehicle.helm import Helm
from vehicle.right_of_way import same_place
from vehicle.simulator import NS
from vehicle.teammates import Rank

RETRY_NS = 500_000_000
ASIDE_CANDIDATES = 4
CLEAR_OUT_AGAIN_NS = 2 * NS
CORNERED_NS, REFUGE_AGAIN_NS = 45 * NS, 8 * NS
"""Who cannot leave a way that was asked for, neither aside nor back, for so long looks for a place farther off, and
again after so long."""


class GiveWay:
    """Carries out what the rules of right of way ask of one vehicle."""

    def __init__(self, helm: Helm, limits: Limits) -> None:
        self._helm, self.limits = helm, limits
        self._clear_out_ns = 0

    def wait(self, path: list[Array], t_ns: int) -> None:
        """Ask for the way along the path, and try again later."""
        rules, rest = self._helm.rules, self._helm.rest
        before = rules.wants
        rules.ask(path, t_ns)
        self._helm.news = self._helm.news or before != rules.wants
        rest.waiting, rest.retry_ns = True, t_ns + RETRY_NS

    def make_way(self, t_ns: int) -> bool:
        """Leave the place, aside or back, when somebody with a better rank has asked for a way through it."""
        helm = self._helm
        if t_ns < helm.rest.make_way_ns:
            return False
        here = helm.resting_place(t_ns)
        helm.rest.make_way_ns = t_ns + RETRY_NS
        if helm.rules.leaves_the_air_to_another(t_ns) and self.clear_out(here, t_ns):
            return True
        asked = helm.rules.in_the_way(here)
        if asked is None:
            helm.rest.cornered_since = None
            self._ask_on_behalf(None, [])
            return False
        rank, ways = asked
        if self._step_aside(rank, ways, here, t_ns) or self._step_back(here, t_ns) \
                or self._take_refuge(ways, here, t_ns):
            return True
        self._ask_on_behalf(rank, [here, *helm.trail.back[:1]])
        return False

    def must_clear_out(self, here: Array, t_ns: int) -> bool:
        """Whether a wait, another one's or the own, has lasted so long that this vehicle goes to its hover point."""
        rules = self._helm.rules
        return rules.leaves_the_air_to_another(t_ns) or (rules.begins_anew(t_ns) and not self._at_hover(here))

    def clear_out(self, here: Array, t_ns: int) -> bool:
        """To the hover point by whatever way is free, and stay there; True when that made the vehicle fly."""
        helm, home = self._helm, self._helm.trail.home
        helm.rest.retry_ns, helm.rest.waiting = t_ns + RETRY_NS, True
        if t_ns < self._clear_out_ns or home is None or self._at_hover(here):
            return False
        self._clear_out_ns = t_ns + CLEAR_OUT_AGAIN_NS
        try:
            way = helm.avoidance.way(here, home, t_ns, around_resting=True)
        except NoPath:
            return False
        helm.detour = []
        return self._fly_way(way, t_ns, come_back=False)

    def _at_hover(self, here: Array) -> bool:
        home = self._helm.trail.home
        return home is not None and same_place(home, here)

    def _step_aside(self, rank: Rank, ways: list[Array], here: Array, t_ns: int) -> bool:
        if not self._helm.rules.may_step_aside(rank):
            return False
        for place in self._helm.avoidance.aside(here, ways, t_ns)[:ASIDE_CANDIDATES]:
            if self._yield_to(place, here, t_ns):
                self._helm.rules.stepped_aside()
                return True
        return False

    def _step_back(self, here: Array, t_ns: int) -> bool:
        return any(self._helm.avoidance.clear(here, place) and self._yield_to(place, here, t_ns)
                   for place in self._helm.trail.back)

    def _yield_to(self, place: Array, here: Array, t_ns: int) -> bool:
        """Straight to the place, if teammates allow it, and back afterwards."""
        helm, now = self._helm, self._helm.body.at(t_ns)
        flight = helm.leg(Via(place, now.yaw_enu_rad, now.gimbal_elevation_rad), self.limits, t_ns)
        if helm.avoidance.conflicts(flight, np.stack([here, place]), t_ns):
            return False
        helm.detour = [here, *helm.detour]
        helm.launch(flight, [place], t_ns, before=1)
        helm.launches -= 1
        return True

    def _take_refuge(self, ways: list[Array], here: Array, t_ns: int) -> bool:
        """Who has been cornered for long flies towards the nearest place off all ways that were asked for."""
        rest = self._helm.rest
        if rest.cornered_since is None:
            rest.cornered_since = t_ns
        if t_ns - rest.cornered_since < CORNERED_NS:
            return False
        rest.cornered_since = t_ns - CORNERED_NS + REFUGE_AGAIN_NS
        way = self._helm.avoidance.refuge(here, ways, t_ns)
        return way is not None and self._fly_way(way, t_ns, come_back=True)

    def _fly_way(self, way: Array, t_ns: int, come_back: bool) -> bool:
        """As much of a way (k, 3) as is free; back along it afterwards, or anew from there."""
        helm, now = self._helm, self._helm.body.at(t_ns)
        vias = [Via(p, now.yaw_enu_rad, now.gimbal_elevation_rad, stop=n == len(way) - 1) for n, p in enumerate(way)]
        run = helm.run(vias[1:], self.limits, t_ns)
        if run.flight is None:
            return False
        if come_back:
            helm.detour = [*way[len(run.points) - 1::-1], *helm.detour]
        helm.launch(run.flight, run.points, t_ns, before=len(run.points))
        return True

    def _ask_on_behalf(self, rank: Rank | None, path: list[Array]) -> None:
        """For a way out, with the rank of the one that is in the way of; for nothing where there is none to ask for."""
        rules = self._helm.rules
        before = rules.on_behalf
        if rank is None or len(path) < 2:
            rules.on_behalf = None
        else:
            rules.ask_for(rank, path)
        self._helm.news = self._helm.news or rules.on_behalf != before
