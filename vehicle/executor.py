"""Does what was asked: take-off, legs, pictures, return, landing. One small function per mode."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from missions.frames import Array
from planning.trajectories import Via
from planning.trajectories.energy import stops_percent
from vehicle.guided import Heading
from vehicle.modes import DESCEND, EMERGENCY, GUIDED, HOLD, LAND, MISSION, OFFBOARD, RETURN, STANDBY, TAKEOFF
from vehicle.orders import Orders
from vehicle.pilot import Outcome


class Executor(Orders):
    """Carries the orders out, tick by tick."""

    def step(self, t_ns: int) -> None:
        """Do what is due now; `wake_ns` says when the next shutter opens in passing, if any."""
        self._heed_body(t_ns)
        self._run.pass_waypoints(t_ns)
        if t_ns < self.pilot.body.end_ns:
            self._watch(t_ns)
        elif not self.pilot.patient(t_ns):
            _MODES[self.mode](self, t_ns)
        self.wake_ns = self._run.wake_ns

    def _heed_body(self, t_ns: int) -> None:
        """A body may be flown by somebody else, or be blown off its course."""
        body = self.pilot.body
        self.outbox.texts.extend(body.take_texts())
        if body.surrendered and self.mode not in (STANDBY, EMERGENCY):
            self.outbox.reports.extend(self.progress.give_back("unreachable"))
            self._halt(t_ns, EMERGENCY)
        to_rest = body.astray
        if to_rest is not None:
            self._run.forget()
            self.pilot.helm.begin_anew(to_rest, t_ns)
            self.outbox.texts += [] if body.surrendered else ["planning anew from where it is"]

    def _watch(self, t_ns: int) -> None:
        if self.mode in (TAKEOFF, LAND, DESCEND):
            self.pilot.helm.look_out_for_teammates(t_ns)
        elif self.mode != EMERGENCY and self.pilot.helm.look_ahead(t_ns):
            self._run.forget()
            self.outbox.texts.append("leg blocked, braking")

    def _standby(self, t_ns: int) -> None:
        """On the ground: nothing moves."""

    def _takeoff(self, t_ns: int) -> None:
        if np.allclose(self.pilot.position(t_ns), self.hover, atol=1e-3):
            self.mode, self._below_hover = MISSION, False
            self.pilot.helm.trail.begin(self.hover)
            self.pilot.arrived()
            if self._after_takeoff is not None:
                self.goto(self._after_takeoff, t_ns)
        else:
            self._vertical_leg(self.hover, t_ns)

    def _mission(self, t_ns: int) -> None:
        self._run.arrive(t_ns)
        self._turn_page()
        self.outbox.reached.extend(self.progress.skip_exposed())
        if not self.progress.left:
            self._finish(t_ns)
            return
        vias = self.progress.run()
        if not self.pilot.waiting:
            self._run.note_place(t_ns)
            if not self._energy_for(vias, t_ns):
                self.go_home(t_ns, "energy")
                return
        outcome = self.pilot.go(vias, t_ns, self.progress.to_next_view())
        if outcome is Outcome.FLYING:
            self._run.depart()
        elif outcome is Outcome.BLOCKED:
            self.outbox.reports.extend(self.progress.skip("blocked", self.pilot.why_blocked))
        else:
            self.pilot.make_way(t_ns)

    def _hold(self, t_ns: int) -> None:
        if not self.still and not self._below_hover:
            self.pilot.make_way(t_ns)

    def _guided(self, t_ns: int) -> None:
        if self.guided.target is None:
            self.mode = HOLD
            return
        heading = self.guided.step(t_ns)
        if heading is Heading.BLOCKED:
            self.outbox.texts.append(f"no free way to that point: {self.pilot.why_blocked}")
        if heading is Heading.BLOCKED or (heading is Heading.THERE and self.mode == GUIDED):
            self.guided.forget()
            self.mode = HOLD
            self.pilot.arrived()

    def _return(self, t_ns: int) -> None:
        position = self.pilot.position(t_ns)
        if np.allclose(position, self.hover, atol=1e-3):
            self.mode = LAND
            self.pilot.arrived()
            return
        now = self.pilot.body.at(t_ns)
        if self.pilot.go([Via(self.hover, now.yaw_enu_rad)], t_ns, [self.hover]) is Outcome.WAITING:
            self.pilot.make_way(t_ns)

    def _land(self, t_ns: int) -> None:
        if np.allclose(self.pilot.position(t_ns), self.pad, atol=1e-3):
            self._touch_down()
        else:
            self._vertical_leg(self.pad, t_ns)

    def _emergency(self, t_ns: int) -> None:
        ground = self.pilot.position(t_ns).copy()
        if ground[2] <= self.pad[2] + 1e-3:
            self._touch_down()
            return
        ground[2] = self.pad[2]
        self._vertical_leg(ground, t_ns)

    def _touch_down(self) -> None:
        self.mode, self.armed = STANDBY, False
        self.outbox.texts.append("landed")

    def _vertical_leg(self, goal: Array, t_ns: int) -> None:
        now = self.pilot.body.at(t_ns)
        self.pilot.fly(Via(goal, now.yaw_enu_rad), self._vertical, t_ns)

    def _finish(self, t_ns: int) -> None:
        if self.return_when_done or self.progress.home_after:
            if self.progress.home_seq is not None:
                self.outbox.reached.append(self.progress.home_seq)
                self.progress.home_seq = None
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
        return level > self.spec.threshold_percent and level - need >= self.spec.reserve_percent


_MODES: dict[str, Callable[[Executor, int], None]] = {
    STANDBY: Executor._standby, TAKEOFF: Executor._takeoff, MISSION: Executor._mission, HOLD: Executor._hold,
    GUIDED: Executor._guided, OFFBOARD: Executor._guided, RETURN: Executor._return, LAND: Executor._land,
    DESCEND: Executor._emergency, EMERGENCY: Executor._emergency,
}
