"""A path between two points around obstacles: OMPL's bidirectional RRT, bounded by iterations, never by time.

Source: Kuffner and LaValle, "RRT-Connect", ICRA 2000, as implemented in OMPL.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from ompl import base, geometric, util

from missions.errors import SwarmscanError
from missions.frames import Array
from planning.paths.fields import ObstacleField

MAX_ITERATIONS = 4000
TREE_RANGE_M = 6.0
SHORTCUT_POINTS = 32
SHORTCUT_ROUNDS = 6
WORTHWHILE = 0.98
"""Another round is made after one that left at most this share of the cost."""
CORNER_M = 1.5
"""What a corner costs beside its length: vehicles turn at rest."""


class NoPath(SwarmscanError):  # noqa: N818 - a refusal that callers expect, not a fault
    """No path was found; `reason` is start, goal, outside or search."""

    def __init__(self, reason: str) -> None:
        super().__init__(f"no path: {reason}")
        self.reason = reason


def plan_path(field: ObstacleField, start_enu_m: Array, goal_enu_m: Array, clearance_m: float, lower_enu_m: Array,
              upper_enu_m: Array, seed: int) -> Array:
    """(k, 3) waypoints from start to goal, both included, in the box lower..upper, at least clearance_m from the field.

    A clear straight line is returned at once. Equal arguments give equal paths. Raises NoPath.
    """
    start, goal = np.asarray(start_enu_m, dtype=np.float64), np.asarray(goal_enu_m, dtype=np.float64)
    lower, upper = np.asarray(lower_enu_m, dtype=np.float64), np.asarray(upper_enu_m, dtype=np.float64)
    ends = np.stack([start, goal])
    if np.any(ends < lower) or np.any(ends > upper):
        raise NoPath("outside")
    free = field.clearance_m(ends) >= clearance_m
    if not free.all():
        raise NoPath("goal" if free[0] else "start")
    if field.segments_clear(start, goal, clearance_m)[0]:
        return ends
    path = _rrt_connect(field, start, goal, clearance_m, lower, upper, seed)
    for _ in range(SHORTCUT_ROUNDS):
        before, path = _cost_m(path), shortcut(field, path, clearance_m)
        if _cost_m(path) > WORTHWHILE * before:
            break
    return path


def shortcut(field: ObstacleField, path: Array, clearance_m: float) -> Array:
    """The cheapest sub-sequence of a path (n, 3), resampled, whose segments are all clear; ends are kept."""
    path = _resampled(path, SHORTCUT_POINTS)
    n = len(path)
    i, j = np.triu_indices(n, 1)
    clear = field.segments_clear(path[i], path[j], clearance_m)
    clear |= j == i + 1
    length = np.linalg.norm(path[j] - path[i], axis=1) + CORNER_M
    best, previous = np.full(n, np.inf), np.zeros(n, dtype=int)
    best[0] = 0.0
    for a, b, ok, d in zip(i, j, clear, length, strict=True):
        if ok and best[a] + d < best[b] - 1e-9:
            best[b], previous[b] = best[a] + d, a
    order = [n - 1]
    while order[-1] != 0:
        order.append(int(previous[order[-1]]))
    return np.asarray(path[order[::-1]])


def _cost_m(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) + CORNER_M * len(path)


def _resampled(path: Array, count: int) -> Array:
    """Up to `count` points more, evenly spread over the path, its corners kept."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    keep = np.concatenate([[True], np.diff(along) > 0.0])
    path, along = path[keep], along[keep]
    t = np.unique(np.concatenate([along, np.linspace(0.0, along[-1], count)]))
    return np.stack([np.interp(t, along, path[:, axis]) for axis in range(3)], axis=1)


class _Clear(base.StateValidityChecker):  # type: ignore[misc]
    def __init__(self, space: Any, field: ObstacleField, clearance_m: float) -> None:
        super().__init__(space)
        self._field, self._clearance = field, clearance_m

    def isValid(self, state: Any) -> bool:  # noqa: N802 - OMPL's name
        return bool(self._field.clearance_m(np.array([[state[0], state[1], state[2]]]))[0] >= self._clearance)


class _ClearMotion(base.MotionValidator):  # type: ignore[misc]
    def __init__(self, space: Any, field: ObstacleField, clearance_m: float) -> None:
        super().__init__(space)
        self._field, self._clearance = field, clearance_m

    def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: N802 - OMPL's name
        ends = np.array([[a[0], a[1], a[2]], [b[0], b[1], b[2]]])
        return bool(self._field.segments_clear(ends[:1], ends[1:], self._clearance)[0])


def _rrt_connect(field: ObstacleField, start: Array, goal: Array, clearance_m: float, lower: Array, upper: Array,
                 seed: int) -> Array:
    util.noOutputHandler()
    util.RNG.setSeed(seed % (2**31 - 1) + 1)
    space = base.RealVectorStateSpace(3)
    bounds = base.RealVectorBounds(3)
    for axis in range(3):
        bounds.setLow(axis, float(lower[axis]))
        bounds.setHigh(axis, float(upper[axis]))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(_Clear(information, field, clearance_m))
    information.setMotionValidator(_ClearMotion(information, field, clearance_m))
    information.setup()
    problem = base.ProblemDefinition(information)
    problem.setStartAndGoalStates(_state(information, start), _state(information, goal))
    planner = geometric.RRTConnect(information)
    planner.setRange(TREE_RANGE_M)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(_Countdown(MAX_ITERATIONS)))
    if not problem.hasExactSolution():
        raise NoPath("search")
    return np.array([[s[0], s[1], s[2]] for s in problem.getSolutionPath().getStates()])


class _Countdown:
    """Says stop after so many questions: a bound on work that does not depend on the machine."""

    def __init__(self, left: int) -> None:
        self._left = left

    def __call__(self) -> bool:
        self._left -= 1
        return self._left < 0


def _state(information: Any, point: Array) -> Any:
    state = information.allocState()
    for axis in range(3):
        state[axis] = float(point[axis])
    return state
