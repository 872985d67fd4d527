"""The simulated battery: no cell is modelled, it holds what the model of consumption leaves of it.

It spends along the motion that was flown: by the power model integrated over velocity and acceleration, or by
Algorithm 1 of the thesis, percent per metre (`battery.model` of the mission).
"""

from __future__ import annotations

from planning.trajectories import Curve
from planning.trajectories.energy import Energy


class Battery:
    """The level of one vehicle's battery."""

    def __init__(self, level_percent: float, energy: Energy) -> None:
        self.level_percent, self.energy = level_percent, energy
        self._full_at_ns: int | None = None

    @property
    def swapping(self) -> bool:
        """Whether somebody is changing the battery."""
        return self._full_at_ns is not None

    def begin_swap(self, full_at_ns: int) -> None:
        """A fresh battery will be in at this time."""
        self._full_at_ns = full_at_ns

    def restore(self, level_percent: float, full_at_ns: int | None) -> None:
        """The battery as it was found in the aircraft; full_at_ns: when the one that is being put in is there."""
        self.level_percent, self._full_at_ns = max(0.0, level_percent), full_at_ns

    @property
    def full_at_ns(self) -> int | None:
        """When the battery that is being put in is there."""
        return self._full_at_ns

    def step(self, t_ns: int) -> None:
        """The change is done when its time has come."""
        if self._full_at_ns is not None and t_ns >= self._full_at_ns:
            self.level_percent, self._full_at_ns = 100.0, None

    def spend(self, curve: Curve, from_s: float, to_s: float) -> None:
        """Take off what flying this part of a curve takes; the level never falls below zero."""
        self.level_percent = max(0.0, self.level_percent - self.energy.curve_percent(curve, from_s, to_s))
