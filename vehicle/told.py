"""What our ground station was told of the plan under way, for one that was away and may have missed it."""

from __future__ import annotations

from dataclasses import dataclass, field

from missions.messages import LegReport, PlanHash


@dataclass
class Told:
    """Reports and items of one plan."""

    plan: PlanHash | None = None
    reports: list[LegReport] = field(default_factory=list)
    reached: list[int] = field(default_factory=list)

    def note(self, plan: PlanHash | None, reports: list[LegReport], reached: list[int]) -> None:
        """This is told now, while this plan is the accepted one."""
        if plan != self.plan:
            self.plan, self.reports, self.reached = plan, [], []
        self.reports += reports
        self.reached += reached
