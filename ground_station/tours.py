"""What a method of allocation is asked and answers: tours of view ids, at the start and again in flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from missions.frames import Array


@dataclass(frozen=True)
class Flyer:
    """A vehicle that can take views. usable_percent: of its present battery, the way home included. swaps: fresh
    batteries that wait for it at its pad. at_home_percent: what it keeps for waiting and landing there.
    take_off_percent: what of each of them take-off takes."""

    vehicle_id: int
    position_enu_m: Array
    home_enu_m: Array
    usable_percent: float
    swaps: int = 0
    at_home_percent: float = 0.0
    take_off_percent: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """What became of a view that is not flown, and why."""

    kind: str
    detail: str = ""


@dataclass(frozen=True)
class Tours:
    """Per vehicle its sorties of view ids, the first with the present battery and the others after a swap each; and
    what became of the views that nobody can fly."""

    sorties: dict[int, list[list[int]]]
    left_over: dict[int, Outcome] = field(default_factory=dict)


@dataclass(frozen=True)
class Flying:
    """How things stand in flight: what each vehicle has still to fly, of which its first `sent` views are on board and
    stay with it; the views that nobody has; and who has found which view blocked. flown: views by vehicle so far."""

    sorties: Mapping[int, list[list[int]]]
    sent: Mapping[int, int]
    homeless: Sequence[int]
    refused_by: Mapping[int, Sequence[int]]
    flown: Mapping[int, int]


class Method(Protocol):
    """One way of giving views out. Equal calls give equal answers."""

    def begin(self, flyers: list[Flyer]) -> Tours:
        """All views, before anything is flown."""

    def again(self, flyers: list[Flyer], now: Flying) -> Tours:
        """All views that are still open. Every view of `now` is in exactly one tour of the answer or left over."""
