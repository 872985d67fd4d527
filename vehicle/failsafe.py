"""What the vehicle does by itself when something goes wrong: one table, first match wins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from vehicle.executor import Executor
from vehicle.simulator import NS

GROUND_SILENT_NS = 30 * NS
EMERGENCY_PERCENT = 2.0


@dataclass(frozen=True)
class Condition:
    """What the rules look at."""

    t_ns: int
    battery_percent: float
    threshold_percent: float
    reserve_percent: float
    home_percent: float
    """What coming home takes, with a detour and waits for teammates."""
    least_home_percent: float
    """What coming home takes if the way is free."""
    ground_heard_ns: int
    ground_takes_part: bool

    @property
    def ground_silent(self) -> bool:
        """No message for long, and no ground station on the clock."""
        return not self.ground_takes_part and self.t_ns - self.ground_heard_ns > GROUND_SILENT_NS


@dataclass(frozen=True)
class Rule:
    """When `applies`, `act` is called at every tick, so it must be idempotent; severity is MAVLink's."""

    name: str
    severity: int
    applies: Callable[[Condition], bool]
    act: Callable[[Executor, int], None]


def _finish_and_return(executor: Executor, t_ns: int) -> None:
    executor.return_when_done = True


RULES = (
    Rule("battery too low to come home: landing here", 0,
         lambda c: c.battery_percent <= max(EMERGENCY_PERCENT, c.least_home_percent),
         lambda executor, t_ns: executor.land_here(t_ns)),
    Rule("battery needed for the way home: returning", 1,
         lambda c: c.battery_percent <= c.home_percent + c.reserve_percent,
         lambda executor, t_ns: executor.return_now(t_ns)),
    Rule("battery at threshold: returning", 2, lambda c: c.battery_percent <= c.threshold_percent,
         lambda executor, t_ns: executor.go_home(t_ns, "energy")),
    Rule("ground silent: finishing the plan, then returning", 3, lambda c: c.ground_silent, _finish_and_return),
)


class Failsafe:
    """Applies the table and tells when the rule in force changes."""

    def __init__(self) -> None:
        self.active: Rule | None = None

    def step(self, condition: Condition, executor: Executor) -> Rule | None:
        """Apply the first rule that matches; the rule when it is newly in force."""
        if not executor.flying:
            return None
        rule = next((r for r in RULES if r.applies(condition)), None)
        if rule is None and self.active is not None:
            executor.return_when_done = False
        fresh = rule if rule is not self.active else None
        self.active = rule
        if rule is not None:
            rule.act(executor, condition.t_ns)
        return fresh
