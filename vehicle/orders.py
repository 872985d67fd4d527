"""What may be asked of a vehicle: fly a plan, take off, go somewhere, hold, return, land."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from msgspec import structs

from missions.frames import Array
from missions.mavlink import Route
from missions.mission import BatterySpec
from planning.trajectories import Via
from planning.trajectories.homing import VERTICAL_SPEED_M_S
from vehicle.battery import Battery
from vehicle.camera import CameraPayload
from vehicle.guided import Guided, free_below
from vehicle.lease import Sender
from vehicle.modes import (
    ALOFT,
    DESCEND,
    EMERGENCY,
    GUIDED,
    HOLD,
    LAND,
    MISSION,
    OFFBOARD,
    RETURN,
    STANDBY,
    TAKEOFF,
    Outbox,
)
from vehicle.pilot import Pilot
from vehicle.route_progress import RouteProgress
from vehicle.route_run import RouteRun
from vehicle.settings import Settings
from vehicle.simulator import resting
from vehicle.way_home import WayHome


class Orders:
    """The vehicle's mission state, and what may be asked of it; all of it may be asked twice."""

    def __init__(self, pilot: Pilot, battery: Battery, spec: BatterySpec, camera: CameraPayload, pad_enu_m: Array,
                 hover_enu_m: Array, teammates: int) -> None:
        self.pilot, self.battery, self.camera = pilot, battery, camera
        self.pad, self.hover = pad_enu_m, hover_enu_m
        self.mode, self.outbox = STANDBY, Outbox()
        self.progress = RouteProgress(camera)
        self.return_when_done = False
        self.wake_ns: int | None = None
        self.armed = False
        self.grounded_by = ""
        """What keeps the vehicle from taking off; "" when nothing does."""
        self.paused_by: Sender | None = None
        """Who has told it to hold: nothing but people lets it go on."""
        self.still = False
        """Whether it may not even make way, because it does not know where it is."""
        self.guided = Guided(pilot)
        self._after_takeoff: Via | None = None
        """Where to fly from over the pad, on somebody's word; a mission otherwise."""
        self._below_hover = False
        """Whether it is still over its pad, below the hover point: from here it only goes up, down or home."""
        self.spec = spec
        self._vertical = replace(pilot.limits, speed_m_s=min(pilot.limits.speed_m_s, VERTICAL_SPEED_M_S))
        self.way_home = WayHome(battery.energy, hover_enu_m, pad_enu_m, pilot.limits, pilot.slow, self._vertical,
                                teammates)
        self._run = RouteRun(self.progress, pilot, self.way_home, self.outbox)
        self._last: int | None = None

    @property
    def flying(self) -> bool:
        """Whether the vehicle is off the ground."""
        return self.mode != STANDBY

    @property
    def at_work(self) -> bool:
        """Whether the vehicle flies or hovers at its work."""
        return self.mode in ALOFT

    @property
    def idle(self) -> bool:
        """Hovering with nothing to do."""
        return self.mode == HOLD or (self.mode == MISSION and not self.progress.left and not self._run.ends_at_waypoint)

    @property
    def ready(self) -> bool:
        """Whether battery and body allow to take off."""
        charged = not self.battery.swapping and self.battery.level_percent > self.spec.threshold_percent
        return charged and not self.grounded_by

    @property
    def threshold_percent(self) -> float:
        """Level at which the vehicle takes no more views."""
        return self.spec.threshold_percent

    def apply(self, settings: Settings) -> None:
        """Fly by these from the next flight on."""
        limits = replace(self.pilot.limits, speed_m_s=settings.cruise_m_s,
                         acceleration_m_s2=settings.acceleration_m_s2, jerk_m_s3=settings.jerk_m_s3)
        self.pilot.obey(limits)
        self._vertical = replace(limits, speed_m_s=min(limits.speed_m_s, settings.climb_m_s))
        self.spec = structs.replace(self.spec, threshold_percent=settings.battery_low_percent,
                                    reserve_percent=settings.battery_reserve_percent)

    def found(self, mode: str, paused_by: Sender | None, below_hover: bool) -> None:
        """The aircraft was found doing this: it is armed as it is, and goes on, but for flying a plan or to a point."""
        self.mode = HOLD if mode in (GUIDED, OFFBOARD) else mode
        self.armed, self.paused_by, self._below_hover = mode != STANDBY, paused_by, below_hover

    @property
    def below_hover(self) -> bool:
        """Whether it is still over its pad, below the hover point."""
        return self._below_hover

    def take(self, route: Route, items: list[list[int]], home_seq: int | None = None) -> None:
        """Make this the plan: at once when none is under way, else after the present run. items: for each waypoint
        the mission items that it is made of; home_seq: the item that returns."""
        self.progress.take(route, items, home_seq)
        self._switch_at_rest()

    def jump(self, seq: int) -> None:
        """Go on with the waypoint that mission item `seq` belongs to, after the present run."""
        self.progress.jump(seq)

    def drop_plan(self) -> None:
        """Forget the plan; the present run is finished."""
        self.progress.take(Route(plan_id=0, phase="explore", waypoints=[]), [])
        self._switch_at_rest()

    def _switch_at_rest(self) -> None:
        if self.mode != MISSION:
            self._turn_page()

    def _turn_page(self) -> None:
        if self.progress.turn_page():
            self._run.forget()
            self.pilot.arrived()

    def start(self) -> bool:
        """Take off or go on with the plan, which takes the place of what was to come after a take-off; False when there
        is nothing to fly, or no energy."""
        self.paused_by = None
        if self.mode == STANDBY:
            if not self.ready:
                return False
            self.mode, self.armed, self._after_takeoff = TAKEOFF, True, None
            self._below_hover = True
        elif self.mode == TAKEOFF:
            self._after_takeoff = None
        elif self.mode in (HOLD, GUIDED, OFFBOARD) or (self.mode in (RETURN, LAND) and self._may_turn_back()):
            self.mode = TAKEOFF if self._below_hover else MISSION
            self.pilot.arrived()
        return self.mode in (TAKEOFF, MISSION)

    def take_off(self, up_m: float, t_ns: int) -> bool:
        """Take off to hover this high, or over the pad if that is higher; False when there is no energy for it."""
        if self.mode != STANDBY:
            return self.mode == TAKEOFF
        if not self.ready:
            return False
        now = self.pilot.body.at(t_ns)
        self._after_takeoff = Via(np.array([*self.hover[:2], max(up_m, float(self.hover[2]))]), now.yaw_enu_rad,
                                  now.gimbal_elevation_rad)
        self.mode, self.armed = TAKEOFF, True
        self._below_hover = True
        return True

    def goto(self, target: Via, t_ns: int, mode: str = GUIDED) -> bool:
        """Fly to a point and stay there (guided), or follow the points that come (offboard); after a take-off that is
        under way. False on the ground."""
        if self.mode == TAKEOFF and self._after_takeoff is not None:
            self._after_takeoff = target
            return True
        if self.mode not in ALOFT:
            return False
        if self.guided.aim(target.position, target.yaw_rad, target.elevation_rad) or self.mode not in (mode, HOLD):
            self._halt(t_ns, mode)
        return True

    def hold(self, t_ns: int, by: Sender | None = None) -> None:
        """Stop where it is; `start` goes on. by: the person who says so; None when the vehicle itself does."""
        self.paused_by = by or self.paused_by
        self._after_takeoff = self._after_takeoff if by is None else None
        if self.mode in (TAKEOFF, MISSION, GUIDED, OFFBOARD, RETURN):
            self.guided.forget()
            self._halt(t_ns, HOLD)

    def look(self, yaw_enu_rad: float, gimbal_elevation_rad: float, t_ns: int) -> bool:
        """Turn where it stands or hovers; False while it flies."""
        if self.mode == STANDBY:
            resting_here = resting(self.pilot.position(t_ns), yaw_enu_rad, gimbal_elevation_rad)
            self.pilot.body.fly(resting_here, t_ns)
            return True
        position = self.pilot.position(t_ns) if self.guided.target is None else self.guided.target.position
        return (self.idle or self.mode == GUIDED) and self.goto(Via(position, yaw_enu_rad, gimbal_elevation_rad), t_ns)

    def land(self, t_ns: int) -> bool:
        """Land where it is, if what is below is known to be free, else at home; False for the latter."""
        if self.mode not in (*ALOFT, RETURN):
            return True
        position, avoidance = self.pilot.position(t_ns), self.pilot.avoidance
        if not free_below(position, float(self.pad[2]), avoidance.clearance_m, avoidance.clear):
            self.go_home(t_ns)
            return False
        self.outbox.reports.extend(self.progress.give_back("unreachable"))
        self._halt(t_ns, DESCEND)
        return True

    def go_home(self, t_ns: int, outcome: str = "") -> None:
        """Return and land; views not flown are reported with this outcome."""
        if self.mode in (*ALOFT, TAKEOFF):
            if outcome == "energy" and self._finishes_leg(t_ns):
                return
            self.outbox.reports.extend(self.progress.give_back(outcome or "unreachable"))
            self._halt(t_ns, RETURN)

    def return_now(self, t_ns: int) -> None:
        """Return at once, out of a leg under way as well: what is left is needed for the way home."""
        if self.mode in (*ALOFT, TAKEOFF):
            self.outbox.reports.extend(self.progress.give_back("energy"))
            self._halt(t_ns, RETURN)

    def land_here(self, t_ns: int) -> None:
        """Go straight down, whatever is below."""
        if self.mode not in (STANDBY, EMERGENCY):
            self.outbox.reports.extend(self.progress.give_back("energy"))
            self._halt(t_ns, EMERGENCY)

    def _finishes_leg(self, t_ns: int) -> bool:
        """Whether the waypoint that was next when the energy ran low is still to come: it is within the reserve."""
        if self.mode != MISSION or self.pilot.body.end_ns <= t_ns:
            return False
        if self._last is None:
            self._last = self.progress.index
        return self.progress.index <= self._last

    def _may_turn_back(self) -> bool:
        return self.mode == RETURN and self.progress.left and self.battery.level_percent > self.spec.threshold_percent

    def _halt(self, t_ns: int, mode: str) -> None:
        self.pilot.helm.stop(t_ns)
        self.pilot.arrived()
        self._run.forget()
        self.mode, self._last = mode, None
        self._below_hover = self._below_hover and mode == HOLD
