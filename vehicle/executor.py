"""Flies the plan: take-off, legs, pictures, return, landing. One small function per mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from missions.frames import Array
from missions.mavlink import Route, Waypoint
from missions.messages import LegReport, ShutterRequest
from missions.mission import BatterySpec
from planning.trajectories import Via, straight_run
from planning.trajectories.energy import stops_percent
from vehicle.battery import Battery
from vehicle.camera import CameraPayload
from vehicle.pilot import Outcome, Pilot
from vehicle.simulator import NS
from vehicle.way_home import WayHome

STANDBY, TAKEOFF, MISSION, HOLD, RETURN, LAND, EMERGENCY = (
    "standby", "takeoff", "mission", "hold", "return", "land", "emergency")
VERTICAL_SPEED_M_S = 1.5


@dataclass
class Outbox:
    """What the executor wants to tell, until the vehicle has sent it."""

    shutters: list[ShutterRequest] = field(default_factory=list)
    reports: list[LegReport] = field(default_factory=list)
    reached: list[int] = field(default_factory=list)
    """Sequence numbers of mission items."""
    texts: list[str] = field(default_factory=list)

    def clear(self) -> None:
        """All is sent."""
        for told in (self.shutters, self.reports, self.reached, self.texts):
            told.clear()


class Executor:
    """The vehicle's mission state."""

    def __init__(self, pilot: Pilot, battery: Battery, spec: BatterySpec, camera: CameraPayload, pad_enu_m: Array,
                 hover_enu_m: Array, teammates: int) -> None:
        self.pilot, self.battery, self.camera = pilot, battery, camera
        self.pad, self.hover = pad_enu_m, hover_enu_m
        self.mode, self.outbox = STANDBY, Outbox()
        self.route: Route | None = None
        self.index = 0
        self.return_when_done = False
        self.wake_ns: int | None = None
        self._items: list[list[int]] = []
        self._next: tuple[Route, list[list[int]]] | None = None
        self._spec = spec
        self._vertical = replace(pilot.limits, speed_m_s=min(pilot.limits.speed_m_s, VERTICAL_SPEED_M_S))
        self.way_home = WayHome(battery.energy, hover_enu_m, pad_enu_m, pilot.limits, pilot.slow, self._vertical,
                                teammates)
        self._passing: list[tuple[int, int]] = []
        self._target: int | None = None
        self._jump_to: int | None = None
        self._last: int | None = None

    @property
    def flying(self) -> bool:
        """Whether the vehicle is off the ground."""
        return self.mode != STANDBY

    @property
    def idle(self) -> bool:
        """Hovering with nothing to do."""
        return self.mode == HOLD or (self.mode == MISSION and not self._views_left() and self._target is None)

    @property
    def threshold_percent(self) -> float:
        """Level at which the vehicle takes no more views."""
        return self._spec.threshold_percent

    def take(self, route: Route, items: list[list[int]]) -> None:
        """Make this the plan: at once when none is under way, else after the present run. items: for each waypoint
        the mission items that it is made of."""
        self._next = (route, items)
        if self.mode != MISSION:
            self._switch()

    def jump(self, seq: int) -> None:
        """Go on with the waypoint that mission item `seq` belongs to, after the present run."""
        self._jump_to = next((n for n, items in enumerate(self._items) if items[-1] >= seq), len(self._items))

    def drop_plan(self) -> None:
        """Forget the plan; the present run is finished."""
        self._next = (Route(plan_id=0, phase="explore", waypoints=[]), [])
        if self.mode != MISSION:
            self._switch()

    def _switch(self) -> None:
        if self._next is not None:
            (self.route, self._items), self.index, self._next, self._target = self._next, 0, None, None
            self._passing, self._jump_to = [], None
            self.pilot.arrived()

    def start(self) -> bool:
        """Take off or go on with the plan; False when there is nothing to fly, or no energy."""
        if self.mode == STANDBY:
            if self.battery.swapping or self.battery.level_percent <= self._spec.threshold_percent:
                return False
            self.mode = TAKEOFF
        elif self.mode == HOLD or (self.mode in (RETURN, LAND) and self._may_turn_back()):
            self.mode = MISSION
            self.pilot.arrived()
        return self.mode in (TAKEOFF, MISSION)

    def hold(self, t_ns: int) -> None:
        """Stop where it is; `start` goes on."""
        if self.mode in (MISSION, RETURN):
            self._halt(t_ns, HOLD)

    def go_home(self, t_ns: int, outcome: str = "") -> None:
        """Return and land; views not flown are reported with this outcome."""
        if self.mode in (MISSION, HOLD, TAKEOFF):
            if outcome == "energy" and self._finishes_leg(t_ns):
                return
            self._report_rest(outcome or "unreachable")
            self._halt(t_ns, RETURN)

    def return_now(self, t_ns: int) -> None:
        """Return at once, out of a leg under way as well: what is left is needed for the way home."""
        if self.mode in (MISSION, HOLD, TAKEOFF):
            self._report_rest("energy")
            self._halt(t_ns, RETURN)

    def land_here(self, t_ns: int) -> None:
        """Go straight down, whatever is below."""
        if self.mode not in (STANDBY, EMERGENCY):
            self._report_rest("energy")
            self._halt(t_ns, EMERGENCY)

    def step(self, t_ns: int) -> None:
        """Do what is due now; `wake_ns` says when the next shutter opens in passing, if any."""
        self._pass_waypoints(t_ns)
        if t_ns < self.pilot.simulator.end_ns:
            self._watch(t_ns)
        else:
            _MODES[self.mode](self, t_ns)
        due = [t for t, n in self._passing if self._waypoint(n).view_id is not None]
        self.wake_ns = due[0] if due else None

    def _watch(self, t_ns: int) -> None:
        if self.mode in (TAKEOFF, LAND):
            self.pilot.look_out_for_teammates(t_ns)
        elif self.mode != EMERGENCY and self.pilot.look_ahead(t_ns):
            self._passing, self._target = [], None
            self.outbox.texts.append("leg blocked, braking")

    def _standby(self, t_ns: int) -> None:
        """On the ground: nothing moves."""

    def _takeoff(self, t_ns: int) -> None:
        if np.allclose(self.pilot.position(t_ns), self.hover, atol=1e-3):
            self.mode = MISSION
            self.pilot.trail.begin(self.hover)
            self.pilot.arrived()
        else:
            self._vertical_leg(self.hover, t_ns)

    def _mission(self, t_ns: int) -> None:
        if self.pilot.patient(t_ns):
            return
        self._arrive(t_ns)
        if self._jump_to is not None:
            self.index, self._jump_to = self._jump_to, None
            self.pilot.arrived()
        self._switch()
        self._skip_exposed()
        if not self._views_left():
            self._finish(t_ns)
            return
        self.way_home.note(self.pilot.position(t_ns), self.pilot.avoidance.clear)
        vias = self._run(t_ns)
        if not self._energy_for(vias, t_ns):
            self.go_home(t_ns, "energy")
            return
        outcome = self.pilot.go(vias, t_ns, self._onward(len(vias)))
        if outcome is Outcome.FLYING:
            self._depart(vias, t_ns)
        elif outcome is Outcome.BLOCKED:
            self._skip("blocked", self.pilot.why_blocked)
        else:
            self.pilot.make_way(t_ns)

    def _hold(self, t_ns: int) -> None:
        self.pilot.make_way(t_ns)

    def _return(self, t_ns: int) -> None:
        position = self.pilot.position(t_ns)
        if np.allclose(position, self.hover, atol=1e-3):
            self.mode = LAND
            self.pilot.arrived()
            return
        now = self.pilot.simulator.at(t_ns)
        outcome = self.pilot.go([Via(self.hover, now.yaw_enu_rad)], t_ns, [])
        back = self.pilot.trail.back
        if outcome is Outcome.BLOCKED and back is not None:
            self.pilot.go([Via(back, now.yaw_enu_rad)], t_ns, [])
        elif outcome is Outcome.WAITING:
            self.pilot.make_way(t_ns)

    def _land(self, t_ns: int) -> None:
        if np.allclose(self.pilot.position(t_ns), self.pad, atol=1e-3):
            self.mode = STANDBY
            self.outbox.texts.append("landed")
        else:
            self._vertical_leg(self.pad, t_ns)

    def _emergency(self, t_ns: int) -> None:
        ground = self.pilot.position(t_ns).copy()
        if ground[2] <= self.pad[2] + 1e-3:
            self.mode = STANDBY
            return
        ground[2] = self.pad[2]
        self._vertical_leg(ground, t_ns)

    def _vertical_leg(self, goal: Array, t_ns: int) -> None:
        now = self.pilot.simulator.at(t_ns)
        self.pilot.fly(Via(goal, now.yaw_enu_rad), self._vertical, t_ns)

    def _run(self, t_ns: int) -> list[Via]:
        assert self.route is not None, "a run belongs to a route"
        left = [Via(np.array(w.position_enu_m), w.yaw_enu_rad, w.gimbal_elevation_rad, w.stop, w.settle_s)
                for w in self.route.waypoints[self.index:self.index + MAX_RUN]]
        return left[: straight_run(self.pilot.position(t_ns), left)]

    def _onward(self, taken: int) -> list[Array]:
        """Where the route goes on to after so many waypoints, up to its next view."""
        assert self.route is not None, "a run belongs to a route"
        left = self.route.waypoints[self.index:self.index + MAX_RUN]
        if any(w.view_id is not None for w in left[:taken]):
            return []
        following = left[taken:]
        last = next((n for n, w in enumerate(following) if w.view_id is not None), len(following) - 1)
        return [np.array(w.position_enu_m) for w in following[: last + 1]]

    def _depart(self, vias: list[Via], t_ns: int) -> None:
        """Remember what this flight passes and where it ends; a detour ends nowhere yet."""
        flight = self.pilot.simulator.flight
        self._passing, self._target = [], None
        if np.allclose(flight.curve.end, vias[-1].position, atol=1e-6):
            last = self.index + len(vias) - 1
            self._passing = [(t_ns + round(float(s) * NS), self.index + n)
                             for n, s in enumerate(flight.reached_s[:len(vias) - 1])]
            self._target = last
        elif np.allclose(flight.curve.end, vias[0].position, atol=1e-6):
            self._target = self.index

    def _pass_waypoints(self, t_ns: int) -> None:
        while self._passing and self._passing[0][0] <= t_ns:
            _, n = self._passing.pop(0)
            self._complete(n, t_ns)

    def _arrive(self, t_ns: int) -> None:
        if self._target is not None:
            n, self._target = self._target, None
            self._complete(n, t_ns)
            self.pilot.arrived()

    def _complete(self, n: int, t_ns: int) -> None:
        """Waypoint n is reached: take its picture."""
        assert self.route is not None, "only a route has waypoints"
        waypoint = self._waypoint(n)
        if waypoint.view_id is not None:
            request = self.camera.expose(waypoint.view_id, self.route.phase, self.pilot.simulator.at(t_ns), t_ns)
            if request is not None:
                self.outbox.shutters.append(request)
        self.outbox.reached.extend(self._items[n])
        self.index = n + 1

    def _waypoint(self, n: int) -> Waypoint:
        assert self.route is not None, "only a route has waypoints"
        return self.route.waypoints[n]

    def _views_left(self) -> bool:
        return self.route is not None and self.index < len(self.route.waypoints)

    def _skip_exposed(self) -> None:
        while self._views_left() and self.route is not None:
            if (self.route.phase, self._waypoint(self.index).view_id) not in self.camera.exposed:
                break
            self.outbox.reached.extend(self._items[self.index])
            self.index += 1

    def _skip(self, outcome: str, detail: str) -> None:
        self._report(self.route, self.index, outcome, detail)
        self.index += 1

    def _finish(self, t_ns: int) -> None:
        if self.return_when_done or (self.route is not None and self.route.home_after):
            self._halt(t_ns, RETURN)
        else:
            self.pilot.make_way(t_ns)

    def _energy_for(self, vias: list[Via], t_ns: int) -> bool:
        """Above the threshold, and enough for this run and the way home from any of its waypoints."""
        points = np.array([self.pilot.position(t_ns), *(v.position for v in vias)])
        settle_s = np.array([v.settle_s for v in vias])
        legs = stops_percent(self.battery.energy, points, settle_s, self.pilot.limits)
        need = float(np.max(np.cumsum(legs) + self.way_home.percent(points[1:])))
        level = self.battery.level_percent
        return level > self._spec.threshold_percent and level - need >= self._spec.reserve_percent

    def _finishes_leg(self, t_ns: int) -> bool:
        """Whether the waypoint that was next when the energy ran low is still to come: it is within the reserve."""
        if self.mode != MISSION or self.pilot.simulator.end_ns <= t_ns:
            return False
        if self._last is None:
            self._last = self.index
        return self.index <= self._last

    def _may_turn_back(self) -> bool:
        return self.mode == RETURN and self._views_left() and self.battery.level_percent > self._spec.threshold_percent

    def _halt(self, t_ns: int, mode: str) -> None:
        self.pilot.stop(t_ns)
        self.pilot.arrived()
        self.mode, self._passing, self._target, self._last = mode, [], None, None

    def _report_rest(self, outcome: str) -> None:
        following = self._next[0] if self._next is not None else None
        for route, first in ((self.route, self.index), (following, 0)):
            for n in range(first, len(route.waypoints) if route is not None else 0):
                self._report(route, n, outcome, "")
        if self.route is not None:
            self.index = len(self.route.waypoints)
        self._next = None

    def _report(self, route: Route | None, n: int, outcome: str, detail: str) -> None:
        view_id = route.waypoints[n].view_id if route is not None else None
        if route is not None and view_id is not None and (route.phase, view_id) not in self.camera.exposed:
            self.outbox.reports.append(LegReport(plan_id=route.plan_id, view_id=view_id, outcome=outcome,
                                                 detail=detail))


MAX_RUN = 64
"""Waypoints looked at for one straight run."""
_MODES: dict[str, Callable[[Executor, int], None]] = {
    STANDBY: Executor._standby, TAKEOFF: Executor._takeoff, MISSION: Executor._mission, HOLD: Executor._hold,
    RETURN: Executor._return, LAND: Executor._land, EMERGENCY: Executor._emergency,
}
