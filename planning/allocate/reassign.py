"""Giving views out anew in flight: from the plan that is being flown, changing few assignments."""

from __future__ import annotations

from dataclasses import dataclass

from planning.allocate.minmax import Effort, solve
from planning.allocate.minmax_tables import Warm
from planning.allocate.problem import Allocation, Problem, Sorties, appraise

IN_FLIGHT = Effort(iterations=24_000, chains=4)
CHANGE_SHARE = 1e-3
"""Taking a view from one vehicle to another must save this share of the makespan."""


@dataclass(frozen=True)
class Reassignment:
    """The new plan, and how it differs from the one that was flown."""

    allocation: Allocation
    receiver_of_view: dict[int, int]
    """Views that are with another vehicle than before, or were with nobody, and who has them now."""


def reassign(problem: Problem, flying: Sorties, locked: list[int] | None = None, effort: Effort = IN_FLIGHT,
             seed: int = 0) -> Reassignment:
    """A new plan for the views that are not flown yet, close to the one that is being flown.

    problem: the remaining views and how things stand now: where each vehicle is, what its battery still allows, what it
    must not fly. flying: what each vehicle has still to fly of its plan (indices into `problem`); views in no sortie
    are new, or of a vehicle that has dropped out. A vehicle that joins has an empty plan; one that is lost is left out
    of the problem, or forbidden everything. locked: (m,) so many first views stay with each vehicle, in this order, as
    long as its battery carries them; None: 1, its next leg.
    """
    locked = [1] * problem.vehicles if locked is None else locked
    before = appraise(problem, flying)
    finite = [float(t) for t in before.finish_s if t < float("inf")]
    change_s = CHANGE_SHARE * max(finite, default=0.0)
    allocation = solve(problem, effort, seed, Warm(flying, locked, change_s))
    owner = {view: vehicle for vehicle, tour in enumerate(before.tours) for view in tour}
    moved = {view: vehicle for vehicle, tour in enumerate(allocation.tours) for view in tour
             if owner.get(view) != vehicle}
    return Reassignment(allocation, moved)
