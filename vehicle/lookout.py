"""Watches from tick to tick what the failsafe depends on: who was heard when, where the fence is, what time it is."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from missions.frames import Array
from missions.mavlink import Route
from missions.messages import RangeScan
from missions.mission import Mission
from planning.trajectories import Flight
from vehicle.condition import FAR, Condition, peers
from vehicle.executor import Executor
from vehicle.geofence import FENCE_TOLERANCE_M, Geofence
from vehicle.health import Health
from vehicle.modes import DESCEND, EMERGENCY, LAND, STANDBY, TAKEOFF
from vehicle.settings import Settings
from vehicle.simulator import NS, Kinematics

GAP_NS = 5 * NS
"""From one tick to the next at most; ticks are at most a second apart."""
OFFSET_S = 0.5
STEADY_NS = 3 * NS
"""For so long a clock that jumped must go on evenly before it is believed again."""
ASTRAY_M = 0.3
"""A body this far from where its flight has it does not follow it."""
OVER_PAD = (STANDBY, TAKEOFF, LAND, DESCEND, EMERGENCY)
"""Straight up and down: what the fence says of the ground below does not matter then."""


class Lookout:
    """Makes the condition of one vehicle, once a tick."""

    def __init__(self, executor: Executor, fence: Geofence, limit: tuple[Array, Array], mission: Mission) -> None:
        """limit: the box that maps cover; a fence that ends before it is a wall."""
        self.fence = fence
        """May be replaced in flight."""
        self._limit = limit
        self._executor = executor
        self._separation_m = mission.fleet.separation_m
        self._look_s = mission.clock.tick_s + 0.05
        self._range_limit_s = max(1.0, 3.0 * mission.clock.tick_s)
        self._t_ns: int | None = None
        self._ground_heard_ns = self._scanned_ns = self._grounded_ns = 0
        self._offset_s: float | None = None
        self._jumped_ns = -STEADY_NS
        self._inside: tuple[Flight, Geofence, float] | None = None
        self._route: tuple[Route, Geofence, int] | None = None

    def begin(self, t_ns: int) -> None:
        """In the air, with new eyes: nobody's silence counts yet."""
        self._ground_heard_ns = self._scanned_ns = t_ns

    def hear_ground(self, t_ns: int) -> None:
        """A sign of life of whoever commands the vehicle."""
        self._ground_heard_ns = max(self._ground_heard_ns, t_ns)

    def take_scan(self, scan: RangeScan) -> bool:
        """Whether this is a scan that says something; its time counts then, not when it came."""
        says = bool(np.isfinite(scan.position_enu_m).all()) and not bool(np.isnan(scan.ranges_m).any())
        if says:
            self._scanned_ns = max(self._scanned_ns, scan.t_ns)
        return says

    def look(self, t_ns: int, settings: Settings, health: Health, ground_takes_part: bool) -> Condition:
        """What is the case now."""
        jumped = self._keep_time(t_ns, health)
        executor = self._executor
        if not executor.flying:
            self._grounded_ns = t_ns
        pilot, way_home = executor.pilot, executor.way_home
        now = pilot.body.measured(t_ns)
        here = now.state.position
        if not np.isfinite([here, now.state.velocity]).all():
            health, here = replace(health, position_valid=False), pilot.position(t_ns)
        aloft = executor.mode not in OVER_PAD
        room_m = float(self.fence.room_m(here)[0]) + FENCE_TOLERANCE_M
        self._wall_off(inside=room_m >= 0.0)
        peer = peers(now, list(pilot.avoidance.teammates.members.values()), settings.peer_m, self._separation_m,
                     executor.pilot.limits) if executor.flying else FAR
        return Condition(
            t_ns, executor.battery.level_percent, float(way_home.percent(here)), float(way_home.least_percent(here)),
            self._ground_heard_ns, ground_takes_part, health,
            fence_room_m=room_m if aloft else math.inf,
            stops_inside=not aloft or room_m < 0.0 or self._stops_inside(now, t_ns, settings),
            peer_close=peer.close, peer_closing=peer.close and peer.closing,
            range_silent_s=(t_ns - max(self._scanned_ns, self._grounded_ns)) / NS if executor.flying else 0.0,
            range_limit_s=self._range_limit_s, plan_valid=self._plan_valid(), clock_jumped=jumped,
            card_troubled=bool(executor.camera.trouble))

    def _keep_time(self, t_ns: int, health: Health) -> bool:
        """Whether the clock has jumped of late. While time stood still here nobody was heard: no silence counts."""
        gap_ns = 0 if self._t_ns is None else t_ns - self._t_ns
        if not 0 <= gap_ns <= GAP_NS:
            self._ground_heard_ns += gap_ns
            self._scanned_ns += gap_ns
            self._jumped_ns = t_ns
        elif self._offset_s is not None and abs(health.utc_offset_s - self._offset_s) > OFFSET_S:
            self._jumped_ns = t_ns
        self._t_ns, self._offset_s = t_ns, health.utc_offset_s
        return t_ns - self._jumped_ns < STEADY_NS

    def _wall_off(self, inside: bool) -> None:
        """From outside the way back in may lead through the border."""
        walls = inside and self.fence.more_than(*self._limit)
        self._executor.pilot.avoidance.fence_off(self.fence if walls else None)

    def _stops_inside(self, now: Kinematics, t_ns: int, settings: Settings) -> bool:
        body, margin_m = self._executor.pilot.body, settings.fence_margin_m - FENCE_TOLERANCE_M
        if now.speed_m_s == 0.0:
            return True
        if float(np.linalg.norm(now.state.position - body.at(t_ns).state.position)) > ASTRAY_M:
            return self.fence.holds_drift(now.state.position, now.state.velocity, self._executor.pilot.limits,
                                          self._look_s, margin_m)
        flight, elapsed_s, seen = body.flight, body.elapsed_s(t_ns), self._inside
        if seen is not None and seen[0] is flight and seen[1] is self.fence and seen[2] == margin_m:
            return True
        if self.fence.holds_flight(flight, elapsed_s, margin_m):
            self._inside = (flight, self.fence, margin_m)
            return True
        return self.fence.stops_inside(flight, elapsed_s + self._look_s, margin_m)

    def _plan_valid(self) -> bool:
        """Whether all waypoints that are left lie inside the fence."""
        progress = self._executor.progress
        if progress.route is None or not progress.left:
            return True
        if self._route is None or self._route[0] is not progress.route or self._route[1] is not self.fence:
            points = np.array([w.position_enu_m for w in progress.route.waypoints])
            bad = np.flatnonzero(~(self.fence.room_m(points) >= -FENCE_TOLERANCE_M))
            self._route = progress.route, self.fence, int(bad[-1]) if len(bad) else -1
        return progress.index > self._route[2]
