"""Choosing the next views of vehicles that fly free legs: several views ahead, all idle vehicles over one map.

A plan is a few views, one after the other, and worth the new surface that they are expected to show together, each
square metre discounted exponentially by the seconds of flight until then (receding horizon, Bircher et al., ICRA 2016;
beam search as in MAGICIAN, Li et al., CVPR 2026). Only its first view is given out: on arrival the map has changed.

Vehicles are served best first, and what the plan of one shows is nothing new to the next (sequential greedy
co-ordination, Burgard et al., T-RO 2005).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera
from missions.frames import Array
from planning.nbv.lattice import Lattice
from planning.nbv.outlook import AheadSpec, Indices, Outlook, outlook
from planning.nbv.sights import ImaginedMap

View = tuple[int, int]
"""Numbers of a position and of an orientation."""
Pays = Callable[[list[float], list[float]], bool]
"""Whether a plan is worth its flight, from what its views add, m^2, and the lengths of the legs to them."""


@dataclass(frozen=True)
class Asker:
    """An idle vehicle that wants a view."""

    vehicle_id: int
    way_m: Array
    """(p,) way to every position of the lattice; inf where it may not go."""


@dataclass(frozen=True)
class Plan:
    """Views for a vehicle, the first one first."""

    vehicle_id: int
    views: list[View]
    gains_m2: list[float]
    """What each adds to those before, times the chance that it can be had. Where the last one opens the way, what that
    promises comes after it."""
    legs_m: list[float]
    """Lengths of the legs to each."""
    value_m2: float
    """Discounted sum."""
    opens: Indices
    """Positions out of reach that the first view looks at."""


def plan_views(imagined: ImaginedMap, lattice: Lattice, camera: Camera, range_m: float, askers: list[Asker],
               chance: Array, spec: AheadSpec, pays: Pays) -> list[Plan]:
    """A plan for every vehicle that has views within reach and whose best plan pays; best first.

    chance (p, o): 0 for views never to be given; else how likely it can be had once something has looked at its
    position, where that is out of reach.
    """
    ways_m = np.array([a.way_m for a in askers]).reshape(len(askers), len(lattice.positions_enu_m))
    if not np.isfinite(ways_m).any():
        return []
    seen = outlook(imagined, lattice, camera, range_m, spec.seconds(ways_m), chance, spec)
    ways_m, left = ways_m[:, seen.numbers], seen.sights.nothing_shown
    plans: list[Plan] = []
    waiting = list(range(len(askers)))
    while waiting:
        gains = seen.sights.gains_after(left) * (seen.chance > 0.0)
        soonest = gains.max(axis=1) * spec.later(spec.seconds(ways_m[waiting]))
        v = waiting.pop(int(soonest.max(axis=1).argmax()))
        best = _best_way(seen, gains, left, ways_m[v], spec)
        plan = None if best is None else _plan(seen, askers[v].vehicle_id, best)
        if best is None or plan is None or not pays(plan.gains_m2, plan.legs_m):
            continue
        plans.append(plan)
        for view in best.views:
            left = seen.sights.left_after(*view, left)
        goal = seen.positions_enu_m[best.views[0][0]]
        ways_m[:, np.linalg.norm(seen.positions_enu_m - goal, axis=1) < spec.separation_m] = np.inf
    return plans


@dataclass(frozen=True)
class _Way:
    """Views of the shortlist, and where they lead."""

    views: list[View]
    gains_m2: list[float]
    total_m2: float
    """Discounted sum."""
    end_s: float
    value_m2: float
    left: NDArray[np.float32]
    onward_m: Array
    """(k,) way to the next view; inf where it may not go."""
    within: NDArray[np.bool_]
    """(k,) positions that were within reach from the start or were looked at on the way."""
    legs_m: list[float]


def _plan(seen: Outlook, vehicle_id: int, way: _Way) -> Plan:
    gains_m2, legs_m = list(way.gains_m2), list(way.legs_m)
    if seen.promise_m2[way.views[-1]] > 0.0:
        gains_m2.append(float(seen.promise_m2[way.views[-1]]))
        legs_m.append(float(seen.promise_way_m[way.views[-1]]))
    opens = seen.numbers[seen.opened[seen.opens[way.views[0]]]]
    return Plan(vehicle_id, [(int(seen.numbers[k]), o) for k, o in way.views], gains_m2, legs_m, way.value_m2, opens)


def _best_way(seen: Outlook, gains: Array, left: NDArray[np.float32], way_m: Array, spec: AheadSpec) -> _Way | None:
    """The best of one to spec.depth views for a vehicle; gains (k, o): of first views."""
    start = _Way([], [], 0.0, 0.0, 0.0, left, way_m, np.isfinite(way_m), [])
    kept = found = _extended(seen, [start], [gains], spec)
    for _ in range(spec.depth - 1):
        kept = _extended(seen, kept, [seen.sights.gains_after(way.left) for way in kept], spec)
        found = found + kept
    return max(found, key=lambda way: way.value_m2, default=None)


def _extended(seen: Outlook, ways: list[_Way], gains: list[Array], spec: AheadSpec) -> list[_Way]:
    """The best ways that are one view longer, best first, no two of which end at one view."""
    if not ways:
        return []
    end_s = np.array([way.end_s + spec.seconds(way.onward_m) for way in ways])[..., None]
    added = np.array(gains) * seen.chance
    total = np.array([way.total_m2 for way in ways])[:, None, None] + added * spec.later(end_s)
    value = total + seen.promise_m2 * spec.later(end_s)
    value = np.where(np.isfinite(end_s) & (seen.chance > 0.0), value, 0.0)
    result: list[_Way] = []
    for _ in range(spec.width):
        w, k, o = (int(n) for n in np.unravel_index(int(value.argmax()), value.shape))
        if value[w, k, o] <= 0.0:
            break
        result.append(_with_view(seen, ways[w], (k, o), float(added[w, k, o]), float(total[w, k, o]),
                                 float(end_s[w, k, 0]), float(value[w, k, o])))
        value[:, k, o] = 0.0
    return result


def _with_view(seen: Outlook, way: _Way, view: View, added_m2: float, total_m2: float, end_s: float,
               value_m2: float) -> _Way:
    k, _ = view
    within = way.within.copy()
    within[seen.opened] |= seen.opens[view]
    return _Way([*way.views, view], [*way.gains_m2, added_m2], total_m2, end_s, value_m2,
                seen.sights.left_after(*view, way.left), np.where(within, seen.onward_m[k], np.inf), within,
                [*way.legs_m, float(way.onward_m[k])])
