"""Plans that are sent keep clear of what is under way by waiting, or are known not to."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ground_station.traffic import REST_S, UPLOAD_S, Traffic, holding
from missions.mavlink import Waypoint
from missions.messages import VehicleState
from missions.mission import Mission

MISSION = Mission(title="t")
SEPARATION_M = MISSION.fleet.separation_m
Point = tuple[float, float, float]
points = st.tuples(st.floats(-12, 12), st.floats(-12, 12), st.floats(3, 9))


def at(vehicle_id: int, place: Point) -> VehicleState:
    return VehicleState(vehicle_id=vehicle_id, t_ns=0, position_enu_m=place, velocity_enu_m_s=(0.0, 0.0, 0.0),
                        acceleration_enu_m_s2=(0.0, 0.0, 0.0), yaw_enu_rad=0.0, gimbal_elevation_rad=0.0,
                        battery_percent=100.0, flying=True, mode="hold")


def over(*places: Point) -> list[Waypoint]:
    return [Waypoint(position_enu_m=p, yaw_enu_rad=0.0, stop=p == places[-1], pass_m=0.25) for p in places]


def least_m(traffic: Traffic, t_s: float) -> float:
    """Between vehicles 1 and 2 from now on."""
    a, b = (traffic._ahead(k, t_s) for k in (1, 2))
    known = min(len(a), len(b))
    return float(np.linalg.norm(a[:known] - b[:known], axis=1).min())


@settings(max_examples=60, deadline=None)
@given(st.lists(points, min_size=3, max_size=6), st.lists(points, min_size=3, max_size=6), st.floats(0.0, 15.0))
def test_a_plan_keeps_clear_of_what_is_under_way_or_is_known_not_to(a: list[Point], b: list[Point],
                                                                    late_s: float) -> None:
    traffic = Traffic(MISSION)
    first, second = at(1, a[0]), at(2, b[0])
    traffic.flies(first, over(*a[1:]), 0.0)
    hold_s = traffic.hold_s(second, over(*b[1:]), late_s, [1], [], [])
    if hold_s is not None:
        traffic.flies(second, [holding(second, hold_s), *over(*b[1:])], late_s)
        assert least_m(traffic, late_s) >= SEPARATION_M
    else:
        other, mine = traffic._ahead(1, late_s), traffic._predicted(second, over(*b[1:]))
        assert min(np.linalg.norm(other - mine[0], axis=1).min(), np.linalg.norm(mine - other[-1], axis=1).min(),
                   np.linalg.norm(other - mine[-1], axis=1).min()) < SEPARATION_M + 1.0


def test_crossing_plans_wait_no_longer_than_needed() -> None:
    traffic = Traffic(MISSION)
    east, north = at(1, (-12.0, 0.0, 5.0)), at(2, (0.0, -12.0, 5.0))
    traffic.flies(east, over((12.0, 0.0, 5.0)), 0.0)
    hold_s = traffic.hold_s(north, over((0.0, 12.0, 5.0)), 0.0, [1], [], [])
    assert hold_s is not None
    assert 0.0 < hold_s < 5.0
    assert traffic.hold_s(north, over((0.0, 12.0, 9.0)), 0.0, [], [], []) == 0.0
    traffic.flies(north, [holding(north, hold_s), *over((0.0, 12.0, 5.0))], 0.0)
    assert least_m(traffic, 0.0) >= SEPARATION_M
    assert np.allclose(traffic._ahead(2, hold_s + UPLOAD_S - 0.2)[0], (0.0, -12.0, 5.0), atol=0.02)


def test_who_rests_in_the_way_is_waited_for_unless_nobody_goes_on_there() -> None:
    traffic, me = Traffic(MISSION), at(2, (0.0, -12.0, 5.0))
    there = [np.array([0.0, 3.0, 5.0])]
    assert traffic.hold_s(me, over((0.0, 12.0, 5.0)), 0.0, [], [], there) is None
    assert traffic.hold_s(me, over((0.0, -1.0, 5.0)), 0.0, [], [], there) == 0.0
    patience_s = traffic.hold_s(me, over((0.0, 12.0, 5.0)), 0.0, [], there, [])
    assert patience_s is not None
    assert 0.0 < patience_s <= REST_S
