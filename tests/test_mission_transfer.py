"""Both ends of the mission protocol over a link that loses, repeats and reorders: never a wrong plan, always an end."""

from __future__ import annotations

import heapq
import itertools
import random
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from pymavlink.dialects.v20 import common as mav

from missions.flight_plan import item_from_params
from missions.mavlink import GROUND_COMPONENT, GROUND_SYSTEM, Endpoint, Item, plan_sha256
from missions.mission_transfer import Download, Transfer, Upload, VerifiedUpload, as_ardupilot_keeps
from missions.signing import Signing
from sim_bridge.faults import Faults
from vehicle.autopilot.craft import Shelf
from vehicle.autopilot.mission_service import MissionService, TransferStyle

VEHICLE, TICK_S, DEADLINE_S = 7, 0.01, 60.0
TYPES = (mav.MAV_MISSION_TYPE_MISSION, mav.MAV_MISSION_TYPE_FENCE, mav.MAV_MISSION_TYPE_RALLY)


def plan(n: int, seed: int = 0) -> list[Item]:
    """n items that differ from each other and from those of another seed."""
    return [item_from_params(3, 16, (0, 0, seed, None, 52.0 + k * 1e-5, 6.0 + seed * 1e-4, 10 + k), "made")
            for k in range(n)]


@dataclass
class VehicleEnd:
    """The mission service of a vehicle, packed and parsed as on a wire."""

    result: int = mav.MAV_MISSION_ACCEPTED
    shelves: dict[int, Shelf] = field(default_factory=lambda: {kind: Shelf() for kind in TYPES})
    system: int = VEHICLE
    signing: Signing | None = None

    def __post_init__(self) -> None:
        self.endpoint = Endpoint(self.system, 1, self.signing)
        self.service = MissionService(self.shelves, lambda kind, items: self.result, lambda seq: None, TransferStyle())

    def step(self, frames: list[bytes], t_s: float) -> list[bytes]:
        t_ns = round(t_s * 1e9)
        answers = [a for m in self.endpoint.parse(frames) for a in self.service.handle(m, t_ns) or []]
        return [self.endpoint.pack(a) for a in answers + self.service.poll(t_ns)]


class Air:
    """One direction of a link in made-up time."""

    def __init__(self, faults: Faults, seed: str) -> None:
        self.faults, self._rng, self._order = faults, random.Random(seed), itertools.count()
        self._due: list[tuple[float, int, bytes]] = []

    def send(self, frames: list[bytes], t_s: float) -> None:
        for frame in frames:
            for delay_s in self.faults.delays_s(self._rng):
                heapq.heappush(self._due, (t_s + delay_s, next(self._order), frame))

    def arrived(self, t_s: float) -> list[bytes]:
        out = []
        while self._due and self._due[0][0] <= t_s:
            out.append(heapq.heappop(self._due)[2])
        return out


def fly(transfer: Transfer, vehicle: VehicleEnd, faults: Faults, seed: int = 0, start_s: float = 0.0,
        until_s: float = 2 * DEADLINE_S) -> float:
    """Run a transfer over a bad link until it is over; returns when that was."""
    ground = Endpoint(GROUND_SYSTEM, GROUND_COMPONENT)
    up, down = Air(faults, f"{seed} up"), Air(faults, f"{seed} down")
    t_s = start_s
    while not transfer.over and t_s < until_s:
        answers = [a for m in ground.parse(down.arrived(t_s)) for a in transfer.receive(m, t_s)]
        up.send([ground.pack(a) for a in answers + transfer.poll(t_s)], t_s)
        down.send(vehicle.step(up.arrived(t_s), t_s), t_s)
        t_s += TICK_S
    return t_s


def same(a: list[Item], b: list[Item]) -> bool:
    return plan_sha256(a) == plan_sha256(b)


bad_links = st.builds(Faults, loss=st.floats(0.0, 0.6), duplicates=st.floats(0.0, 0.5), reordered=st.floats(0.0, 0.5),
                      latency_s=st.floats(0.0, 0.3), reorder_s=st.floats(0.0, 1.0))


@given(link=bad_links, seed=st.integers(0, 1000), n=st.integers(0, 12), kind=st.sampled_from(TYPES))
@example(link=Faults(loss=1.0), seed=0, n=3, kind=0)
@settings(max_examples=60, deadline=None)
def test_never_a_wrong_plan_and_always_an_end(link: Faults, seed: int, n: int, kind: int) -> None:
    vehicle, new, old = VehicleEnd(), plan(n, 1), plan(5, 2)
    vehicle.shelves[kind].put(old)
    transfer = VerifiedUpload(new, VEHICLE, DEADLINE_S, kind)
    assert fly(transfer, vehicle, link, seed) <= DEADLINE_S + 2 * TICK_S
    held = vehicle.shelves[kind].items
    assert same(held, new) or (same(held, old) and transfer.outcome == "failed")
    assert all(not vehicle.shelves[other].items for other in TYPES if other != kind)
    assert transfer.outcome == "done" or transfer.reason


@given(link=bad_links, seed=st.integers(0, 1000), cut=st.integers(1, 7))
@settings(max_examples=30, deadline=None)
def test_an_upload_after_one_that_was_cut_short_is_not_mixed_with_it(link: Faults, seed: int, cut: int) -> None:
    vehicle, first, second = VehicleEnd(), plan(8, 1), plan(8, 2)
    fly(Upload(first, VEHICLE), vehicle, link, seed, until_s=cut * 0.1)
    transfer = VerifiedUpload(second, VEHICLE, DEADLINE_S)
    fly(transfer, vehicle, link, seed + 1, start_s=cut * 0.1)
    if transfer.outcome == "done":
        assert same(vehicle.shelves[0].items, second)


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("seed", range(4))
def test_100_items_get_through_20_percent_loss_in_30_seconds(kind: int, seed: int) -> None:
    link = Faults(loss=0.2, duplicates=0.05, reordered=0.05, latency_s=0.01)
    vehicle, items = VehicleEnd(), plan(100)
    transfer = VerifiedUpload(items, VEHICLE, 30.0, kind)
    fly(transfer, vehicle, link, seed)
    assert (transfer.outcome, transfer.attempts) == ("done", 1)
    assert same(vehicle.shelves[kind].items, items)


@given(link=bad_links, seed=st.integers(0, 1000), n=st.integers(0, 12))
@settings(max_examples=30, deadline=None)
def test_a_download_is_whole_or_has_failed(link: Faults, seed: int, n: int) -> None:
    vehicle = VehicleEnd()
    vehicle.shelves[0].put(plan(n))
    transfer = Download(VEHICLE, deadline_s=DEADLINE_S)
    fly(transfer, vehicle, link, seed)
    assert transfer.outcome == ("done" if same(transfer.items, plan(n)) and not transfer.reason else "failed")


@pytest.mark.parametrize(("result", "reason"), [(mav.MAV_MISSION_DENIED, "denied"),
                                                (mav.MAV_MISSION_INVALID_PARAM7, "parameter 7 of an item is invalid"),
                                                (mav.MAV_MISSION_UNSUPPORTED_FRAME, "a frame is not supported")])
def test_a_refused_plan_is_not_sent_again(result: int, reason: str) -> None:
    vehicle = VehicleEnd(result)
    transfer = VerifiedUpload(plan(5), VEHICLE, DEADLINE_S)
    assert fly(transfer, vehicle, Faults(latency_s=0.01)) < 1.0
    assert (transfer.outcome, transfer.reason, transfer.attempts) == ("refused", reason, 1)
    assert vehicle.shelves[0].items == []


def test_a_vehicle_that_forgets_the_upload_is_told_again() -> None:
    vehicle, items = VehicleEnd(), plan(50)
    transfer = VerifiedUpload(items, VEHICLE, DEADLINE_S)
    fly(transfer, vehicle, Faults(latency_s=0.01), until_s=0.5)
    restarted = VehicleEnd()
    fly(transfer, restarted, Faults(latency_s=0.01), start_s=0.5)
    assert transfer.outcome == "done"
    assert same(restarted.shelves[0].items, items)


def test_a_vehicle_that_holds_another_plan_is_sent_it_again() -> None:
    vehicle, items = VehicleEnd(), plan(5)
    shelf = vehicle.shelves[0]
    stored: list[list[Item]] = []

    def misread(held: list[Item]) -> None:
        stored.append(held)
        shelf.items = held if len(stored) > 1 else [*held[:2], plan(1, 9)[0], *held[3:]]

    shelf.put = misread  # type: ignore[method-assign]
    transfer = VerifiedUpload(items, VEHICLE, DEADLINE_S)
    fly(transfer, vehicle, Faults(latency_s=0.01))
    assert (transfer.outcome, transfer.attempts) == ("done", 2)
    assert same(shelf.items, items)


def test_a_transfer_that_fails_tells_the_vehicle_and_says_how_far_it_came() -> None:
    transfer = VerifiedUpload(plan(3), VEHICLE, 5.0)
    fly(transfer, VehicleEnd(), Faults(loss=1.0), until_s=4.9)
    assert [(m.get_type(), m.type) for m in transfer.poll(5.0)] == [
        ("MISSION_ACK", mav.MAV_MISSION_OPERATION_CANCELLED)]
    assert transfer.reason == "no proof that it arrived; time was up sending it, 0% done in try 1"
    assert transfer.poll(6.0) == []


def heard(message: Any, system: int = VEHICLE, component: int = 1) -> Any:
    return Endpoint(GROUND_SYSTEM, GROUND_COMPONENT).parse([Endpoint(system, component).pack(message)])[0]


@pytest.mark.parametrize("stray", [
    heard(mav.MAVLink_mission_ack_message(255, 190, mav.MAV_MISSION_DENIED, mav.MAV_MISSION_TYPE_FENCE)),
    heard(mav.MAVLink_mission_ack_message(255, 190, mav.MAV_MISSION_DENIED), system=8),
    heard(mav.MAVLink_mission_ack_message(255, 190, mav.MAV_MISSION_DENIED), component=100),
    heard(mav.MAVLink_mission_ack_message(255, 190, mav.MAV_MISSION_ACCEPTED)),
    heard(mav.MAVLink_mission_request_int_message(255, 190, 5)),
    heard(mav.MAVLink_mission_current_message(3)), heard(mav.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3))],
    ids=str.split("other-type other-vehicle other-component early-ack beyond-the-plan current heartbeat"))
def test_what_belongs_to_another_transfer_changes_nothing(stray: Any) -> None:
    transfer = Upload(plan(5), VEHICLE)
    transfer.poll(0.0)
    assert transfer.receive(stray, 0.1) == []
    assert (transfer.outcome, transfer.progress) == ("under way", 0.0)


def test_what_ardupilot_gives_back_is_recognised_and_a_changed_plan_is_not() -> None:
    sent = [item_from_params(0, 16, (0, 0, 0, 0, 52, 6, 40), "home"), *plan(3),
            item_from_params(2, 178, (1, 3.3, None, 0, 0, 0, 0), "speed")]
    _, first, second, third, _ = sent
    kept = [item_from_params(0, 16, (0, 0, 0, 0, 52, 6, 38.7), "home"),
            *(Item(3, i.command, (i.params[0], 0.0, 0.0, 0.0), i.x, i.y, i.z - 0.0099) for i in (first, second, third)),
            Item(0, 178, (1.0, 3.3, 0.0, 0.0), 0, 0, 0.0)]
    assert as_ardupilot_keeps(sent, kept)
    for wrong in ([*kept[:2], replace(kept[2], x=second.x + 1), *kept[3:]], [*kept[:2], kept[3], kept[2], kept[4]],
                  [*kept[:2], replace(kept[2], z=second.z + 0.03), *kept[3:]], kept[:-1], [*kept, kept[-1]],
                  [*kept[:4], replace(kept[4], command=16)], [*kept[:2], replace(kept[2], frame=0), *kept[3:]]):
        assert not as_ardupilot_keeps(sent, wrong)
