"""OMPL's planners over an obstacle field, bounded by iterations, never by time, and seeded.

No flight uses them: over the benchmark's worlds A* over the lattice finds more ways, shorter ones, and sooner.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from ompl import base, geometric, util

from missions.frames import Array
from planning.paths import NoPath, ObstacleField

MAX_ITERATIONS = 4000
TREE_RANGE_M = 6.0


def sampled_path(field: ObstacleField, ends_enu_m: Array, clearance_m: float, box_enu_m: tuple[Array, Array], seed: int,
                 planner: str = "RRTConnect", iterations: int = MAX_ITERATIONS) -> Array:
    """(k, 3) waypoints between two free ends (2, 3) inside a box, by the OMPL planner of that name.

    Raises NoPath when the iterations are used up without a path. Planners that go on improving use them all.
    """
    util.noOutputHandler()
    util.RNG.setSeed(seed % (2**31 - 1) + 1)
    space = base.RealVectorStateSpace(3)
    bounds = base.RealVectorBounds(3)
    for axis in range(3):
        bounds.setLow(axis, float(box_enu_m[0][axis]))
        bounds.setHigh(axis, float(box_enu_m[1][axis]))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(_Clear(information, field, clearance_m))
    information.setMotionValidator(_ClearMotion(information, field, clearance_m))
    information.setup()
    problem = base.ProblemDefinition(information)
    problem.setStartAndGoalStates(_state(information, ends_enu_m[0]), _state(information, ends_enu_m[1]))
    problem.setOptimizationObjective(base.PathLengthOptimizationObjective(information))
    solver = getattr(geometric, planner)(information)
    if hasattr(solver, "setRange"):
        solver.setRange(TREE_RANGE_M)
    solver.setProblemDefinition(problem)
    solver.setup()
    solver.solve(base.PlannerTerminationCondition(_Countdown(iterations)))
    if not problem.hasExactSolution():
        raise NoPath("search")
    return np.array([[s[0], s[1], s[2]] for s in problem.getSolutionPath().getStates()])


class _Clear(base.StateValidityChecker):  # type: ignore[misc]
    def __init__(self, space: Any, field: ObstacleField, clearance_m: float) -> None:
        super().__init__(space)
        self._field, self._clearance = field, clearance_m

    def isValid(self, state: Any) -> bool:  # noqa: N802 - OMPL's name
        place = np.array([[state[0], state[1], state[2]]])
        return bool(self._field.segments_clear(place, place, self._clearance)[0])


class _ClearMotion(base.MotionValidator):  # type: ignore[misc]
    def __init__(self, space: Any, field: ObstacleField, clearance_m: float) -> None:
        super().__init__(space)
        self._field, self._clearance = field, clearance_m

    def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: N802 - OMPL's name
        ends = np.array([[a[0], a[1], a[2]], [b[0], b[1], b[2]]])
        return bool(self._field.segments_clear(ends[:1], ends[1:], self._clearance)[0])


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
