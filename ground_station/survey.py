"""The survey's book-keeping: who flies which views, in chunks, and what happens to views that somebody cannot fly.

No bus, no clock. Every view ends with exactly one outcome (see `ledger`). Who gets which view is a `tours.Method`.
"""

from __future__ import annotations

import logging
import math

import numpy as np

from ground_station.airspace import Airspace
from ground_station.ledger import ENERGY, UNREACHABLE, ViewLedger
from ground_station.legs import Shooting, survey_leg
from ground_station.tours import Flyer, Flying, Method, Tours
from missions.camera import View
from missions.frames import Array
from missions.mavlink import Waypoint
from planning.paths import NoPath

log = logging.getLogger(__name__)

CHUNK_VIEWS = 30
"""Views per upload: few enough that a reassigned view is flown soon, many enough that uploads do not count."""
MOST_VIEWS = 45
"""A tour's last upload may have so many, rather than leave a few for one more."""


class Survey:
    """Tours, their execution in chunks, and reassignment."""

    def __init__(self, views: list[View], method: Method, shooting: Shooting) -> None:
        self.ledger = ViewLedger(views)
        self._method, self._shooting = method, shooting
        self._views = len(views)
        self._sorties: dict[int, list[list[int]]] = {}
        self._active: dict[int, list[int]] = {}
        self._flown: dict[int, int] = {}
        self._chunk: dict[int, int] = {}
        self._known: set[int] = set()
        self._asked: set[int] = set()
        """Vehicles without views for which nothing was found."""

    @property
    def over(self) -> bool:
        """Whether every view has its outcome."""
        return self.ledger.open_count == 0

    @property
    def progress(self) -> tuple[int, int]:
        """(views with an outcome, all views)."""
        return self._views - self.ledger.open_count, self._views

    def left(self, vehicle_id: int) -> int:
        """Views that a vehicle still has to fly."""
        return len(self.ledger.held_by(vehicle_id))

    def later_enu_m(self, vehicle_id: int) -> list[tuple[float, float, float]]:
        """Where the views are that a vehicle is to fly after those it was sent, sortie after sortie."""
        return [self.ledger.view(v).pose.position_enu_m for sortie in self._sorties.get(vehicle_id, []) for v in sortie]

    def waiting(self, vehicle_id: int) -> bool:
        """Whether a vehicle has views for its present battery that are not in its plan yet."""
        return bool(self._sorties.get(vehicle_id, [[]])[0])

    def wants_swap(self, vehicle_id: int) -> bool:
        """Whether a vehicle has nothing left for its present battery, but for the next."""
        sorties = self._sorties.get(vehicle_id, [[]])
        return not sorties[0] and any(sorties[1:]) and not self._active.get(vehicle_id)

    def swapped(self, vehicle_id: int) -> None:
        """The vehicle's next sortie begins."""
        self._sorties[vehicle_id] = [s for s in self._sorties[vehicle_id][1:] if s] or [[]]

    def begin(self, flyers: list[Flyer], t_s: float) -> None:
        """The first tours."""
        if flyers and self._views:
            self._take(self._method.begin(flyers), t_s)
        self._note(flyers)

    def news(self, able: list[int]) -> str:
        """Why the tours should change now that these vehicles can fly; "" when they should not."""
        homeless = self.ledger.homeless()
        if homeless:
            return ", ".join(sorted({self.ledger.why_released(v) or "new" for v in homeless}))
        if self.over or not any(self.waiting(k) for k in able):
            return ""
        if not set(able) <= self._known:
            return "join"
        return "idle" if any(self._idle(k) and k not in self._asked for k in able) else ""

    def redistribute(self, flyers: list[Flyer], t_s: float) -> None:
        """Give every view that nobody holds to a vehicle that has not found it blocked and can afford it, or settle
        its outcome; the tours of all may change for that."""
        able = {f.vehicle_id for f in flyers}
        for view_id in self.ledger.homeless():
            refused_by = self.ledger.refused_by(view_id)
            if able <= set(refused_by):
                kind = UNREACHABLE if refused_by else self.ledger.why_released(view_id) or UNREACHABLE
                self.ledger.settle(view_id, kind, "" if able else "no vehicle is left")
        if flyers and not self.over:
            now = Flying({f.vehicle_id: self._to_fly(f.vehicle_id) for f in flyers},
                         {f.vehicle_id: len(self._active.get(f.vehicle_id, [])) for f in flyers},
                         self.ledger.homeless(), self._refusals(), self._flown)
            self._take(self._method.again(flyers, now), t_s)
        self._note(flyers)

    def shut_in(self, flyer: Flyer, airspace: Airspace, teammates_enu_m: list[Array]) -> bool:
        """Whether there is no way from where a vehicle hovers to any view that it still has to plan."""
        poses = [self.ledger.view(i).pose for i in self._queue(flyer.vehicle_id)]
        goals = np.array([p.position_enu_m for p in poses]).reshape(-1, 3)
        reach = airspace.reach(flyer.position_enu_m, teammates_enu_m)
        return bool(len(goals)) and not np.isfinite(reach.distance_to(goals)).any()

    def next_waypoints(self, flyer: Flyer, airspace: Airspace, teammates_enu_m: list[Array],
                       share: float = 1.0) -> list[Waypoint]:
        """The vehicle's next chunk, or a share of it, every leg free of collisions; views without a way are handed
        back. May be empty."""
        queue = self._queue(flyer.vehicle_id)
        whole = min(len(queue), CHUNK_VIEWS if len(queue) > MOST_VIEWS else MOST_VIEWS)
        size = max(1, math.ceil(share * self._chunk.get(flyer.vehicle_id, whole)))
        paths: list[Array] = []
        taken: list[View] = []
        here = flyer.position_enu_m
        while queue and len(taken) < size:
            view = self.ledger.view(queue.pop(0))
            try:
                path = airspace.path(here, np.array(view.pose.position_enu_m), teammates_enu_m)
            except NoPath as refusal:
                log.info("vehicle %d has no way to view %d: %s", flyer.vehicle_id, view.view_id, refusal)
                self.ledger.blocked(view.view_id, str(refusal))
                continue
            paths.append(path)
            here = path[-1]
            taken.append(view)
        self._active[flyer.vehicle_id] = [v.view_id for v in taken]
        return survey_leg(paths, taken, self._shooting)

    def flown(self, view_id: int, vehicle_id: int) -> None:
        """The picture of a view is on disk."""
        if view_id in self.ledger:
            self.ledger.flown(view_id)
            self._forget(view_id)
            self._flown[vehicle_id] = self._flown.get(vehicle_id, 0) + 1
            self._chunk.pop(vehicle_id, None)

    def not_flown(self, view_id: int, vehicle_id: int, outcome: str, detail: str) -> None:
        """The vehicle reported that it will not fly a view."""
        if view_id not in self.ledger or view_id not in self.ledger.held_by(vehicle_id):
            return
        self._forget(view_id)
        if outcome == ENERGY:
            self.ledger.release(view_id, ENERGY, detail)
        else:
            self.ledger.blocked(view_id, f"{outcome}: {detail}" if detail else outcome)

    def take_back(self, vehicle_id: int) -> None:
        """The chunk made last is not sent."""
        self._queue(vehicle_id)[:0] = self._active.pop(vehicle_id, [])

    def plan_refused(self, vehicle_id: int, reason: str, culprit: int | None = None) -> None:
        """The vehicle refused a chunk. The view that it refused, where it said which, counts as blocked and the others
        are sent again; else half as many views next time, and a single one counts as blocked."""
        chunk = self._active.pop(vehicle_id, [])
        if culprit in chunk:
            self.ledger.blocked(culprit, reason)
            self._queue(vehicle_id)[:0] = [v for v in chunk if v != culprit]
            return
        if len(chunk) <= 1:
            for view_id in chunk:
                self.ledger.blocked(view_id, reason)
            return
        self._chunk[vehicle_id] = max(1, len(chunk) // 2)
        self._active[vehicle_id] = chunk
        self.take_back(vehicle_id)

    def plan_over(self, vehicle_id: int) -> None:
        """The vehicle hovers at the end of its plan; what it neither flew nor reported counts as blocked."""
        for view_id in self._active.pop(vehicle_id, []):
            self.ledger.blocked(view_id, "neither flown nor reported")

    def gone(self, vehicle_id: int, reason: str) -> None:
        """The vehicle flies nothing more with this battery: it returned for energy, or is lost."""
        for view_id in self.ledger.held_by(vehicle_id):
            self.ledger.release(view_id, reason)
        self._sorties.pop(vehicle_id, None)
        self._active.pop(vehicle_id, None)
        self._known.discard(vehicle_id)

    def _take(self, tours: Tours, t_s: float) -> None:
        """Make these the tours. What a vehicle was sent stays with it, whatever they say."""
        sent = {view_id for views in self._active.values() for view_id in views}
        for vehicle_id, sorties in tours.sorties.items():
            own = [[v for v in sortie if v not in sent] for sortie in sorties]
            for view_id in (v for sortie in own for v in sortie):
                self.ledger.give(view_id, vehicle_id, t_s)
            self._sorties[vehicle_id] = own or [[]]
        for view_id, outcome in tours.left_over.items():
            if view_id not in sent:
                self.ledger.settle(view_id, outcome.kind, outcome.detail)

    def _note(self, flyers: list[Flyer]) -> None:
        self._known = {f.vehicle_id for f in flyers}
        self._asked = {k for k in self._known if self._idle(k)}

    def _idle(self, vehicle_id: int) -> bool:
        return not self.ledger.held_by(vehicle_id)

    def _to_fly(self, vehicle_id: int) -> list[list[int]]:
        first, *later = self._sorties.get(vehicle_id, [[]])
        return [[*self._active.get(vehicle_id, []), *first], *later]

    def _queue(self, vehicle_id: int) -> list[int]:
        """What a vehicle still has to be sent for its present battery; changing it changes the tour."""
        return self._sorties.setdefault(vehicle_id, [[]])[0]

    def _refusals(self) -> dict[int, list[int]]:
        return {i: self.ledger.refused_by(i) for i in self.ledger.open_ids() if self.ledger.refused_by(i)}

    def _forget(self, view_id: int) -> None:
        for views in (*(s for sorties in self._sorties.values() for s in sorties), *self._active.values()):
            if view_id in views:
                views.remove(view_id)
