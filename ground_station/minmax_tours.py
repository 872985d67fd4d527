"""Our method: tours after which the last vehicle is home as early as possible, within every battery."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ground_station.ledger import ENERGY, UNREACHABLE
from ground_station.leg_costs import Cost, LegCosts
from ground_station.tours import Flyer, Flying, Outcome, Tours
from missions.camera import View
from missions.frames import Array
from missions.mission import Mission
from planning.allocate.minmax import Effort, solve
from planning.allocate.problem import Allocation, Problem, Ways
from planning.allocate.reassign import IN_FLIGHT, reassign

AT_THE_START = Effort(iterations=100_000)
"""About 1 s on four processors."""


class MinmaxTours:
    """Allocation over flown legs, and reassignment from the plan that is being flown."""

    def __init__(self, views: list[View], mission: Mission, costs: LegCosts, fresh_percent: float,
                 at_the_start: Effort = AT_THE_START, in_flight: Effort = IN_FLIGHT) -> None:
        """fresh_percent: what may be used of a fresh battery."""
        self._at_the_start, self._in_flight = at_the_start, in_flight
        self._ids = [v.view_id for v in views]
        self._index = {view_id: i for i, view_id in enumerate(self._ids)}
        self._positions = np.array([v.pose.position_enu_m for v in views]).reshape(-1, 3)
        self._costs, self._fresh_percent, self._seed = costs, fresh_percent, mission.seed
        self._swap_s = mission.battery.swap_s

    def begin(self, flyers: list[Flyer]) -> Tours:
        """The first tours."""
        problem = self._problem(flyers, list(range(len(self._ids))), {})
        return self._tours(flyers, self._ids, problem, solve(problem, self._at_the_start, self._seed))

    def again(self, flyers: list[Flyer], now: Flying) -> Tours:
        """Few changes: every vehicle keeps what it has been sent, at least its next view."""
        flying = [now.sorties[f.vehicle_id] for f in flyers]
        views = [*(v for sorties in flying for sortie in sorties for v in sortie), *now.homeless]
        at = {view_id: n for n, view_id in enumerate(views)}
        problem = self._problem([self._at_next_view(f, now) for f in flyers], [self._index[v] for v in views],
                                now.refused_by)
        locked = [max(1, now.sent.get(f.vehicle_id, 0)) for f in flyers]
        found = reassign(problem, [[[at[v] for v in sortie] for sortie in sorties] for sorties in flying], locked,
                         self._in_flight, self._seed)
        return self._tours(flyers, views, problem, found.allocation)

    def _at_next_view(self, flyer: Flyer, now: Flying) -> Flyer:
        """A vehicle under way as if it were at the view before it: the rest of that leg is the same whatever is
        decided, and ways from there are known."""
        if not now.sent.get(flyer.vehicle_id, 0):
            return flyer
        view = self._index[now.sorties[flyer.vehicle_id][0][0]]
        return replace(flyer, position_enu_m=self._positions[view])

    def _problem(self, flyers: list[Flyer], chosen: list[int], refused_by: Mapping[int, Sequence[int]]) -> Problem:
        starts = [self._costs.from_place(f.position_enu_m) for f in flyers]
        leave = [self._costs.from_place(f.home_enu_m) for f in flyers]
        back = [self._costs.home(f.home_enu_m, f.at_home_percent) for f in flyers]
        straight = [self._costs.direct(f.position_enu_m, f.home_enu_m) for f in flyers]
        seconds, percent = (self._ways(currency, chosen, starts, leave, back, straight)
                            for currency in ("seconds", "percent"))
        forbidden = np.array([[f.vehicle_id in refused_by.get(self._ids[i], ()) for i in chosen] for f in flyers],
                             dtype=np.bool_).reshape(len(flyers), len(chosen))
        fresh = np.array([self._fresh_percent - f.take_off_percent for f in flyers])
        return Problem(seconds, energy=percent, available_percent=np.array([f.usable_percent for f in flyers]),
                       swapped_percent=fresh, swap_s=self._swap_s,
                       max_sorties=np.array([1 + f.swaps for f in flyers], dtype=np.int64), forbidden=forbidden)

    def _ways(self, currency: str, chosen: list[int], starts: list[Cost], leave: list[Cost], back: list[Cost],
              straight: list[Cost]) -> Ways:
        def table(costs: list[Cost]) -> Array:
            return np.array([getattr(c, currency) for c in costs])
        between: Array = getattr(self._costs.between, currency)
        service: Array = getattr(self._costs.service, currency)
        return Ways(between[np.ix_(chosen, chosen)][None], table(starts)[:, chosen], table(back)[:, chosen],
                    service[chosen], table(leave)[:, chosen], table(straight))

    def _tours(self, flyers: list[Flyer], views: list[int], problem: Problem, found: Allocation) -> Tours:
        sorties = {f.vehicle_id: [[views[i] for i in sortie] for sortie in own]
                   for f, own in zip(flyers, found.sorties, strict=True)}
        return Tours(sorties, {views[i]: _why(problem, i) for i in found.left_over})


def _why(problem: Problem, view: int) -> Outcome:
    """Why a view is in no tour although a vehicle might have it."""
    allowed = np.ones(problem.vehicles, dtype=np.bool_) if problem.forbidden is None else ~problem.forbidden[:, view]
    if not np.isfinite(problem.seconds.from_start[allowed, view]).any():
        return Outcome(UNREACHABLE, "no way through space known to be free")
    return Outcome(ENERGY, "beyond what every battery allows")
