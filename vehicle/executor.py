"""Flies the plan: take-off, legs, pictures, return, landing. One small function per mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from missions.frames import Array
from missions.mavlink import Route
from missions.messages import LegReport, ShutterRequest
from missions.mission import BatterySpec
from planning.trajectories import Via
from planning.trajectories.energy import stops_percent
from vehicle.battery import Battery
from vehicle.camera import CameraPayload
from vehicle.pilot import Outcome, Pilot
from vehicle.route_progress import RouteProgress
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
        self.progress = RouteProgress(camera)
        self.return_when_done = False
        self.wake_ns: int | None = None
        self._spec = spec
        self._vertical = replace(pilot.limits, speed_m_s=min(pilot.limits.speed_m_s, VERTICAL_SPEED_M_S))
        self.way_home = WayHome(battery.energy, hover_enu_m, pad_enu_m, pilot.limits, pilot.slow, self._vertical,
                                teammates)
        self._passing: list[tuple[int, int]] = []
        self._target: int | None = None
        self._last: int | None = None

    @property
    def flying(self) -> bool:
        """Whether the vehicle is off the ground."""
        return self.mode != STANDBY

    @property
    def idle(self) -> bool:
        """Hovering with nothing to do."""
        return self.mode == HOLD or (self.mode == MISSION and not self.progress.left and self._target is None)

    @property
    def threshold_percent(self) -> float:
        """Level at which the vehicle takes no more views."""
        return self._spec.threshold_percent

    def take(self, route: Route, items: list[list[int]]) -> None:
        """Make this the plan: at once when none is under way, else after the present run. items: for each waypoint
        the mission items that it is made of."""
        self.progress.take(route, items)
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
            self._passing, self._target = [], None
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
            self.outbox.reports.extend(self.progress.give_back(outcome or "unreachable"))
            self._halt(t_ns, RETURN)

    def return_now(self, t_ns: int) -> None:
        """Return at once, out of a leg under way as well: what is left is needed for the way home."""
        if self.mode in (MISSION, HOLD, TAKEOFF):
            self.outbox.reports.extend(self.progress.give_back("energy"))
            self._halt(t_ns, RETURN)

    def land_here(self, t_ns: int) -> None:
        """Go straight down, whatever is below."""
        if self.mode not in (STANDBY, EMERGENCY):
            self.outbox.reports.extend(self.progress.give_back("energy"))
            self._halt(t_ns, EMERGENCY)

    def step(self, t_ns: int) -> None:
        """Do what is due now; `wake_ns` says when the next shutter opens in passing, if any."""
        self._pass_waypoints(t_ns)
        if t_ns < self.pilot.simulator.end_ns:
            self._watch(t_ns)
        elif not self.pilot.patient(t_ns):
            _MODES[self.mode](self, t_ns)
        due = [t for t, n in self._passing if self.progress.waypoint(n).view_id is not None]
        self.wake_ns = due[0] if due else None

    def _watch(self, t_ns: int) -> None:
        if self.mode in (TAKEOFF, LAND):
            self.pilot.helm.look_out_for_teammates(t_ns)
        elif self.mode != EMERGENCY and self.pilot.helm.look_ahead(t_ns):
            self._passing, self._target = [], None
            self.outbox.texts.append("leg blocked, braking")

    def _standby(self, t_ns: int) -> None:
        """On the ground: nothing moves."""

    def _takeoff(self, t_ns: int) -> None:
        if np.allclose(self.pilot.position(t_ns), self.hover, atol=1e-3):
            self.mode = MISSION
            self.pilot.helm.trail.begin(self.hover)
            self.pilot.arrived()
        else:
            self._vertical_leg(self.hover, t_ns)

    def _mission(self, t_ns: int) -> None:
        self._arrive(t_ns)
        self._turn_page()
        self.outbox.reached.extend(self.progress.skip_exposed())
        if not self.progress.left:
            self._finish(t_ns)
            return
        vias = self.progress.run()
        if not self.pilot.waiting:
            self._note_place(t_ns)
            if not self._energy_for(vias, t_ns):
                self.go_home(t_ns, "energy")
                return
        outcome = self.pilot.go(vias, t_ns, self.progress.to_next_view())
        if outcome is Outcome.FLYING:
            self._depart()
        elif outcome is Outcome.BLOCKED:
            self.outbox.reports.extend(self.progress.skip("blocked", self.pilot.why_blocked))
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
        if self.pilot.go([Via(self.hover, now.yaw_enu_rad)], t_ns, [self.hover]) is Outcome.WAITING:
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

    def _depart(self) -> None:
        """Remember which waypoints this flight passes, and at which it ends."""
        first, reaches_ns = self.progress.index, self.pilot.helm.reaches_ns
        self._passing = [(t, first + n) for n, t in enumerate(reaches_ns[:-1])]
        self._target = first + len(reaches_ns) - 1 if reaches_ns else None

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
        request, items = self.progress.complete(n, self.pilot.simulator.at(t_ns), t_ns)
        if request is not None:
            self.outbox.shutters.append(request)
        self.outbox.reached.extend(items)
        self._note_place(t_ns)

    def _note_place(self, t_ns: int) -> None:
        self.way_home.note(self.pilot.position(t_ns), self.pilot.avoidance.clear)

    def _finish(self, t_ns: int) -> None:
        if self.return_when_done or self.progress.home_after:
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
            self._last = self.progress.index
        return self.progress.index <= self._last

    def _may_turn_back(self) -> bool:
        return self.mode == RETURN and self.progress.left and self.battery.level_percent > self._spec.threshold_percent

    def _halt(self, t_ns: int, mode: str) -> None:
        self.pilot.helm.stop(t_ns)
        self.pilot.arrived()
        self.mode, self._passing, self._target, self._last = mode, [], None, None


_MODES: dict[str, Callable[[Executor, int], None]] = {
    STANDBY: Executor._standby, TAKEOFF: Executor._takeoff, MISSION: Executor._mission, HOLD: Executor._hold,
    RETURN: Executor._return, LAND: Executor._land, EMERGENCY: Executor._emergency,
}
