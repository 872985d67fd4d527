"""The geofence: how far inside a place is, where a vehicle comes to rest, and ways that never leave it."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from missions.frames import Array
from missions.grid import FREE, VoxelGrid
from planning.paths import NoPath, VoxelField, plan_path
from planning.trajectories import Curve, Limits, State, Via, brake, fly_run
from vehicle.fenced_field import FencedField
from vehicle.geofence import FENCE_TOLERANCE_M, Circle, Geofence, stopping_distance_m

LIMITS = Limits(3.0, 2.0, 6.0)
BOX = np.array([-30.0, -30.0, 0.0]), np.array([30.0, 30.0, 30.0])
places = arrays(np.float64, 3, elements=st.floats(-35.0, 35.0))
inside = st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0), st.floats(2.0, 20.0)).map(np.array)


@st.composite
def polygons(draw: st.DrawFn) -> Array:
    """(n, 2) star-shaped, so that it does not cross itself."""
    n = draw(st.integers(3, 8))
    middle = draw(arrays(np.float64, 2, elements=st.floats(-15.0, 15.0)))
    radius = np.array(draw(st.lists(st.floats(2.0, 25.0), min_size=n, max_size=n)))
    turn = np.sort(np.array(draw(st.lists(st.floats(0.0, 2.0 * math.pi - 0.1), min_size=n, max_size=n, unique=True))))
    assume(np.diff(turn, append=turn[0] + 2.0 * math.pi).max() < math.pi)
    assume(np.diff(turn).min() > 0.01)
    return np.asarray(middle + radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]))


circles = st.builds(lambda x, y, r: Circle(np.array([x, y]), r), st.floats(-20.0, 20.0), st.floats(-20.0, 20.0),
                    st.floats(2.0, 25.0))
zones = st.lists(st.one_of(polygons(), circles), max_size=2).map(tuple)
fences = st.builds(lambda a, b: Geofence(*BOX, stay_in=a, stay_out=b), zones, zones)


def in_zone(zone: Array | Circle, p: Array) -> bool:
    """By the angles under which a point sees the corners: all around, if it is inside."""
    if isinstance(zone, Circle):
        return math.dist(zone.center_enu_m, p) < zone.radius_m
    angles = [math.atan2(y - p[1], x - p[0]) for x, y in [*zone.tolist(), zone[0].tolist()]]
    turned = sum(math.remainder(b - a, 2.0 * math.pi) for a, b in itertools.pairwise(angles))
    return abs(turned) > math.pi


def allowed(fence: Geofence, p: Array) -> bool:
    return bool(np.all(p > fence.lower_enu_m) and np.all(p < fence.upper_enu_m)) \
        and (not fence.stay_in or any(in_zone(z, p[:2]) for z in fence.stay_in)) \
        and not any(in_zone(z, p[:2]) for z in fence.stay_out)


@given(fences, places)
def test_room_is_positive_inside_and_negative_outside(fence: Geofence, place: Array) -> None:
    room = float(fence.room_m(place)[0])
    assume(abs(room) > 1e-6)
    assert (room > 0.0) is allowed(fence, place)


@given(fences, inside, st.floats(0.0, 2.0 * math.pi), st.floats(-1.5, 1.5))
def test_room_is_never_more_than_the_way_to_the_border(fence: Geofence, place: Array, turn: float, lift: float) -> None:
    room = float(fence.room_m(place)[0])
    direction = np.array([math.cos(turn) * math.cos(lift), math.sin(turn) * math.cos(lift), math.sin(lift)])
    if room > 1e-3:
        assert allowed(fence, place + 0.999 * room * direction)


def test_what_is_no_position_is_outside() -> None:
    assert Geofence(*BOX).room_m(np.array([[0.0, np.nan, 5.0], [np.inf, 0.0, 5.0]])).tolist() == [-np.inf, -np.inf]


@given(st.floats(0.0, 12.0), st.floats(-1.0, 1.0), st.floats(0.5, 12.0), st.floats(0.5, 8.0), st.floats(1.0, 30.0))
def test_no_vehicle_needs_more_than_the_stopping_distance(speed: float, push: float, top: float, acceleration: float,
                                                         jerk: float) -> None:
    limits = Limits(max(top, speed) + 1.0 + acceleration**2 / jerk, acceleration, jerk)
    assume(speed > 1e-3)
    direction = np.array([0.6, 0.0, 0.8])
    stop = brake(State(np.zeros(3), speed * direction, push * acceleration * direction), limits)
    assert np.linalg.norm(stop.sample(0.02)[1], axis=1).max() <= stopping_distance_m(speed, limits) + 1e-6


@settings(max_examples=60)
@given(inside, st.lists(inside, min_size=1, max_size=4), fences, st.floats(0.05, 1.0), st.floats(0.0, 1.0))
def test_who_brakes_when_told_stays_inside_whenever_it_looks(start: Array, goals: list[Array], fence: Geofence,
                                                            look_s: float, margin_m: float) -> None:
    assume(fence.room_m(start)[0] >= margin_m)
    vias = [Via(g, 0.0, pass_m=0.25, stop=n == len(goals) - 1) for n, g in enumerate(goals)]
    flight = fly_run(State.at_rest(start), 0.0, 0.0, vias, LIMITS)
    t_s = 0.0
    while t_s < flight.duration_s and (t_s == 0.0 or fence.stops_inside(flight, t_s + look_s, margin_m)):
        t_s += look_s
    # at the start it rests: the first look comes before it moves
    if t_s <= look_s and not fence.stops_inside(flight, look_s, margin_m):
        return
    flown = Curve.chain([flight.curve.part(0.0, min(t_s, flight.duration_s)), flight.stop(t_s).curve])
    assert fence.room_m(flown.sample(0.02)[1]).min() >= margin_m - 0.06


@settings(max_examples=60)
@given(inside, arrays(np.float64, 3, elements=st.floats(-4.0, 4.0)), fences, st.floats(0.05, 0.5))
def test_a_drifting_vehicle_is_told_before_it_is_too_late(place: Array, velocity: Array, fence: Geofence,
                                                         look_s: float) -> None:
    assume(np.linalg.norm(velocity) > 0.01)
    if fence.holds_drift(place, velocity, LIMITS, look_s, 0.0):
        there = place + look_s * velocity
        stop = brake(State(there, velocity, np.zeros(3)), LIMITS)
        assert fence.room_m(np.concatenate([np.linspace(place, there, 50), stop.sample(0.05)[1]])).min() >= -0.06


def open_field() -> VoxelField:
    grid = VoxelGrid.unknown(np.array([-12.0, -12.0, 0.0]), np.array([12.0, 12.0, 8.0]), 0.5)
    grid.state[:] = FREE
    return VoxelField.from_grid(grid)


FIELD = open_field()
near = st.tuples(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(2.0, 6.0)).map(np.array)


@settings(max_examples=40)
@given(near, near, st.one_of(polygons(), circles))
def test_ways_in_a_fenced_field_stay_inside(start: Array, goal: Array, zone: Array | Circle) -> None:
    fence = Geofence(*BOX, stay_out=(zone,))
    field = FencedField(FIELD, fence, 1.0)
    try:
        way = plan_path(field, start, goal, 1.0, np.full(3, -11.0), np.full(3, 11.0))
    except NoPath:
        return
    for a, b in itertools.pairwise(way):
        assert fence.room_m(np.linspace(a, b, 500)).min() >= -FENCE_TOLERANCE_M - 1e-9


def test_a_way_around_a_zone_is_found() -> None:
    fence = Geofence(*BOX, stay_out=(Circle(np.zeros(2), 4.0),))
    way = plan_path(FencedField(FIELD, fence, 1.0), np.array([-8.0, 0.0, 4.0]), np.array([8.0, 0.0, 4.0]), 1.0,
                    np.full(3, -11.0), np.full(3, 11.0))
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    assert 17.5 < length < 20.5


@pytest.mark.parametrize("spare_m", [0.5, 1.0])
def test_the_fenced_lattice_is_never_more_than_true(spare_m: float) -> None:
    fence = Geofence(*BOX, stay_in=(np.array([[-9.0, -9.0], [9.0, -6.0], [7.0, 9.0], [-8.0, 8.0]]),))
    field = FencedField(FIELD, fence, spare_m)
    at = np.stack(np.indices(field.distance.shape), axis=-1).reshape(-1, 3)
    points = field.origin + at * field.voxel_m
    true = np.minimum(FIELD.distance.ravel(), np.maximum(0.0, fence.room_m(points) + spare_m))
    assert np.all(field.distance.ravel() <= true + 1e-5)
