"""What a vehicle can be doing, and what it wants to tell."""

from __future__ import annotations

from dataclasses import dataclass, field

from missions.messages import LegReport, ShutterRequest

STANDBY, TAKEOFF, MISSION, HOLD, GUIDED, OFFBOARD, RETURN, LAND, DESCEND, EMERGENCY = (
    "standby", "takeoff", "mission", "hold", "guided", "offboard", "return", "land", "descend", "emergency")
ALOFT = (MISSION, HOLD, GUIDED, OFFBOARD)
"""Modes in which the vehicle flies or hovers at its work."""


@dataclass
class Outbox:
    """What the executor wants to tell, until the vehicle has sent it."""

    shutters: list[ShutterRequest] = field(default_factory=list)
    reports: list[LegReport] = field(default_factory=list)
    reached: list[int] = field(default_factory=list)
    """Sequence numbers of mission items."""
    texts: list[str] = field(default_factory=list)

    def clear(self) -> None:
        """All is sent."""
        for told in (self.shutters, self.reports, self.reached, self.texts):
            told.clear()
