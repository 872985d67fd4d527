"""What the failsafe does about what: the table, and the law that makes one action of everything that is wrong.

Nothing here looks at a vehicle or a clock; `failsafe.py` finds out what is wrong, for how long, and acts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum

EMERGENCY, ALERT, CRITICAL, ERROR, WARNING = range(5)
"""MAVLink's severities."""


class Action(IntEnum):
    """The ladder, the mildest first. FINISH_PLAN and FINISH_LEG are returns that fly on a little before."""

    NONE = 0
    WARN = 1
    FINISH_PLAN = 2
    """Return when the plan is flown."""
    HOLD = 3
    """Brake to rest on the way that is being flown, and hover."""
    FINISH_LEG = 4
    """Return after the leg under way; the other views are given back."""
    RETURN = 5
    """Brake, then return through space known to be free, and land on the pad."""
    LAND = 6
    """Brake, then go straight down."""
    TERMINATE = 7
    """Motors off in flight: off. No setting and no command reaches it."""


class Trigger(Enum):
    """What can be wrong. The value is the name that missions, logs and people use."""

    ENERGY_GONE = "energy gone"
    BATTERY_EMERGENCY = "battery emergency"
    POSITION_INVALID = "position invalid"
    FENCE_BREACHED = "fence breached"
    ENERGY_HOME = "energy for the way home"
    BATTERY_CRITICAL = "battery critical"
    FENCE_AHEAD = "fence ahead"
    PEER_CLOSE = "peer too close"
    BATTERY_LOW = "battery low"
    RANGE_BLIND = "range sensor blind"
    PLAN_INVALID = "plan invalid"
    CLOCK_JUMP = "clock jump"
    CARD_TROUBLE = "memory card trouble"
    BATTERY_UNKNOWN = "battery unknown"
    GROUND_LOST = "ground lost"


@dataclass(frozen=True)
class Step:
    """The action from so many seconds on after the trigger was noticed."""

    after_s: float
    action: Action


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    severity: int
    steps: tuple[Step, ...]
    """Each later and worse than the one before, so that nothing holds for ever."""
    what: str
    """Begins the text that people get; the action under way ends it."""
    remedy: str
    """The text after it: what to do."""
    meaning: str
    """For the documentation."""
    least: Action = Action.WARN
    """The mildest last step that may be set."""
    navigates: bool = True
    """Whether the vehicle can still find its way while this is wrong."""


TABLE: Mapping[Trigger, Row] = {
    Trigger.ENERGY_GONE: Row(
        EMERGENCY, (Step(0.0, Action.LAND),), "battery too low to come home", "Clear the ground below it.",
        "The charge is less than a free way home takes.", least=Action.LAND),
    Trigger.BATTERY_EMERGENCY: Row(
        EMERGENCY, (Step(0.0, Action.LAND),), "battery all but empty", "Clear the ground below it.",
        "The charge is at or below the emergency level.", least=Action.LAND),
    Trigger.POSITION_INVALID: Row(
        EMERGENCY, (Step(1.0, Action.HOLD), Step(10.0, Action.LAND)), "position lost",
        "Take over by hand, or clear the ground.", "No valid position estimate. Without one nothing can return.",
        least=Action.LAND, navigates=False),
    Trigger.FENCE_BREACHED: Row(
        ALERT, (Step(0.0, Action.RETURN),), "outside the geofence", "Watch it come back; see who moved the fence.",
        "The vehicle is outside: pushed out, or the fence was moved over it."),
    Trigger.ENERGY_HOME: Row(
        ALERT, (Step(0.0, Action.RETURN),), "battery needed for the way home", "Keep its way home and pad free.",
        "The charge is down to what the way home takes, with detours, waits and the reserve."),
    Trigger.BATTERY_CRITICAL: Row(
        ALERT, (Step(0.0, Action.RETURN),), "battery critical", "Keep its way home and pad free.",
        "The charge is at or below the critical level."),
    Trigger.FENCE_AHEAD: Row(
        ALERT, (Step(0.0, Action.HOLD), Step(10.0, Action.RETURN), Step(60.0, Action.LAND)), "geofence ahead",
        "Send a plan that stays inside.", "It must brake now to come to rest inside the fence."),
    Trigger.PEER_CLOSE: Row(
        ALERT, (Step(0.0, Action.HOLD), Step(15.0, Action.RETURN)), "vehicle too close", "Move the other one away.",
        "Another vehicle is too near, or leaves the way that it announced and comes too near even if both brake."),
    Trigger.BATTERY_LOW: Row(
        CRITICAL, (Step(0.0, Action.FINISH_LEG),), "battery at threshold", "Have a fresh battery at its pad.",
        "The charge is at or below the level at which no more views are taken."),
    Trigger.RANGE_BLIND: Row(
        CRITICAL, (Step(0.0, Action.HOLD), Step(20.0, Action.RETURN)), "range sensor blind",
        "Do not send it on; clean the sensor at home.",
        "No scan of the range sensor: what is not on the map would not be seen. It returns over known-free space."),
    Trigger.PLAN_INVALID: Row(
        CRITICAL, (Step(0.0, Action.HOLD), Step(10.0, Action.RETURN)), "plan not valid any more",
        "Upload a new plan inside the fence.", "A waypoint still to fly lies outside the fence, or is no position."),
    Trigger.CLOCK_JUMP: Row(
        ERROR, (Step(0.0, Action.HOLD), Step(30.0, Action.RETURN)), "clock jumped",
        "Look at what sets its clock.",
        "Clock and monotonic time disagree, or time stood still: what was known before may be old."),
    Trigger.CARD_TROUBLE: Row(
        ERROR, (Step(0.0, Action.HOLD), Step(120.0, Action.RETURN)), "memory card takes no pictures",
        "Make space on its card, or change it at home.",
        "The card is full, read-only or too slow. What was taken is kept in memory and sent to the ground station."),
    Trigger.BATTERY_UNKNOWN: Row(
        ERROR, (Step(2.0, Action.WARN), Step(30.0, Action.RETURN)), "battery data missing",
        "Unknown is not full: call it home.", "No charge is reported, or one that cannot be."),
    Trigger.GROUND_LOST: Row(
        ERROR, (Step(0.0, Action.FINISH_PLAN),), "ground silent", "Bring the ground station back.",
        "No ground station on the clock and nothing heard from it for ground_lost_s."),
}
"""The first of several with the same action is the one that people are told about."""

DOING: Mapping[Action, str] = {
    Action.WARN: "flying on", Action.FINISH_PLAN: "finishing the plan, then returning", Action.HOLD: "holding",
    Action.FINISH_LEG: "returning", Action.RETURN: "returning", Action.LAND: "landing here"}


@dataclass(frozen=True)
class Decision:
    """What to do, and which of the triggers that call for it people are told about."""

    action: Action
    trigger: Trigger | None

    @property
    def text(self) -> str:
        """What is wrong and what the vehicle does about it; at most 50 characters, as one STATUSTEXT holds."""
        return "" if self.trigger is None else f"{TABLE[self.trigger].what}: {DOING[self.action]}"


def decide(asked: Mapping[Trigger, Action]) -> Decision:
    """One action of what each trigger that is active asks for. Worst wins, and three laws besides:

    nothing is finished first where anything asks for a stop; nothing returns that cannot find its way: it lands; and
    both only ever make the action worse, so that one more trigger never makes it milder.
    """
    order = [t for t in TABLE if asked.get(t, Action.NONE) is not Action.NONE]
    if not order:
        return Decision(Action.NONE, None)
    lead = max(order, key=lambda t: asked[t])
    action = asked[lead]
    if action is Action.FINISH_LEG and Action.HOLD in asked.values():
        action = Action.RETURN
    if action in (Action.FINISH_LEG, Action.RETURN):
        lost = next((t for t in order if not TABLE[t].navigates), None)
        if lost is not None:
            return Decision(Action.LAND, lost)
    return Decision(action, lead)
