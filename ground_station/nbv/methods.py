"""The methods that a trial can name. Each is imported only when it is named: some bring torch."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Protocol

from missions.errors import UserError
from missions.nbv_trial import Choice, Frame, TrialBrief
from missions.pose_lattice import Index5


class Method(Protocol):
    """Chooses views for all vehicles of one trial. Equal briefs and frames give equal choices."""

    def see(self, frame: Frame) -> None:
        """Takes a picture in."""

    def choose(self, vehicle: int, candidates: list[Index5]) -> Choice:
        """The next view of a vehicle that has arrived; one of the candidates."""


METHODS = {
    "random": "ground_station.nbv.baselines:RandomWalk",
    "frontier": "ground_station.nbv.baselines:Frontier",
    "volumetric": "ground_station.nbv.baselines:Volumetric",
    "macarons": "ground_station.nbv.macarons:make_macarons",
    "swarmscan": "ground_station.nbv.swarmscan:Swarmscan",
}
"""Name -> module:factory; a factory takes the TrialBrief and may raise UserError for its options."""


def make_method(brief: TrialBrief) -> Method:
    """The method that the brief names. Raises UserError."""
    if brief.method not in METHODS:
        raise UserError(f"there is no method {brief.method!r}; choose of {', '.join(METHODS)}.")
    module, name = METHODS[brief.method].split(":")
    factory: Callable[[TrialBrief], Method] = getattr(importlib.import_module(module), name)
    return factory(brief)
