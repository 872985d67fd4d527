"""The vehicle's side of the mission protocol under loss, repetition, reordering and malice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from missions.frames import Site
from missions.mavlink import (
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    Endpoint,
    Item,
    item_message,
    items_from_route,
    plan_sha256,
)
from tests.vehicle_world import NS, route
from vehicle.autopilot.craft import FENCE, MISSION, RALLY, Shelf
from vehicle.autopilot.mission_service import (
    GIVE_UP_AFTER,
    MAX_ITEMS,
    REQUEST_AGAIN_NS,
    WINDOW,
    Accept,
    MissionService,
    TransferStyle,
)

SITE = Site(52.0, 6.0, 40.0)
ITEMS = items_from_route(route([(float(n), 0.0, 5.0) for n in range(20)]), SITE)
TICK = 100_000_000


class Plans(MissionService):
    """The service with shelves of its own."""

    def __init__(self, accept: Accept = lambda kind, items: mav.MAV_MISSION_ACCEPTED, window: int = WINDOW,
                 home: Item | None = None) -> None:
        self.shelves = {kind: Shelf() for kind in (MISSION, FENCE, RALLY)}
        self.jumps: list[int] = []
        style = TransferStyle(window, home=None if home is None else lambda: home)
        super().__init__(self.shelves, accept, self.jumps.append, style)

    @property
    def items(self) -> list[Item]:
        """The accepted flight plan."""
        return self.shelves[MISSION].items


def same(a: list[Item], b: list[Item]) -> bool:
    """Equal plans; NaN equals NaN."""
    return plan_sha256(a) == plan_sha256(b)


def sent(message: mav.MAVLink_message, system: int = GROUND_SYSTEM, component: int = GROUND_COMPONENT) -> Any:
    """The message as it arrives from this sender."""
    return Endpoint(1, 1).parse([Endpoint(system, component).pack(message)])[0]


def count(n: int) -> Any:
    return mav.MAVLink_mission_count_message(1, 1, n)


def item(seq: int, items: list[Item] = ITEMS) -> Any:
    return item_message(items[seq], seq, 1, 1)


def types(answers: list[mav.MAVLink_message] | None) -> list[str]:
    return [a.get_type() for a in answers or []]


def upload(service: Plans, items: list[Item], rng: np.random.Generator | None = None, loss: float = 0.0,
           repeat: float = 0.0) -> list[int]:
    """A whole upload over a bad link; the results acknowledged."""
    results: list[int] = []
    to_vehicle: list[Any] = [count(len(items))]
    for tick in range(3000):
        t_ns = tick * TICK
        if tick % 10 == 9 and not results:
            to_vehicle.append(count(len(items)))
        arriving = [m for m in to_vehicle for _ in range(1 + (rng is not None and rng.random() < repeat))
                    if rng is None or rng.random() >= loss]
        if rng is not None:
            rng.shuffle(arriving)
        answers = [a for m in arriving for a in service.handle(sent(m), t_ns) or []] + service.poll(t_ns)
        to_vehicle = [item(a.seq, items) for a in answers if a.get_type() == "MISSION_REQUEST_INT"]
        results += [a.type for a in answers if a.get_type() == "MISSION_ACK"]
        if results:
            return results
    return results


def test_a_clean_upload_takes_one_window_per_round() -> None:
    service = Plans()
    requests = service.handle(sent(count(len(ITEMS))), 0)
    assert types(requests) == ["MISSION_REQUEST_INT"] * WINDOW
    assert upload(service, ITEMS) == [mav.MAV_MISSION_ACCEPTED]
    assert same(service.items, ITEMS)


def test_a_foreign_ground_station_gets_one_request_at_a_time() -> None:
    service = Plans(window=1)
    answers = service.handle(sent(count(3), 245, 190), 0)
    for seq in range(3):
        assert answers is not None
        assert [(a.target_system, a.target_component, a.seq) for a in answers] == [(245, 190, seq)]
        answers = service.handle(sent(item(seq), 245, 190), 0)
    assert types(answers) == ["MISSION_ACK"]
    assert same(service.items, ITEMS[:3])


@given(st.integers(0, 2**31), st.floats(0.0, 0.4), st.floats(0.0, 0.5))
@settings(max_examples=15, deadline=None)
def test_uploads_get_through_a_bad_link_unharmed(seed: int, loss: float, repeat: float) -> None:
    judged: list[list[Item]] = []
    service = Plans(lambda kind, items: judged.append(items) or mav.MAV_MISSION_ACCEPTED)
    results = upload(service, ITEMS, np.random.default_rng(seed), loss, repeat)
    assert results
    assert set(results) == {mav.MAV_MISSION_ACCEPTED}
    assert same(service.items, ITEMS)
    assert all(same(items, ITEMS) for items in judged)


def test_a_broken_or_refused_upload_leaves_the_old_plan() -> None:
    verdict = [mav.MAV_MISSION_ACCEPTED]
    service = Plans(lambda kind, items: verdict[0])
    upload(service, ITEMS[:5])
    service.handle(sent(count(8)), 0)
    service.handle(sent(item(0)), 0)
    t, cancelled = 0, False
    for _ in range(GIVE_UP_AFTER + 1):
        t += REQUEST_AGAIN_NS
        cancelled |= any(a.get_type() == "MISSION_ACK" and a.type == mav.MAV_MISSION_OPERATION_CANCELLED
                         for a in service.poll(t))
    assert cancelled
    assert same(service.items, ITEMS[:5])
    assert service.poll(t + NS) == []
    verdict[0] = mav.MAV_MISSION_DENIED
    assert upload(service, ITEMS[:7]) == [mav.MAV_MISSION_DENIED]
    assert same(service.items, ITEMS[:5])


def test_missing_items_are_asked_for_again_after_a_quarter_second() -> None:
    service = Plans()
    service.handle(sent(count(3)), 0)
    assert service.poll(REQUEST_AGAIN_NS - 1) == []
    assert [a.seq for a in service.poll(REQUEST_AGAIN_NS)] == [0, 1, 2]
    assert service.handle(sent(item(1)), REQUEST_AGAIN_NS) == []
    assert service.handle(sent(item(1)), REQUEST_AGAIN_NS) == []
    assert [a.seq for a in service.poll(2 * REQUEST_AGAIN_NS)] == [0, 2]


def test_a_repeated_last_item_is_acknowledged_again() -> None:
    service = Plans()
    upload(service, ITEMS[:4])
    again = service.handle(sent(item(3)), 0)
    assert types(again) == ["MISSION_ACK"]
    assert again is not None
    assert again[0].type == mav.MAV_MISSION_ACCEPTED
    assert service.handle(sent(item(1)), 0) == []


def test_download_returns_what_was_uploaded() -> None:
    service = Plans()
    upload(service, ITEMS)
    listed = service.handle(sent(mav.MAVLink_mission_request_list_message(1, 1)), 0)
    assert listed is not None
    assert listed[0].count == len(ITEMS)
    for seq, wanted in enumerate(ITEMS):
        answer = service.handle(sent(mav.MAVLink_mission_request_int_message(1, 1, seq)), 0)
        assert answer is not None
        got = sent(answer[0])
        assert (got.seq, got.command, got.x, got.y) == (seq, wanted.command, wanted.x, wanted.y)
        np.testing.assert_equal((got.param1, got.param2, got.param3, got.param4, got.z), (*wanted.params, wanted.z))


@pytest.mark.parametrize(("message", "result"), [
    (count(MAX_ITEMS + 1), mav.MAV_MISSION_NO_SPACE),
    (mav.MAVLink_mission_request_int_message(1, 1, 77), mav.MAV_MISSION_INVALID_SEQUENCE),
    (mav.MAVLink_mission_set_current_message(1, 1, 77), mav.MAV_MISSION_INVALID_SEQUENCE),
    (mav.MAVLink_mission_count_message(1, 1, 3, 7), mav.MAV_MISSION_UNSUPPORTED)])
def test_what_cannot_be_is_refused_at_once(message: Any, result: int) -> None:
    service = Plans()
    answers = service.handle(sent(message), 0)
    assert answers is not None
    assert [(a.get_type(), a.type) for a in answers] == [("MISSION_ACK", result)]
    assert service.items == []
    assert service.poll(10 * NS) == []


def test_clear_and_set_current() -> None:
    service = Plans()
    upload(service, ITEMS)
    current = service.handle(sent(mav.MAVLink_mission_set_current_message(1, 1, 9)), 0)
    assert types(current) == ["MISSION_CURRENT"]
    assert service.shelves[MISSION].current == 9
    assert service.jumps == [9]
    assert types(service.handle(sent(mav.MAVLink_mission_clear_all_message(1, 1)), 0)) == ["MISSION_ACK"]
    assert service.items == []
    assert service.shelves[MISSION].current == 0


@pytest.mark.parametrize("kind", [FENCE, RALLY])
def test_fence_and_rally_points_are_lists_of_their_own(kind: int) -> None:
    service = Plans(window=1)
    upload(service, ITEMS[:4])
    answers = service.handle(sent(mav.MAVLink_mission_count_message(1, 1, 2, kind)), 0)
    for seq in range(2):
        assert answers is not None
        assert [(a.seq, a.mission_type) for a in answers] == [(seq, kind)]
        assert service.handle(sent(item_message(ITEMS[seq], seq, 1, 1)), 0) == []  # of the flight plan: not this list
        answers = service.handle(sent(item_message(ITEMS[seq], seq, 1, 1, kind)), 0)
    assert answers is not None
    assert [(a.type, a.mission_type) for a in answers] == [(mav.MAV_MISSION_ACCEPTED, kind)]
    assert same(service.shelves[kind].items, ITEMS[:2])
    assert same(service.items, ITEMS[:4])
    service.handle(sent(mav.MAVLink_mission_clear_all_message(1, 1, mav.MAV_MISSION_TYPE_ALL)), 0)
    assert all(not shelf.items for shelf in service.shelves.values())


def test_where_item_zero_is_home_it_is_shown_but_not_flown() -> None:
    home = ITEMS[7]
    service = Plans(window=1, home=home)
    assert upload(service, [ITEMS[3], *ITEMS[:4]]) == [mav.MAV_MISSION_ACCEPTED]
    assert same(service.items, ITEMS[:4])
    listed = service.handle(sent(mav.MAVLink_mission_request_list_message(1, 1)), 0)
    assert listed is not None
    assert listed[0].count == 5
    answers = [service.handle(sent(mav.MAVLink_mission_request_int_message(1, 1, seq)), 0) for seq in (0, 1)]
    shown = [a[0] for a in answers if a]
    assert [(m.x, m.y) for m in shown] == [(home.x, home.y), (ITEMS[0].x, ITEMS[0].y)]
    assert service.shown_seq(0) == 1
    service.handle(sent(mav.MAVLink_mission_set_current_message(1, 1, 3)), 0)
    assert service.jumps == [2]


def test_somebody_else_cannot_break_into_an_upload() -> None:
    service = Plans(window=1)
    service.handle(sent(count(3), 245, 190), 0)
    refused = service.handle(sent(count(2), 255, 230), 0)
    assert refused is not None
    assert [(a.get_type(), a.type, a.target_system) for a in refused] == [("MISSION_ACK", mav.MAV_MISSION_DENIED, 255)]
    assert [a.seq for a in service.handle(sent(item(0), 245, 190), 0) or []] == [1]


@pytest.mark.parametrize(("pause_ns", "asked"), [(NS // 2, 2), (NS, 0)])
def test_a_count_that_is_repeated_resumes_and_one_after_a_pause_begins_anew(pause_ns: int, asked: int) -> None:
    """A client that starts again may come with another plan of the same length, which is not to be mixed in."""
    service = Plans(window=1)
    for message in (count(4), item(0), item(1)):
        service.handle(sent(message), 0)
    answers = service.handle(sent(count(4)), pause_ns)
    assert answers is not None
    assert [a.seq for a in answers] == [asked]
    for seq in range(asked, 4):
        service.handle(sent(item(seq, ITEMS[4:] if asked == 0 else ITEMS)), pause_ns)
    assert same(service.items, ITEMS[4:8] if asked == 0 else ITEMS[:4])
