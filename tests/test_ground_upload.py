"""Plan upload over a link that loses, doubles and reorders: exactly one whole plan, or none."""

from __future__ import annotations

import random
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from ground_station.fleet_link import VehicleLink
from missions.clock import SECOND_NS
from missions.frames import Site
from missions.mavlink import AUTOPILOT_COMPONENT, Endpoint, Item, Route, Waypoint, items_from_route, plan_sha256
from missions.messages import PlanHash, PlanVerdict
from vehicle.autopilot.craft import MISSION, Shelf
from vehicle.autopilot.mission_service import WINDOW, MissionService, TransferStyle

SITE = Site(52.0, 6.0, 40.0)
TICK_NS = SECOND_NS // 100
VEHICLE = 3


def route(views: int, plan_id: int = 7) -> Route:
    points = [Waypoint(position_enu_m=(float(i), 2.0, 10.0 + i / 7), yaw_enu_rad=0.1 * i, gimbal_elevation_rad=-0.3,
                       view_id=10001 + i, settle_s=0.5) for i in range(views)]
    return Route(plan_id=plan_id, phase="survey", waypoints=points)


class FakeVehicle:
    """The real mission service behind an endpoint; a plan counts when its hash is the announced one."""

    def __init__(self) -> None:
        self.endpoint = Endpoint(VEHICLE, AUTOPILOT_COMPONENT)
        self.service = MissionService({MISSION: Shelf()}, self._judge, lambda item: None, TransferStyle(WINDOW))
        self.announced: PlanHash | None = None
        self.accepted: list[list[Item]] = []
        self.verdicts: list[PlanVerdict] = []
        self.started = 0

    def _judge(self, kind: int, items: list[Item]) -> int:
        assert self.announced is not None
        sha = plan_sha256(items)
        good = sha == self.announced.sha256
        if good and (not self.accepted or plan_sha256(self.accepted[-1]) != sha):
            self.accepted.append(items)
        self.verdicts.append(PlanVerdict(plan_id=self.announced.plan_id, sha256=sha, accepted=good))
        return int(mav.MAV_MISSION_ACCEPTED if good else mav.MAV_MISSION_DENIED)

    def handle(self, frames: list[bytes], t_ns: int) -> list[bytes]:
        answers: list[Any] = []
        for message in self.endpoint.parse(frames):
            if message.get_type() == "COMMAND_LONG":
                self.started += message.command == mav.MAV_CMD_MISSION_START
                answers.append(mav.MAVLink_command_ack_message(message.command, mav.MAV_RESULT_ACCEPTED))
            else:
                answers.extend(self.service.handle(message, t_ns) or [])
        answers.extend(self.service.poll(t_ns))
        return [self.endpoint.pack(a) for a in answers]


class Wire:
    """Whole messages, some lost, some twice, some late."""

    def __init__(self, rng: random.Random, loss: float, twice: float = 0.0, late: float = 0.0) -> None:
        self._rng, self._loss, self._twice, self._late = rng, loss, twice, late
        self._under_way: list[tuple[int, int, Any]] = []
        self._n = 0

    def put(self, what: Any, t_ns: int) -> None:
        for _ in range(2 if self._rng.random() < self._twice else 1):
            if self._rng.random() >= self._loss:
                delay = self._rng.randint(2, 12) if self._rng.random() < self._late else 1
                self._under_way.append((t_ns + delay * TICK_NS, self._n, what))
                self._n += 1

    def take(self, t_ns: int) -> list[Any]:
        due = sorted(w for w in self._under_way if w[0] <= t_ns)
        self._under_way = [w for w in self._under_way if w[0] > t_ns]
        return [what for _, _, what in due]


def transfer(views: int, seed: int, loss: float, twice: float = 0.0, late: float = 0.0,
             limit_s: float = 60.0) -> tuple[VehicleLink, FakeVehicle, float]:
    """Fly one route over such a link; returns both ends and how long it took in simulated seconds."""
    rng = random.Random(seed)
    link, vehicle = VehicleLink(VEHICLE, SITE), FakeVehicle()
    down, up, verdicts, hashes = (Wire(rng, loss, twice, late) for _ in range(4))
    link.fly(route(views))
    t_ns, told = 0, 0
    while t_ns < limit_s * SECOND_NS and link.busy:
        for frame in up.take(t_ns):
            link.on_frames([frame])
        for verdict in verdicts.take(t_ns):
            link.on_verdict(verdict)
        out = link.poll(t_ns)
        if out.plan_hash is not None:
            hashes.put(out.plan_hash, t_ns)
        for frame in out.frames:
            down.put(frame, t_ns)
        for announced in hashes.take(t_ns):
            vehicle.announced = announced
        if vehicle.announced is not None:
            for frame in vehicle.handle(down.take(t_ns), t_ns):
                up.put(frame, t_ns)
        for verdict in vehicle.verdicts[told:]:
            verdicts.put(verdict, t_ns)
        told = len(vehicle.verdicts)
        t_ns += TICK_NS
    return link, vehicle, t_ns / SECOND_NS


def test_clean_link_forty_views_within_a_second() -> None:
    link, vehicle, seconds = transfer(40, 1, loss=0.0)
    assert seconds < 1.0
    assert link.failure == ""
    assert [plan_sha256(p) for p in vehicle.accepted] == [plan_sha256(items_from_route(route(40), SITE))]
    assert vehicle.started == 1


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 15))
def test_bad_link_gives_the_sent_plan_or_none(seed: int, views: int) -> None:
    link, vehicle, _ = transfer(views, seed, loss=0.2, twice=0.2, late=0.3)
    wanted = plan_sha256(items_from_route(route(views), SITE))
    assert not link.busy
    assert all(plan_sha256(items) == wanted for items in vehicle.accepted)
    assert len(vehicle.accepted) <= 1
    if not link.failure:
        assert len(vehicle.accepted) == 1
        assert vehicle.started >= 1


def test_twenty_percent_loss_usually_gets_through() -> None:
    failures = [bool(transfer(10, seed, loss=0.2, twice=0.2, late=0.2)[0].failure) for seed in range(20)]
    assert sum(failures) == 0


def test_dead_link_fails_closed_in_time() -> None:
    link, vehicle, seconds = transfer(5, 1, loss=1.0)
    assert "not delivered" in link.failure
    assert not vehicle.accepted
    assert 29.0 < seconds < 31.0


def test_refusal_carries_its_reason_and_nothing_is_started() -> None:
    link = VehicleLink(VEHICLE, SITE)
    link.fly(route(2))
    sent = link.poll(0).plan_hash
    assert sent is not None
    link.on_verdict(PlanVerdict(plan_id=sent.plan_id, sha256=sent.sha256, accepted=False, reason="fence: waypoint 1"))
    out = link.poll(TICK_NS)
    assert "fence: waypoint 1" in link.take_failure()
    assert not link.busy
    assert out.frames == []


def test_a_verdict_on_another_plan_or_hash_accepts_nothing() -> None:
    link = VehicleLink(VEHICLE, SITE)
    link.fly(route(2))
    sent = link.poll(0).plan_hash
    assert sent is not None
    link.on_verdict(PlanVerdict(plan_id=sent.plan_id + 1, sha256=sent.sha256, accepted=True))
    link.poll(TICK_NS)
    assert link.busy
    link.on_verdict(PlanVerdict(plan_id=sent.plan_id, sha256="0" * 64, accepted=True))
    link.poll(2 * TICK_NS)
    assert "another plan" in link.take_failure()
