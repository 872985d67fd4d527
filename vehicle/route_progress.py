"""How far a vehicle has come with its route: what is next, what has been reached, what is given back."""

from __future__ import annotations

import math

import numpy as np

from missions.frames import Array
from missions.mavlink import Route, Waypoint
from missions.messages import LegReport, ShutterRequest
from planning.trajectories import MAX_RUN, Via, run_length
from vehicle.camera import CameraPayload
from vehicle.simulator import Kinematics


class RouteProgress:
    """The route under way and the one that follows it."""

    def __init__(self, camera: CameraPayload) -> None:
        self.route: Route | None = None
        self.index = 0
        self._camera = camera
        self._items: list[list[int]] = []
        self._next: tuple[Route, list[list[int]], int | None] | None = None
        self.home_seq: int | None = None
        """The mission item that returns, until it is done."""
        self._jump_to: int | None = None

    @property
    def left(self) -> bool:
        """Whether there are waypoints to fly to."""
        return self.route is not None and self.index < len(self.route.waypoints)

    @property
    def home_after(self) -> bool:
        """Whether the route ends on the pad."""
        return self.route is not None and self.route.home_after

    def take(self, route: Route, items: list[list[int]], home_seq: int | None = None) -> None:
        """Fly this next. items: for each waypoint the mission items that it is made of; home_seq: the return's."""
        self._next = (route, items, home_seq)

    def jump(self, seq: int) -> None:
        """Go on with the waypoint that mission item `seq` belongs to."""
        self._jump_to = next((n for n, items in enumerate(self._items) if items[-1] >= seq), len(self._items))

    def turn_page(self) -> bool:
        """Obey jumps and take over the route that follows; whether there was any."""
        turned = self._jump_to is not None or self._next is not None
        if self._jump_to is not None:
            self.index, self._jump_to = self._jump_to, None
        if self._next is not None:
            (self.route, self._items, self.home_seq), self.index, self._next = self._next, 0, None
        return turned

    def skip_exposed(self) -> list[int]:
        """Pass over views whose pictures are taken; sequence numbers of their items."""
        reached: list[int] = []
        while self.left and self.route is not None and \
                (self.route.phase, self.waypoint(self.index).view_id) in self._camera.exposed:
            reached.extend(self._items[self.index])
            self.index += 1
        return reached

    def waypoint(self, n: int) -> Waypoint:
        """Waypoint n of the route under way."""
        assert self.route is not None, "only a route has waypoints"
        return self.route.waypoints[n]

    def run(self) -> list[Via]:
        """What comes next, up to the first stop."""
        left = [Via(np.array(w.position_enu_m), w.yaw_enu_rad, w.gimbal_elevation_rad, w.stop, w.settle_s, w.pass_m,
                    w.speed_m_s or math.inf) for w in self._ahead()]
        return left[:run_length(left)]

    def to_next_view(self) -> list[Array]:
        """Positions of what comes next, up to the first view."""
        ahead = self._ahead()
        last = next((n for n, w in enumerate(ahead) if w.view_id is not None), len(ahead) - 1)
        return [np.array(w.position_enu_m) for w in ahead[:last + 1]]

    def complete(self, n: int, kinematics: Kinematics, t_ns: int) -> tuple[ShutterRequest | None, list[int]]:
        """Waypoint n is reached: the picture to take there, and the sequence numbers of its items."""
        assert self.route is not None, "only a route has waypoints"
        waypoint, self.index = self.waypoint(n), n + 1
        request = None
        if waypoint.view_id is not None:
            request = self._camera.expose(waypoint.view_id, self.route.phase, kinematics, t_ns)
        return request, self._items[n]

    def skip(self, outcome: str, detail: str) -> list[LegReport]:
        """Give the next waypoint back."""
        reports = self._reports(self.route, self.index, self.index + 1, outcome, detail)
        self.index += 1
        return reports

    def give_back(self, outcome: str) -> list[LegReport]:
        """Give back all that has not been flown, of the route that follows as well."""
        following = self._next[0] if self._next is not None else None
        reports = [*self._reports(self.route, self.index, None, outcome, ""),
                   *self._reports(following, 0, None, outcome, "")]
        if self.route is not None:
            self.index = len(self.route.waypoints)
        self._next = None
        return reports

    def _ahead(self) -> list[Waypoint]:
        return self.route.waypoints[self.index:self.index + MAX_RUN] if self.route is not None else []

    def _reports(self, route: Route | None, first: int, end: int | None, outcome: str, detail: str) -> list[LegReport]:
        if route is None:
            return []
        return [LegReport(plan_id=route.plan_id, view_id=w.view_id, outcome=outcome, detail=detail)
                for w in route.waypoints[first:end]
                if w.view_id is not None and (route.phase, w.view_id) not in self._camera.exposed]
