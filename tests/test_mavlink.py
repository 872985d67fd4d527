"""Routes through real MAVLink frames and back; plan identity."""

import math

from hypothesis import given
from hypothesis import strategies as st

from missions.frames import Site, wrap_pi
from missions.mavlink import (
    Endpoint,
    Route,
    Waypoint,
    item_from_message,
    item_message,
    items_from_route,
    plan_sha256,
    route_from_items,
)

SITE = Site(52.2205, 6.8861, 40.0)
points = st.builds(
    Waypoint, position_enu_m=st.tuples(st.floats(-200, 200), st.floats(-200, 200), st.floats(0, 120)),
    yaw_enu_rad=st.floats(-math.pi, 3.14), gimbal_elevation_rad=st.floats(-1.5, 1.5),
    view_id=st.none() | st.integers(0, 2**24), stop=st.booleans(), settle_s=st.sampled_from([0.0, 0.5, 2.0]))
routes = st.builds(Route, plan_id=st.integers(1, 1000), phase=st.sampled_from(["explore", "survey"]),
                   waypoints=st.lists(points, min_size=1, max_size=8), home_after=st.booleans())


def over_the_wire(items):
    sender, receiver = Endpoint(255, 190), Endpoint(1, 1)
    frames = [sender.pack(item_message(item, seq, 1, 1)) for seq, item in enumerate(items)]
    return [item_from_message(m) for m in receiver.parse(frames)]


@given(routes)
def test_a_route_survives_the_wire_bit_for_bit(route):
    items = items_from_route(route, SITE)
    assert plan_sha256(over_the_wire(items)) == plan_sha256(items)


@given(routes)
def test_a_route_survives_within_the_resolution_of_degrees(route):
    back = route_from_items(over_the_wire(items_from_route(route, SITE)), SITE, route.plan_id)
    assert (back.phase, back.home_after, len(back.waypoints)) == (route.phase, route.home_after, len(route.waypoints))
    for a, b in zip(route.waypoints, back.waypoints, strict=True):
        assert math.dist(a.position_enu_m, b.position_enu_m) < 0.012
        assert abs(wrap_pi(a.yaw_enu_rad - b.yaw_enu_rad)) < 1e-5
        assert (a.view_id, a.stop) == (b.view_id, b.stop)
        assert abs(a.gimbal_elevation_rad - b.gimbal_elevation_rad) < 1e-6
        if a.stop:
            assert a.settle_s == b.settle_s


@given(routes, st.integers(0, 7), st.integers(1, 5))
def test_another_plan_has_another_hash(route, index, metres):
    w = route.waypoints[index % len(route.waypoints)]
    e, n, u = w.position_enu_m
    import msgspec

    moved = msgspec.structs.replace(w, position_enu_m=(e + metres, n, u))
    other = msgspec.structs.replace(route, waypoints=[moved if x is w else x for x in route.waypoints])
    assert plan_sha256(items_from_route(other, SITE)) != plan_sha256(items_from_route(route, SITE))


@given(st.binary(max_size=300))
def test_garbage_yields_no_message(noise):
    assert all(m.get_type() != "MISSION_ITEM_INT" for m in Endpoint(1, 1).parse([noise]))
