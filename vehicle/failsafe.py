"""What the vehicle does by itself when something is wrong: watches the triggers, keeps their time, and acts.

The table and its law are in `failsafe_table.py`. What is here keeps two failsafes from alternating, and one from
flapping: a trigger counts until it has been quiet for a while; what has held the vehicle time and again is worse than
it looks; and a return or a landing under way is never taken back for anything milder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from vehicle.condition import Condition, triggers
from vehicle.executor import Executor
from vehicle.failsafe_table import TABLE, Action, Decision, Trigger, decide
from vehicle.modes import HOLD, MISSION, RETURN, TAKEOFF
from vehicle.settings import Settings
from vehicle.simulator import NS

CLEAR_S = 2.0
"""A trigger is over when it has been quiet for so long."""
LONGEST_TICK_S = 1.1
"""No more than this counts from one look to the next: a clock that jumps does not make triggers older."""
FLAPS, FLAP_NS = 3, 60 * NS
"""Who has to hold so often in so long for the same reason does at once what comes after holding."""
GROUNDING = (Trigger.POSITION_INVALID, Trigger.BATTERY_UNKNOWN, Trigger.BATTERY_EMERGENCY, Trigger.BATTERY_CRITICAL,
             Trigger.CLOCK_JUMP, Trigger.CARD_TROUBLE)
"""With these nobody takes off."""
INFO, NOTICE = 6, 5
FINE = Decision(Action.NONE, None)
Text = tuple[str, int]


@dataclass
class _Timer:
    on_s: float = 0.0
    quiet_s: float = 0.0
    held: bool = False
    """Whether it has asked to hold."""
    flaps: bool = False
    """Whether it has asked to hold so often of late that holding is not enough."""


@dataclass
class Failsafe:
    """Of one vehicle; to be asked once a tick."""

    settings: Settings
    """May be replaced in flight."""
    decision: Decision = FINE
    """What is being done, and why."""
    _timers: dict[Trigger, _Timer] = field(default_factory=dict)
    _holds_ns: dict[Trigger, list[int]] = field(default_factory=dict)
    _resumes: bool = False
    """Whether the vehicle goes on with its plan when nothing holds it any more."""
    _t_ns: int = 0

    @property
    def active(self) -> frozenset[Trigger]:
        """All triggers that count, also those that ask for nothing yet."""
        return frozenset(self._timers)

    def step(self, condition: Condition, executor: Executor) -> list[Text]:
        """Act; what people should be told of it, with MAVLink's severity, at most 50 characters each."""
        noticed = triggers(condition, self.settings)
        dt_s = min(max(0.0, (condition.t_ns - self._t_ns) / NS), LONGEST_TICK_S)
        self._t_ns = condition.t_ns
        executor.grounded_by = next((TABLE[t].what for t in GROUNDING if t in noticed), "")
        if not executor.flying:
            self._timers, self._holds_ns, self._resumes = {}, {}, False
            self.decision = FINE
            return []
        asked = self._asked(noticed, dt_s, condition.t_ns)
        decision = decide(asked)
        self._act(decision.action, asked, condition, executor)
        told, self.decision = self.decision, decision
        return _texts(told, decision)

    def _asked(self, noticed: frozenset[Trigger], dt_s: float, t_ns: int) -> dict[Trigger, Action]:
        """What each trigger that counts asks for now."""
        asked = {}
        for trigger in TABLE:
            timer = self._timers.get(trigger)
            if timer is None and trigger not in noticed:
                continue
            if timer is None:
                timer = self._timers[trigger] = _Timer()
            elif trigger in noticed:
                timer.on_s, timer.quiet_s = timer.on_s + dt_s, 0.0
            else:
                timer.quiet_s += dt_s
            if timer.quiet_s >= CLEAR_S:
                del self._timers[trigger]
            else:
                asked[trigger] = self._at(trigger, timer, t_ns)
        return asked

    def _at(self, trigger: Trigger, timer: _Timer, t_ns: int) -> Action:
        steps = self.settings.steps(trigger)
        action = max((s.action for s in steps if s.after_s <= timer.on_s), default=Action.NONE)
        if action is not Action.HOLD:
            return action
        if not timer.held:
            held = [h for h in self._holds_ns.get(trigger, []) if t_ns - h < FLAP_NS] + [t_ns]
            self._holds_ns[trigger], timer.held, timer.flaps = held, True, len(held) >= FLAPS
        return next((s.action for s in steps if s.action > Action.HOLD), action) if timer.flaps else action

    def _act(self, action: Action, asked: Mapping[Trigger, Action], condition: Condition, executor: Executor) -> None:
        t_ns = condition.t_ns
        executor.still = any(a >= Action.HOLD and not TABLE[t].navigates for t, a in asked.items())
        if action is Action.HOLD:
            self._hold(t_ns, executor)
        else:
            self._release(executor, goes_on=action < Action.HOLD)
        if not asked:
            executor.return_when_done = False
        _ACTS.get(action, _nothing)(executor, t_ns)
        brakes = asked.get(Trigger.FENCE_AHEAD, Action.NONE) >= Action.HOLD or condition.peer_closing
        if brakes and executor.mode == RETURN:
            executor.pilot.helm.stop(t_ns)

    def _hold(self, t_ns: int, executor: Executor) -> None:
        if executor.mode == TAKEOFF or (executor.at_work and executor.mode != HOLD):
            self._resumes = executor.mode in (TAKEOFF, MISSION)
            executor.hold(t_ns)

    def _release(self, executor: Executor, goes_on: bool) -> None:
        if self._resumes and goes_on and executor.mode == HOLD and executor.paused_by is None:
            executor.start()
        self._resumes = False


def _texts(told: Decision, now: Decision) -> list[Text]:
    if now.text == told.text:
        return []
    if now.trigger is None:
        return [] if told.trigger is None else [(f"{TABLE[told.trigger].what}: over", INFO)]
    row = TABLE[now.trigger]
    return [(now.text, row.severity), (row.remedy, NOTICE)]


def _nothing(executor: Executor, t_ns: int) -> None:
    """Nothing that the executor has to do."""


def _finish_plan(executor: Executor, t_ns: int) -> None:
    """Who hovers on somebody's word goes home at once: nobody is there to say what comes next."""
    executor.return_when_done = True
    if executor.mode == HOLD:
        executor.go_home(t_ns)


_ACTS: Mapping[Action, Callable[[Executor, int], None]] = {
    Action.FINISH_PLAN: _finish_plan, Action.FINISH_LEG: lambda executor, t_ns: executor.go_home(t_ns, "energy"),
    Action.RETURN: Executor.return_now, Action.LAND: Executor.land_here}
"""All of them may be repeated at every tick."""
