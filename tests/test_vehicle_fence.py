"""A vehicle takes a wider fence on board where the mission allows it, and flies only where it is known to be free."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missions import topics
from missions.messages import FenceOrder, FenceVerdict, Vector, vector
from missions.mission import FleetSpec, Mission, SiteSpec
from missions.pads import fence_limit, geofence, hover_points
from tests.vehicle_world import SITE, World, open_map

MISSION = Mission(title="t", fleet=FleetSpec(vehicles=1), site=SiteSpec(geofence_room_m=6.0))
LOWER, UPPER = geofence(MISSION, SITE)
LEAST, MOST = fence_limit(MISSION, SITE)


@pytest.fixture
def world(tmp_path: Path) -> World:
    made = World(MISSION, tmp_path)
    made.run(0.5)
    return made


def ask(world: World, lower: Vector, upper: Vector) -> FenceVerdict:
    """The vehicle's answer to an order."""
    vehicle = world.vehicles[1]
    world.send(1, topics.FENCE_ORDER, FenceOrder(order_id=7, lower_enu_m=lower, upper_enu_m=upper))
    before = len(world.fence_verdicts)
    world.run(1.0)
    (verdict,) = world.fence_verdicts[before:]
    assert verdict.order_id == 7
    assert vehicle.lookout.fence is vehicle.judge.fence
    return verdict


def test_a_wider_fence_is_accepted_up_to_what_the_mission_allows(world: World) -> None:
    judge = world.vehicles[1].judge
    beyond = ask(world, vector(LOWER), vector(MOST + 1.0))
    assert (beyond.accepted, "beyond what the mission allows" in beyond.reason) == (False, True)
    narrower = ask(world, vector(LOWER + np.array([1.0, 0.0, 0.0])), vector(UPPER))
    assert (narrower.accepted, "only be widened" in narrower.reason) == (False, True)
    assert np.array_equal(judge.fence.upper_enu_m, UPPER)
    assert ask(world, vector(LEAST), vector(MOST)).accepted
    assert np.allclose(judge.fence.upper_enu_m, MOST)
    assert not ask(world, (float("nan"), 0.0, 0.0), vector(MOST)).accepted


def test_what_the_wider_fence_adds_is_unknown_and_is_not_flown_to(world: World) -> None:
    judge = world.vehicles[1].judge
    x, y, _ = hover_points(MISSION, SITE)[0]
    beyond = np.array([x, y, UPPER[2] + 2.0])
    assert judge.why_not_there(beyond) == "it lies outside the geofence"
    assert ask(world, vector(LEAST), vector(MOST)).accepted
    assert "not known to be free" in judge.why_not_there(beyond)
    world.share_map(open_map(MISSION))
    world.run(1.0)
    assert judge.why_not_there(beyond) == ""
