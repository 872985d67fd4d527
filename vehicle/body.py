"""What flies: a simulated body, or a real one behind its autopilot. The rest of a vehicle sees no difference."""

from __future__ import annotations

from typing import Protocol

from planning.trajectories import Flight
from vehicle.health import Health
from vehicle.simulator import Kinematics


class Body(Protocol):
    """Follows one flight at a time and rests at its end.

    A flight is a reference: `at` says where the body should be, and is what flights are planned from; `measured` says
    where it is, and is what is told, photographed and judged.
    """

    @property
    def flight(self) -> Flight:
        """The flight under way, or the one whose end it rests at."""

    @property
    def start_ns(self) -> int:
        """When that flight began."""

    @property
    def end_ns(self) -> int:
        """When the flight is over; in the future for as long as the body has not come to its end."""

    @property
    def astray(self) -> Flight | None:
        """None while the body is about where its flight has it; else a flight to rest from where it is."""

    @property
    def surrendered(self) -> bool:
        """Whether somebody else flies it: a person, or the autopilot by itself."""

    @property
    def health(self) -> Health:
        """What it says of its position, its battery and its clock."""

    def step(self, t_ns: int) -> None:
        """Time has come to t_ns; take in what was measured. Once a tick, before anything else."""

    def fly(self, flight: Flight, t_ns: int) -> None:
        """Follow this flight from now; it begins in the present state."""

    def elapsed_s(self, t_ns: int) -> float:
        """Time on the present flight."""

    def at(self, t_ns: int) -> Kinematics:
        """The reference at a time."""

    def measured(self, t_ns: int) -> Kinematics:
        """Where the body is by its own measurement, at the time of the last step or after it."""

    def take_texts(self) -> list[str]:
        """What people should know, once."""
