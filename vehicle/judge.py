"""Accepts or refuses plans and fences, whole: those of our own ground station, and those of others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pymavlink.dialects.v20 import common as mav

from missions.errors import ProtocolError
from missions.frames import Array, Site
from missions.mavlink import Item, Route, plan_sha256, route_from_items
from missions.messages import FenceOrder, FenceVerdict, PlanHash, PlanVerdict
from missions.mission import Mission
from vehicle.autopilot.craft import FENCE, MISSION
from vehicle.client_fence import fence_from_items
from vehicle.client_plan import Place, PlanRefused, read_plan
from vehicle.dialects import Dialect
from vehicle.executor import Executor
from vehicle.geofence import FENCE_TOLERANCE_M, Geofence
from vehicle.plan_check import refusal

ACCEPTED: int = mav.MAV_MISSION_ACCEPTED
DENIED: int = mav.MAV_MISSION_DENIED


class Judge:
    """Of one vehicle. What it has to say waits in `verdicts` (for our ground station) and `texts` (for all)."""

    def __init__(self, mission: Mission, site: Site, executor: Executor, box: tuple[Array, Array],
                 limit: tuple[Array, Array]) -> None:
        """box: the mission's geofence. limit: how far it may be moved out."""
        self.announced: PlanHash | None = None
        self.accepted: PlanHash | None = None
        self.fence = self.box = Geofence(*box)
        """With what was uploaded, and without."""
        self.verdicts: list[PlanVerdict] = []
        self.texts: list[str] = []
        self._mission, self._site, self._executor, self._limit = mission, site, executor, limit
        self._t_ns = 0
        self._client_plans = 0

    def at(self, t_ns: int) -> None:
        """Time goes on."""
        self._t_ns = t_ns

    def ours(self, kind: int, items: list[Item]) -> int:
        """MAV_MISSION_RESULT for a list from our own ground station; a plan must be the one that was announced."""
        if kind == MISSION:
            return ACCEPTED if self._our_plan(items) else DENIED
        return self._other(kind, items)

    def clients(self, kind: int, items: list[Item], dialect: Dialect) -> int:
        """The same for somebody else's."""
        if kind != MISSION:
            return self._other(kind, items)
        if not items:
            self._forget()
            return ACCEPTED
        try:
            self._take_client_plan(items, dialect)
        except PlanRefused as e:
            self.texts.append(f"plan refused: {e.reason}")
            return e.result
        return ACCEPTED

    def take_texts(self) -> list[str]:
        """What people should know, once."""
        texts, self.texts = self.texts, []
        return texts

    def take_verdicts(self) -> list[PlanVerdict]:
        """What our ground station waits for, once."""
        verdicts, self.verdicts = self.verdicts, []
        return verdicts

    def widen(self, order: FenceOrder) -> FenceVerdict:
        """Take a wider box on board. Nothing in it is known to be free for that."""
        lower, upper, limit = np.array(order.lower_enu_m), np.array(order.upper_enu_m), self._limit
        reason = ""
        if not (np.isfinite([lower, upper]).all() and (lower >= limit[0] - FENCE_TOLERANCE_M).all()
                and (upper <= limit[1] + FENCE_TOLERANCE_M).all()):
            reason = "it reaches beyond what the mission allows"
        elif (lower > self.box.lower_enu_m + FENCE_TOLERANCE_M).any() or (
                upper < self.box.upper_enu_m - FENCE_TOLERANCE_M).any():
            reason = "the fence on board can only be widened"
        else:
            self.box = Geofence(lower, upper)
            self.fence = replace(self.fence, lower_enu_m=lower, upper_enu_m=upper)
        return FenceVerdict(order_id=order.order_id, accepted=not reason, reason=reason)

    def recall(self, box_enu_m: tuple[Array, Array], items: list[Item]) -> None:
        """The fence that a process of this vehicle had before: its box, and what was uploaded."""
        self.fence = self.box = Geofence(*box_enu_m)
        self._other(FENCE, items)

    def why_not_there(self, point_enu_m: Array) -> str:
        """Why a point (3,) may not be flown to; "" when it may."""
        if self.fence.room_m(point_enu_m[None])[0] < 0.0:
            return "it lies outside the geofence"
        if not self._executor.pilot.avoidance.clear(point_enu_m, point_enu_m):
            return f"within {self._mission.fleet.clearance_m:g} m of it is something that is not known to be free"
        return ""

    def _our_plan(self, items: list[Item]) -> bool:
        """Nothing uploaded means that the plan is cleared."""
        if not items:
            self._forget()
            return True
        sha256, announced = plan_sha256(items), self.announced
        if announced is None or announced.sha256 != sha256 or announced.count != len(items):
            plan_id = announced.plan_id if announced is not None else 0
            return self._verdict(plan_id, sha256, "hash: the plan received is not the one that was announced")
        if self.accepted == announced:
            return self._verdict(announced.plan_id, sha256, "")
        try:
            route = route_from_items(items, self._site, announced.plan_id)
        except ProtocolError as e:
            return self._verdict(announced.plan_id, sha256, f"items: {e}")
        reason = self._refusal(route)
        if not reason:
            self.accepted = announced
            self._executor.take(route, _item_groups(items))
        return self._verdict(announced.plan_id, sha256, reason)

    def _take_client_plan(self, items: list[Item], dialect: Dialect) -> None:
        """Raises PlanRefused."""
        executor = self._executor
        place = Place(self._site, executor.pad, executor.hover, executor.pilot.position(self._t_ns))
        self._client_plans += 1
        plan = read_plan(items, place, self._client_plans, executor.camera.new_view_id, dialect.nan_allowed)
        if not plan.route.waypoints:
            raise PlanRefused(mav.MAV_MISSION_INVALID, "it has no waypoint")
        points = np.array([w.position_enu_m for w in plan.route.waypoints])
        outside = np.flatnonzero(self.fence.room_m(points) < 0.0)
        if len(outside):
            seq = plan.groups[int(outside[0])][0]
            raise PlanRefused(mav.MAV_MISSION_INVALID_PARAM5_X, f"item {seq} lies outside the geofence")
        reason = self._refusal(plan.route)
        if reason:
            raise PlanRefused(DENIED, reason)
        self.accepted = None
        executor.take(plan.route, plan.groups, plan.home_seq)

    def _other(self, kind: int, items: list[Item]) -> int:
        if kind != FENCE:
            return ACCEPTED  # rally points are kept; landing anywhere but on the own pad is not known to be safe
        try:
            self.fence = fence_from_items(items, self._site, self.box, self._executor.pad)
        except PlanRefused as e:
            self.texts.append(f"fence refused: {e.reason}")
            return e.result
        return ACCEPTED

    def _forget(self) -> None:
        self.accepted = None
        self._executor.drop_plan()

    def _refusal(self, route: Route) -> str:
        pilot, executor = self._executor.pilot, self._executor
        return refusal(route, pilot.position(self._t_ns), self.fence, self._mission.fleet, executor.spec,
                       pilot.avoidance, executor.battery, executor.way_home)

    def _verdict(self, plan_id: int, sha256: str, reason: str) -> bool:
        self.verdicts.append(PlanVerdict(plan_id=plan_id, sha256=sha256, accepted=not reason, reason=reason))
        if reason:
            self.texts.append(f"plan refused: {reason}")
        return not reason


def _item_groups(items: list[Item]) -> list[list[int]]:
    """For each waypoint of the route, the sequence numbers of the mission items that it is made of."""
    groups: list[list[int]] = []
    for seq, item in enumerate(items):
        if item.command == mav.MAV_CMD_NAV_WAYPOINT:
            groups.append([seq])
        elif groups and item.command != mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            groups[-1].append(seq)
    return groups
