"""Our verified upload against autopilots that ask, refuse, keep and give back as the two real ones were seen to do."""

from __future__ import annotations

import random

import pytest
from pymavlink.dialects.v20 import common as mav

from missions.frames import Site
from missions.mavlink import GROUND_COMPONENT, GROUND_SYSTEM, Endpoint, Item, items_from_route
from missions.mission_transfer import VerifiedUpload, as_ardupilot_keeps
from tests.autopilot_stub import AutopilotStub
from tests.vehicle_world import route

SITE = Site(52.2205, 6.8861, 40.0)
HOME = Item(mav.MAV_FRAME_GLOBAL, mav.MAV_CMD_NAV_WAYPOINT, (0.0, 0.0, 0.0, 0.0), 522205000, 68861000, 40.0)
TAKEOFF = Item(mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, mav.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, 0.0), 0, 0, 3.0)


def plan(kind: str) -> list[Item]:
    """A tour of five pictures, as this autopilot wants it."""
    items = items_from_route(route([(2.0 * n, -9.0, 4.0) for n in range(5)], home_after=True), SITE)
    return items if kind == "px4" else [HOME, TAKEOFF, *items]


def deliver(stub: AutopilotStub, items: list[Item], loss: float, seconds: float = 60.0) -> VerifiedUpload:
    """Upload to the stub over a link that loses this share of the frames both ways."""
    holds = None if stub.px4 else as_ardupilot_keeps
    upload, ground, dice = VerifiedUpload(items, 1, seconds, holds=holds), Endpoint(GROUND_SYSTEM, GROUND_COMPONENT), \
        random.Random(7)
    t = 0.0
    while not upload.over:
        t += 0.02
        answers = upload.poll(t)
        for message in ground.parse([f for f in stub.step(t) if dice.random() >= loss]):
            answers += upload.receive(message, t)
        for answer in answers:
            if dice.random() >= loss:
                stub.receive(ground.pack(answer))
    return upload


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_a_plan_gets_there_and_is_proven_by_reading_it_back(kind: str, loss: float) -> None:
    stub = AutopilotStub(kind)
    upload = deliver(stub, plan(kind), loss)
    assert upload.outcome == "done", upload.reason
    assert [m.command for m in stub.missions.items] == [i.command for i in plan(kind)]
    assert stub.missions.total == len(plan(kind)) - (kind == "ardupilot")
    assert stub.missions.startable == ""


def test_each_refuses_what_it_was_seen_to_refuse() -> None:
    swapped = Item(5, mav.MAV_CMD_NAV_WAYPOINT, (0.0, 0.0, 0.0, 0.0), 95 * 10**7, 0, 40.0)
    assert deliver(AutopilotStub("ardupilot"), [HOME, TAKEOFF, swapped], 0.0).outcome == "refused"
    assert deliver(AutopilotStub("px4"), [swapped], 0.0).outcome == "done"
    copter = AutopilotStub("ardupilot")
    deliver(copter, [HOME, *plan("px4")], 0.0)
    assert copter.missions.startable == "Missing Takeoff Cmd"
    assert AutopilotStub("px4").missions.total == 65535
