"""What exploration's views promised and brought, for the decision to stop and for the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from planning.nbv.coverage import SurfaceTally
from planning.nbv.stopping import Price, Returns, pays


@dataclass
class _View:
    """A key view that was given out. `pictures` were taken on its leg, the last one is its own."""

    vehicle_id: int
    pictures: int
    promised_m2: float
    expected_m2: float
    """What was promised, corrected by how earlier promises were kept."""
    leg_m: float


@dataclass
class ExplorationLog:
    """Tell it of every leg given out, every key picture that comes in, and at every decision of the surface seen."""

    returns: Returns = field(default_factory=Returns)
    tally: SurfaceTally = field(default_factory=lambda: SurfaceTally(0.0, 0.0))
    ended: str = ""
    """Why exploration ended, as the end of a sentence."""
    _under_way: dict[int, _View] = field(default_factory=dict)
    _arrived: dict[int, _View] = field(default_factory=dict)
    """Since the last tally."""
    _rows: list[dict[str, Any]] = field(default_factory=list)

    def given(self, view_id: int, vehicle_id: int, pictures: int, promised_m2: float, leg_m: float) -> None:
        """A leg is sent: so many pictures, the last of which is the key view and should show so much new surface."""
        self._under_way[view_id] = _View(vehicle_id, pictures, promised_m2, self.returns.trust * promised_m2, leg_m)

    def arrived(self, view_id: int) -> None:
        """The picture of a key view has come in."""
        view = self._under_way.pop(view_id, None)
        if view is not None:
            self._arrived[view_id] = view

    def settle(self, tally: SurfaceTally) -> None:
        """The map holds all that has arrived. What it rose by is shared among the new views as they had promised."""
        promised_m2 = sum(view.promised_m2 for view in self._arrived.values())
        rise_m2 = tally.seen_m2 - self.tally.seen_m2
        for view_id, view in self._arrived.items():
            share = view.promised_m2 / promised_m2 if promised_m2 > 0.0 else 1.0 / len(self._arrived)
            self.returns.promise(view.promised_m2, view.leg_m)
            self._rows.append({"view_id": view_id, "vehicle_id": view.vehicle_id, "pictures": view.pictures,
                               "predicted_m2": round(view.expected_m2, 2), "achieved_m2": round(share * rise_m2, 2),
                               "coverage": round(tally.coverage, 4)})
        self.returns.settle(tally.seen_m2)
        self._arrived.clear()
        self.tally = tally

    def worth(self, gains_m2: Sequence[float], legs_m: Sequence[float], price: Price) -> bool:
        """Whether a way of views (k,) is worth its flight over legs (k,)."""
        expected = self.returns.expected_m2_per_m(gains_m2, legs_m)
        worth = pays(expected, self.returns, self.tally.coverage, price)
        self.ended = "" if worth else (f"no way was worth its flight: {expected:.2f} m² per metre were expected, "
                                       f"after {self.returns.mean_m2_per_m:.2f} on average")
        return worth

    def document(self) -> dict[str, Any]:
        """For flight.json. `coverage`: what was believed at each view, and at last, of the surface that can be seen."""
        return {"views": self._rows, "coverage": round(self.tally.coverage, 4), "ended": self.ended,
                "seen_m2": round(self.tally.seen_m2, 1), "missing_m2": round(self.tally.missing_m2, 1)}
