"""What may be set in flight: speeds, battery levels, and what the failsafe does about what."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any

from missions.mission import Mission
from planning.trajectories.homing import VERTICAL_SPEED_M_S
from vehicle.failsafe_table import TABLE, Action, Step, Trigger

HOLD_S = 15.0
"""A hold that was set where the table goes on to nothing worse turns into a return after so long."""
EMERGENCY_PERCENT = 2.0
PEER_SHARE = 0.8
"""Of the separation: well below it, so that what the rules of right of way bring about is never called too close."""


@dataclass(frozen=True)
class Settings:
    """One vehicle's settings; replaced as a whole (`dataclasses.replace`, `with_action`), never changed.

    `Settings.of(mission)` are those that a vehicle starts with. Raises ValueError with a sentence for people where a
    value makes no sense, so that a parameter service can refuse it. The names that users know for them:

    | field | PX4 | ArduPilot |
    |---|---|---|
    | cruise_m_s | MPC_XY_CRUISE | WPNAV_SPEED (cm/s) |
    | acceleration_m_s2 | MPC_ACC_HOR | WPNAV_ACCEL (cm/s^2) |
    | jerk_m_s3 | MPC_JERK_AUTO | WPNAV_JERK |
    | climb_m_s | MPC_Z_V_AUTO_UP | WPNAV_SPEED_UP (cm/s) |
    | takeoff_altitude_m | MIS_TAKEOFF_ALT | PILOT_TKOFF_ALT (cm) |
    | battery_low_percent, _critical_, _emergency_ | BAT_LOW_THR, BAT_CRIT_THR, BAT_EMERGEN_THR (shares) | |
    | ground_lost_s | COM_DL_LOSS_T | FS_GCS_TIMEOUT |
    | hold_first_s | COM_FAIL_ACT_T | |
    | fence_margin_m | | FENCE_MARGIN |
    | action of BATTERY_CRITICAL | COM_LOW_BAT_ACT | BATT_FS_CRT_ACT |
    | action of BATTERY_LOW | | BATT_FS_LOW_ACT |
    | action of GROUND_LOST | NAV_DLL_ACT | FS_GCS_ENABLE |
    | action of FENCE_AHEAD and FENCE_BREACHED | GF_ACTION | FENCE_ACTION |
    | action of POSITION_INVALID | | FS_EKF_ACTION |
    """

    cruise_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float
    climb_m_s: float
    """Up and down over the own pad, at most."""
    takeoff_altitude_m: float | None
    """Above the pad; None is the hover point of the mission."""
    battery_low_percent: float
    battery_critical_percent: float
    battery_emergency_percent: float
    battery_reserve_percent: float
    """What must be left after the last landing."""
    peer_m: float
    """Another vehicle in flight this near is too close, whatever was agreed."""
    ground_lost_s: float = 30.0
    hold_first_s: float = 0.0
    """So long a trigger that asks to return holds first, for people to decide otherwise; never before a landing."""
    fence_margin_m: float = 0.0
    """So far inside the geofence a stop must end."""
    actions: Mapping[Trigger, Action] = field(default_factory=lambda: MappingProxyType({}), hash=False)
    """What the table says otherwise; see `with_action`."""

    @classmethod
    def of(cls, mission: Mission) -> Settings:
        """Those of a mission's vehicles."""
        fleet, battery = mission.fleet, mission.battery
        return cls(fleet.speed_m_s, fleet.acceleration_m_s2, fleet.jerk_m_s3,
                   min(fleet.speed_m_s, VERTICAL_SPEED_M_S), None, battery.threshold_percent, battery.reserve_percent,
                   EMERGENCY_PERCENT, battery.reserve_percent, PEER_SHARE * fleet.separation_m)

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self) if f.type == "float"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} is {value:g}; give a number from 0 on.")
        height = self.takeoff_altitude_m
        if height is not None and not (math.isfinite(height) and height > 0.0):
            raise ValueError(f"takeoff_altitude_m is {height:g}; give metres above the pad.")
        for name in ("cruise_m_s", "acceleration_m_s2", "jerk_m_s3", "climb_m_s"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} is 0: the vehicle could not move or stop; give more.")
        for name in (n for n in self.__dataclass_fields__ if n.endswith("_percent") and getattr(self, n) > 100.0):
            raise ValueError(f"{name} is {getattr(self, name):g}; give at most 100.")
        for trigger, action in self.actions.items():
            self._check(trigger, action)

    def with_number(self, name: str, value: float) -> Settings:
        """The same, with another value of a field. Raises ValueError."""
        changes: dict[str, Any] = {name: value}
        return replace(self, **changes)

    def with_action(self, trigger: Trigger, action: Action) -> Settings:
        """The same, with this as the first action about a trigger. Later steps of the table stay where they are worse:
        what holds does not hold for ever. Raises ValueError."""
        return replace(self, actions=MappingProxyType({**self.actions, trigger: action}))

    def steps(self, trigger: Trigger) -> tuple[Step, ...]:
        """What is done about a trigger, and when."""
        given = TABLE[trigger].steps
        if trigger in self.actions:
            first = Step(given[0].after_s, self.actions[trigger])
            later = [s for s in given if s.action > first.action and s.after_s > first.after_s]
            if first.action is Action.HOLD and not later:
                later = [Step(first.after_s + HOLD_S, Action.RETURN)]
            keeps = first.action >= Action.HOLD or TABLE[trigger].least > Action.WARN
            given = (first, *(later if keeps else ()))
        first = given[0]
        if self.hold_first_s > 0.0 and first.action in (Action.FINISH_LEG, Action.RETURN):
            given = (Step(first.after_s, Action.HOLD), Step(first.after_s + self.hold_first_s, first.action),
                     *(Step(s.after_s + self.hold_first_s, s.action) for s in given[1:]))
        return given

    def _check(self, trigger: Trigger, action: Action) -> None:
        if action is Action.TERMINATE:
            raise ValueError(f"{trigger.value}: motors are never switched off in flight; give another action.")
        if action is Action.NONE:
            raise ValueError(f"{trigger.value}: somebody must be told; give at least a warning.")
        if self.steps(trigger)[-1].action < TABLE[trigger].least:
            raise ValueError(f"{trigger.value}: this must end in a landing; give that.")
