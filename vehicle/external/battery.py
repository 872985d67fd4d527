"""The battery of a real body: its level is what the autopilot reports."""

from __future__ import annotations

from collections.abc import Callable

from planning.trajectories import Curve
from planning.trajectories.energy import Energy
from vehicle.battery import Battery


class ReportedBattery(Battery):
    """Unknown is not enough: the level is zero until one was reported. Where reports stay away in flight, the model of
    consumption goes on from the last one."""

    def __init__(self, energy: Energy, report: Callable[[], float | None]) -> None:
        """report: percent as last reported, None when there is no report that is new enough."""
        super().__init__(0.0, energy)
        self._report = report
        self._fresh = False

    def step(self, t_ns: int) -> None:
        """Take over the newest report."""
        super().step(t_ns)
        level = self._report()
        self._fresh = level is not None
        if level is not None:
            self.level_percent = level

    def spend(self, curve: Curve, from_s: float, to_s: float) -> None:
        """Only what no report has counted."""
        if not self._fresh:
            super().spend(curve, from_s, to_s)
