"""Min-max tours by PyVRP, which minimises sums: bisection on the longest distance that a vehicle may drive.

The best that a library did on these instances; it stands in the benchmark for comparison alone.
"""

from __future__ import annotations

import math

import numpy as np
from pyvrp import Model
from pyvrp.stop import MaxRuntime

from planning.allocate.problem import Problem, appraise

STEPS = 8
RESOLUTION = 1e6
"""PyVRP reckons in whole numbers: the longest leg becomes this."""


def bisect(legs: Problem, time_limit_s: float, seed: int) -> list[list[int]]:
    """The tours with the least longest length found. The time is shared evenly among the steps."""
    out = legs.seconds.from_start[0]
    low = float((out + legs.seconds.to_home[0]).max())
    best = _tours(legs, math.inf, time_limit_s / STEPS, seed) or [list(range(legs.views))]
    best += [[] for _ in range(legs.vehicles - len(best))]
    for _ in range(STEPS - 1):
        high = appraise(legs, [[tour] for tour in best]).makespan_s
        bound = (low + high) / 2
        found = _tours(legs, bound, time_limit_s / STEPS, seed)
        if found is None:
            low = bound
        else:
            best = found + [[] for _ in range(legs.vehicles - len(found))]
    return best


def _tours(legs: Problem, bound: float, time_limit_s: float, seed: int) -> list[list[int]] | None:
    """The shortest tours within a bound; None when none were found."""
    scale = RESOLUTION / max(float(legs.seconds.between.max()), float(legs.seconds.from_start.max()))
    model = Model()
    at_home, *at = [model.add_location(0, 0) for _ in range(legs.views + 1)]
    depot = model.add_depot(at_home)
    limit = {} if math.isinf(bound) else {"max_distance": int(bound * scale)}
    model.add_vehicle_type(legs.vehicles, start_depot=depot, end_depot=depot, **limit)
    between = np.rint(legs.seconds.between[0] * scale).astype(int)
    out = np.rint(legs.seconds.from_start[0] * scale).astype(int)
    home = np.rint(legs.seconds.to_home[0] * scale).astype(int)
    for i, place in enumerate(at):
        model.add_client(place)
        model.add_edge(at_home, place, distance=int(out[i]))
        model.add_edge(place, at_home, distance=int(home[i]))
        for j, other in enumerate(at):
            if i == j:
                continue
            model.add_edge(place, other, distance=int(between[i, j]))
    best = model.solve(MaxRuntime(time_limit_s), seed=seed, display=False).best
    if not best.is_feasible():
        return None
    return [[int(stop.idx) for stop in route if stop.is_client()] for route in best.routes()]
