"""What is wrong right now: the triggers of the failsafe table, read off everything the vehicle knows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from missions.frames import Array
from planning.trajectories import Limits
from vehicle.failsafe_table import Trigger
from vehicle.geofence import stopping_distance_m
from vehicle.health import HEALTHY, Health
from vehicle.settings import Settings
from vehicle.simulator import NS, Kinematics
from vehicle.teammates import Teammate

OFF_ITS_WORD_M = 0.5
"""A teammate this far from where it announced to be is believed no more about where it will be."""


@dataclass(frozen=True)
class Condition:
    """What the triggers look at."""

    t_ns: int
    battery_percent: float
    home_percent: float
    """What coming home takes, with a detour and waits for teammates."""
    least_home_percent: float
    """What coming home takes if the way is free."""
    ground_heard_ns: int
    ground_takes_part: bool
    health: Health = HEALTHY
    fence_room_m: float = np.inf
    """How far inside the geofence the vehicle is."""
    stops_inside: bool = True
    """Whether it would come to rest inside if it braked at the next look."""
    peer_close: bool = False
    peer_closing: bool = False
    """Whether that one comes nearer still."""
    range_silent_s: float = 0.0
    """Since when there has been no scan, in flight."""
    range_limit_s: float = 1.0
    plan_valid: bool = True
    clock_jumped: bool = False
    card_troubled: bool = False
    """Whether pictures cannot be written on board."""


def triggers(condition: Condition, settings: Settings) -> frozenset[Trigger]:
    """Everything that is wrong."""
    c = condition
    level = c.battery_percent if c.health.battery_known else np.nan
    silent = not c.ground_takes_part and c.t_ns - c.ground_heard_ns > settings.ground_lost_s * NS
    on = {
        Trigger.ENERGY_GONE: level <= c.least_home_percent,
        Trigger.BATTERY_EMERGENCY: level <= settings.battery_emergency_percent,
        Trigger.ENERGY_HOME: level <= c.home_percent + settings.battery_reserve_percent,
        Trigger.BATTERY_CRITICAL: level <= settings.battery_critical_percent,
        Trigger.BATTERY_LOW: level <= settings.battery_low_percent,
        Trigger.BATTERY_UNKNOWN: not np.isfinite(level) or level < 0.0,
        Trigger.POSITION_INVALID: not c.health.position_valid,
        Trigger.FENCE_BREACHED: not c.fence_room_m >= 0.0,
        Trigger.FENCE_AHEAD: not c.stops_inside,
        Trigger.PEER_CLOSE: c.peer_close,
        Trigger.RANGE_BLIND: c.range_silent_s > c.range_limit_s,
        Trigger.PLAN_INVALID: not c.plan_valid,
        Trigger.CLOCK_JUMP: c.clock_jumped,
        Trigger.CARD_TROUBLE: c.card_troubled,
        Trigger.GROUND_LOST: silent,
    }
    return frozenset(t for t, wrong in on.items() if wrong)


class Peer(NamedTuple):
    """Of all teammates in flight: whether one is too close, and whether one comes nearer still."""

    close: bool
    closing: bool


FAR = Peer(False, False)


def peers(own: Kinematics, mates: list[Teammate], peer_m: float, separation_m: float, limits: Limits) -> Peer:
    """Too close is a flying teammate within peer_m; or one that is not where it announced to be, and comes nearer than
    the separation even if both brake. Those that keep their word are the business of right of way."""
    close = closing = False
    here, stop_m = tuple(map(float, own.state.position)), stopping_distance_m(own.speed_m_s, limits)
    for mate in mates:
        state = mate.state
        if state is None or not state.flying:
            continue
        gap = math.dist(here, state.position_enu_m)
        if gap > max(peer_m, separation_m + stop_m + stopping_distance_m(math.hypot(*state.velocity_enu_m_s), limits)):
            continue
        away = np.array(state.position_enu_m) - own.state.position
        near_m = _closing_m(own, mate, away / max(gap, 1e-9), limits)
        if gap < peer_m or (_off_its_word(mate) and gap - near_m < separation_m):
            close, closing = True, closing or near_m > 0.0
    return Peer(close, closing)


def _off_its_word(mate: Teammate) -> bool:
    state, announced = mate.state, mate.announced
    if state is None or announced is None or state.t_ns < announced.t_start_ns:
        return False
    there = mate.positions_at(np.array([state.t_ns]))[0]
    return float(np.linalg.norm(np.array(state.position_enu_m) - there)) > OFF_ITS_WORD_M


def _closing_m(own: Kinematics, mate: Teammate, toward: Array, limits: Limits) -> float:
    """By how much two that brake now still come nearer, at most."""
    assert mate.state is not None, "only who has told a state is near"
    speeds = float(own.state.velocity @ toward), float(-np.array(mate.state.velocity_enu_m_s) @ toward)
    return sum(stopping_distance_m(v, limits) for v in speeds if v > 0.0)
