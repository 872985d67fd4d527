"""The flight under way along a route: which waypoints it passes when, at which it ends, and what is done there."""

from __future__ import annotations

from vehicle.modes import Outbox
from vehicle.pilot import Pilot
from vehicle.route_progress import RouteProgress
from vehicle.way_home import WayHome


class RouteRun:
    """Between two rests at most one run is under way."""

    def __init__(self, progress: RouteProgress, pilot: Pilot, way_home: WayHome, outbox: Outbox) -> None:
        self._progress, self._pilot, self._way_home, self._outbox = progress, pilot, way_home, outbox
        self._passing: list[tuple[int, int]] = []
        self._target: int | None = None

    @property
    def ends_at_waypoint(self) -> bool:
        """Whether a waypoint is still to be completed where the flight ends."""
        return self._target is not None

    @property
    def wake_ns(self) -> int | None:
        """When the next shutter opens in passing, if any."""
        due = [t for t, n in self._passing if self._progress.waypoint(n).view_id is not None]
        return due[0] if due else None

    def depart(self) -> None:
        """Remember which waypoints the flight that was launched passes, and at which it ends."""
        first, reaches_ns = self._progress.index, self._pilot.helm.reaches_ns
        self._passing = [(t, first + n) for n, t in enumerate(reaches_ns[:-1])]
        self._target = first + len(reaches_ns) - 1 if reaches_ns else None

    def forget(self) -> None:
        """The flight is given up."""
        self._passing, self._target = [], None

    def pass_waypoints(self, t_ns: int) -> None:
        """Complete those that have been passed."""
        while self._passing and self._passing[0][0] <= t_ns:
            _, n = self._passing.pop(0)
            self._complete(n, t_ns)

    def arrive(self, t_ns: int) -> None:
        """At rest: complete the waypoint at which the flight ended, if it was one."""
        if self._target is not None:
            n, self._target = self._target, None
            self._complete(n, t_ns)
            self._pilot.arrived()

    def note_place(self, t_ns: int) -> None:
        """The vehicle could come back to here."""
        self._way_home.note(self._pilot.position(t_ns), self._pilot.avoidance.clear)

    def _complete(self, n: int, t_ns: int) -> None:
        """Waypoint n is reached: take its picture."""
        request, items = self._progress.complete(n, self._pilot.body.measured(t_ns), t_ns)
        if request is not None:
            self._outbox.shutters.append(request)
        self._outbox.reached.extend(items)
        self.note_place(t_ns)
