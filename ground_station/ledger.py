"""Who flies which view, and what became of it: every view has one holder while open and exactly one final outcome."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from missions.camera import Pose, View

FLOWN = "flown"
UNREACHABLE = "unreachable"
ENERGY = "energy"
LOST = "lost"
OPERATOR = "operator"
MAX_BLOCKED = 2
"""A view that this many vehicles found blocked is unreachable."""


@dataclass
class Entry:
    """One view: origin is the vehicle it was first given to; holder is None while nobody has it."""

    view: View
    origin: int | None = None
    holder: int | None = None
    outcome: str = ""
    detail: str = ""
    """Why it was last given back, or why it is not flown."""
    blocked_by: list[int] = field(default_factory=list)


class ViewLedger:
    """The survey's book-keeping."""

    def __init__(self, views: list[View]) -> None:
        self._entries = {v.view_id: Entry(v) for v in views}
        if len(self._entries) != len(views):
            raise ValueError("view ids must be unique")
        self.reassignments: list[dict[str, Any]] = []
        self._gave_up: dict[int, tuple[int, str]] = {}

    def view(self, view_id: int) -> View:
        """The view with this id."""
        return self._entries[view_id].view

    def __contains__(self, view_id: int) -> bool:
        return view_id in self._entries

    def assign(self, view_id: int, vehicle_id: int, t_s: float) -> None:
        """Give an open view that nobody holds to a vehicle; after the first time this is a reassignment."""
        entry = self._entries[view_id]
        if entry.outcome or entry.holder is not None:
            raise ValueError(f"view {view_id} is not free")
        entry.holder = vehicle_id
        if entry.origin is None:
            entry.origin = vehicle_id
        if view_id in self._gave_up:
            giver, reason = self._gave_up.pop(view_id)
            if giver != vehicle_id:
                self.reassignments.append({"view_id": view_id, "from": giver, "to": vehicle_id, "t_s": t_s,
                                           "reason": reason})

    def give(self, view_id: int, vehicle_id: int, t_s: float) -> None:
        """Whoever holds an open view, this vehicle has it now."""
        holder = self._entries[view_id].holder
        if holder != vehicle_id:
            if holder is not None:
                self.release(view_id, "balance")
            self.assign(view_id, vehicle_id, t_s)

    def flown(self, view_id: int) -> None:
        """Its picture is on disk; that settles it, whatever was reported before."""
        entry = self._entries[view_id]
        entry.outcome, entry.holder, entry.detail = FLOWN, None, ""
        self._gave_up.pop(view_id, None)

    def release(self, view_id: int, reason: str, detail: str = "") -> None:
        """Its holder will not fly it (energy, lost vehicle, refused plan). Without a detail, what kept an earlier
        holder from it stays told."""
        entry = self._entries[view_id]
        if entry.outcome or entry.holder is None:
            return
        self._gave_up[view_id] = (entry.holder, reason)
        entry.holder, entry.detail = None, detail or entry.detail

    def blocked(self, view_id: int, detail: str) -> None:
        """Its holder found it blocked: somebody else may try, up to MAX_BLOCKED in all."""
        entry = self._entries[view_id]
        if entry.outcome or entry.holder is None:
            return
        entry.blocked_by.append(entry.holder)
        self.release(view_id, "blocked", detail)
        if len(entry.blocked_by) >= MAX_BLOCKED:
            self.settle(view_id, UNREACHABLE)

    def settle(self, view_id: int, outcome: str, detail: str = "") -> None:
        """The final outcome of a view that will not be flown; without a detail, that of its last release."""
        entry = self._entries[view_id]
        if not entry.outcome:
            entry.outcome, entry.holder, entry.detail = outcome, None, detail or entry.detail
            self._gave_up.pop(view_id, None)

    def why_released(self, view_id: int) -> str:
        """Why its last holder gave an open view back; "" when nobody has."""
        return self._gave_up.get(view_id, (0, ""))[1]

    def refused_by(self, view_id: int) -> list[int]:
        """Vehicles that found this view blocked."""
        return list(self._entries[view_id].blocked_by)

    def held_by(self, vehicle_id: int) -> list[int]:
        """Open views of a vehicle."""
        return [i for i, e in self._entries.items() if e.holder == vehicle_id and not e.outcome]

    def homeless(self) -> list[int]:
        """Open views that nobody holds, by id."""
        return sorted(i for i, e in self._entries.items() if e.holder is None and not e.outcome)

    def open_ids(self) -> list[int]:
        """Views without an outcome, by id."""
        return sorted(i for i, e in self._entries.items() if not e.outcome)

    @property
    def open_count(self) -> int:
        """Views without an outcome."""
        return sum(not e.outcome for e in self._entries.values())

    def count(self, outcome: str) -> int:
        """How many views ended this way."""
        return sum(e.outcome == outcome for e in self._entries.values())

    def flown_poses(self) -> list[Pose]:
        """Of the views whose pictures are on disk, by id."""
        return [e.view.pose for _, e in sorted(self._entries.items()) if e.outcome == FLOWN]

    def origin(self, view_id: int) -> int | None:
        """The vehicle a view was first given to."""
        return self._entries[view_id].origin

    def outcomes(self) -> dict[str, str]:
        """Outcome by view id; "open" where there is none yet."""
        return {str(i): e.outcome or "open" for i, e in sorted(self._entries.items())}

    def details(self) -> dict[str, str]:
        """Why, by view id, of the views that are settled and not flown."""
        return {str(i): e.detail for i, e in sorted(self._entries.items()) if e.outcome not in ("", FLOWN)}
