"""The referee's verdicts on paths whose distances are known in closed form."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.clock import SECOND_NS
from missions.frames import Array
from missions.messages import VehicleState
from missions.mission import FleetSpec
from missions.simulation import ObstacleSpec
from sim_bridge.referee import Referee, quintic
from sim_bridge.truth import Truth
from sim_bridge.world import resting

HALF = np.array([2.0, 3.0, 4.0])
CENTER = np.array([0.0, 0.0, 10.0])
GROUND = trimesh.creation.box(extents=(400.0, 400.0, 200.0)).apply_translation((0.0, 0.0, -100.0))
BOX = trimesh.creation.box(extents=2 * HALF).apply_translation(CENTER)
SCENE = trimesh.util.concatenate([BOX, GROUND])
FAR_PAD = (100.0, 100.0, 0.2)
FLEET = FleetSpec()


def truth(obstacles: Iterable[ObstacleSpec] = ()) -> Truth:
    return Truth(np.asarray(SCENE.vertices), np.asarray(SCENE.faces, dtype=np.int32), list(obstacles))


def state(t_s: float, position: Array, velocity: Array, vehicle_id: int = 1, flying: bool = True,
          acceleration: Array | None = None) -> VehicleState:
    a = np.zeros(3) if acceleration is None else acceleration
    return VehicleState(vehicle_id=vehicle_id, t_ns=round(t_s * SECOND_NS), position_enu_m=tuple(position.tolist()),
                        velocity_enu_m_s=tuple(velocity.tolist()), acceleration_enu_m_s2=tuple(a.tolist()),
                        yaw_enu_rad=0.0, gimbal_elevation_rad=0.0, battery_percent=80.0, flying=flying, mode="auto")


def parked(vehicle_id: int = 1, pad: tuple[float, float, float] = FAR_PAD) -> VehicleState:
    return state(0.0, np.array(pad), np.zeros(3), vehicle_id, flying=False)


def straight(start: Array, end: Array, speed: float = 3.0, t0_s: float = 0.1, vehicle_id: int = 1,
             step_s: float = 0.1) -> list[VehicleState]:
    """States of a straight flight at constant speed; the last one is exactly at the end."""
    length = float(np.linalg.norm(end - start))
    velocity = (end - start) / length * speed
    times = np.append(np.arange(0.0, length / speed, step_s), length / speed)
    return [state(t0_s + float(t), start + velocity * t, velocity, vehicle_id) for t in times]


def judge(states: Iterable[VehicleState], world: Truth | None = None) -> Referee:
    referee = Referee(world or truth(), FLEET)
    for s in states:
        referee.see(s)
    referee.finish()
    return referee


def box_distance(points: Array) -> Array:
    outside: Array = np.linalg.norm(np.maximum(np.abs(points - CENTER) - HALF, 0.0), axis=-1)
    return outside


@given(st.floats(0.4, 4.0), st.floats(0.0, 2 * math.pi), st.floats(0.5, 10.0))
@settings(max_examples=40, deadline=None)
def test_a_straight_pass_has_the_clearance_of_its_nearest_point(beside_m: float, heading: float, speed: float) -> None:
    along = np.array([math.cos(heading), math.sin(heading), 0.0])
    across = np.array([-math.sin(heading), math.cos(heading), 0.0])
    middle = CENTER + across * (np.abs(across) @ HALF + beside_m)
    start, end = middle - 12.0 * along, middle + 12.0 * along
    dense = box_distance(start + (end - start) * np.linspace(0.0, 1.0, 20001)[:, None])
    referee = judge([parked(), *straight(start, end, speed)])
    assert referee.min_clearance_m == pytest.approx(dense.min(), abs=0.01)
    assert referee.collision_events == []
    assert referee.min_separation_m == math.inf


@given(st.floats(-1.5, 1.5), st.floats(-3.5, 3.5), st.floats(0.5, 8.0))
@settings(max_examples=25, deadline=None)
def test_a_pass_through_the_box_is_one_collision(x: float, dz: float, speed: float) -> None:
    middle = CENTER + np.array([x, 0.0, dz])
    half_way = np.array([0.0, 20.0, 0.0])
    referee = judge([parked(), *straight(middle - half_way, middle + half_way, speed)])
    assert len(referee.collision_events) == 1
    event = referee.collision_events[0]
    assert event["with"] == "scene"
    contact = middle - np.array([0.0, 3.0 + FLEET.radius_m, 0.0])
    assert event["position_enu_m"] == pytest.approx(tuple(contact), abs=max(0.05, 0.02 * speed) + 0.001)
    assert event["t_s"] == pytest.approx(0.1 + (20.0 - 3.0 - FLEET.radius_m) / speed, abs=0.021)


def test_two_passes_are_two_collisions_even_across_batches() -> None:
    there, back = np.array([0.0, -30.0, 10.0]), np.array([0.0, 30.0, 10.0])
    first = straight(there, back)
    second = straight(back, there, t0_s=first[-1].t_ns / SECOND_NS)
    referee = judge([parked(), *first, *second[1:]])
    assert [e["with"] for e in referee.collision_events] == ["scene", "scene"]


def test_splitting_into_batches_changes_nothing() -> None:
    states = [parked(), *straight(np.array([-20.0, -3.6, 10.0]), np.array([20.0, -2.9, 10.0]), speed=0.7)]
    whole = judge(states)
    one_by_one = Referee(truth(), FLEET)
    for s in states:
        one_by_one.see(s)
        one_by_one.finish()
    assert one_by_one.min_clearance_m == pytest.approx(whole.min_clearance_m, abs=1e-3)
    assert len(one_by_one.collision_events) == len(whole.collision_events) == 1


def climb(pad: Array, height_m: float, t0_s: float, vehicle_id: int = 1) -> list[VehicleState]:
    return straight(pad, pad + np.array([0.0, 0.0, height_m]), 1.0, t0_s, vehicle_id)


def test_take_off_and_landing_on_the_pad_are_neither_collision_nor_clearance() -> None:
    pad = np.array([30.0, 0.0, 0.2])
    up = climb(pad, 5.0, 0.1)
    down = straight(pad + np.array([0.0, 0.0, 5.0]), pad, 1.0, up[-1].t_ns / SECOND_NS)
    landed = state(down[-1].t_ns / SECOND_NS + 0.1, pad, np.zeros(3), flying=False)
    referee = judge([parked(pad=(30.0, 0.0, 0.2)), *up, *down[1:], landed])
    assert referee.collision_events == []
    assert referee.min_clearance_m == pytest.approx(3.2, abs=0.03)


def test_touching_the_ground_away_from_the_pad_is_a_collision() -> None:
    referee = judge([parked(), *straight(np.array([20.0, 0.0, 3.0]), np.array([30.0, 0.0, 0.1]))])
    assert len(referee.collision_events) == 1


def test_an_emergency_landing_straight_down_is_no_collision_but_one_on_the_structure_is() -> None:
    ground = straight(np.array([20.0, 0.0, 8.0]), np.array([20.0, 0.0, 0.1]), 1.0)
    referee = judge([parked(), *ground])
    assert referee.collision_events == []
    assert referee.min_clearance_m == pytest.approx(0.1, abs=0.02)
    roof = straight(np.array([0.0, 0.0, 20.0]), np.array([0.0, 0.0, 14.1]), 1.0)
    assert len(judge([parked(), *roof]).collision_events) == 1


def test_what_stands_on_the_ground_does_not_collide() -> None:
    spot = np.array([20.0, 0.0, 0.1])
    standing = [state(0.1 * k, spot, np.zeros(3), flying=False) for k in range(100)]
    assert judge([parked(), *standing]).collision_events == []


@given(st.floats(0.7, 5.0), st.floats(-0.15, 0.15))
@settings(max_examples=25, deadline=None)
def test_separation_of_two_crossing_vehicles(apart_m: float, late_s: float) -> None:
    a = straight(np.array([-30.0, 20.0, 10.0]), np.array([-10.0, 20.0, 10.0]))
    b = straight(np.array([-20.0, 10.0, 10.0 + apart_m]), np.array([-20.0, 30.0, 10.0 + apart_m]), t0_s=0.1 + late_s)
    b = [s for s in b if s.t_ns >= 0]
    both = sorted([*a, *(_as(2, s) for s in b)], key=lambda s: (s.t_ns, s.vehicle_id))
    referee = judge([parked(1), parked(2, (90.0, 100.0, 0.2)), *both])
    expected = math.hypot(apart_m, 3.0 * late_s / math.sqrt(2.0))
    assert referee.min_separation_m == pytest.approx(expected, abs=0.02)
    assert referee.collision_events == []


def test_two_vehicles_that_meet_collide_once() -> None:
    a = straight(np.array([-30.0, 20.0, 10.0]), np.array([-10.0, 20.0, 10.0]))
    b = straight(np.array([-10.0, 20.0, 10.0]), np.array([-30.0, 20.0, 10.0]))
    both = [s for pair in zip(a, (_as(2, s) for s in b), strict=True) for s in pair]
    referee = judge([parked(1), parked(2, (90.0, 100.0, 0.2)), *both])
    assert [(e["vehicle_id"], e["with"]) for e in referee.collision_events] == [(1, "uav2")]


def test_an_aircraft_whose_computer_has_died_is_still_in_the_way() -> None:
    referee = Referee(truth(), FLEET)
    hover = np.array([-20.0, 20.0, 10.0])
    beside = state(1.9, hover + np.array([0.0, 5.0, 0.0]), np.array([1.0, 0.0, 0.0]), 2)
    for k in range(20):
        referee.see(state(0.1 * k, hover, np.zeros(3), 1))
        referee.see(state(0.1 * k, hover + np.array([0.0, 5.0, 0.0]), np.zeros(3), 2))
    for s in straight(hover, hover + np.array([0.0, 5.0, 0.0]), t0_s=2.0):
        referee.see(s)
        referee.see(resting(beside, s.t_ns))
    referee.finish()
    assert [(e["vehicle_id"], e["with"]) for e in referee.collision_events] == [(1, "uav2")]


@pytest.mark.parametrize(("appears_s", "hits"), [(0.0, 1), (100.0, 0)])
def test_a_box_counts_only_while_it_is_there(appears_s: float, hits: int) -> None:
    beam = ObstacleSpec(center_enu_m=(-20.0, 20.0, 10.0), size_m=(0.4, 6.0, 0.4), appears_at_s=appears_s,
                        disappears_at_s=appears_s + 50.0)
    path = straight(np.array([-30.0, 20.0, 10.0]), np.array([-10.0, 20.0, 10.0]))
    assert len(judge([parked(), *path], truth([beam])).collision_events) == hits


@given(st.lists(st.floats(-3.0, 3.0), min_size=18, max_size=18), st.floats(0.02, 2.0))
def test_the_quintic_meets_both_ends(values: list[float], h_s: float) -> None:
    p0, v0, a0, p1, v1, a1 = np.array(values).reshape(6, 1, 3)
    h = np.array([[h_s]])

    def at(u: float) -> Array:
        return quintic(np.array([[u]]), h, (p0, v0, a0), (p1, v1, a1))

    e = 1e-4
    assert at(0.0) == pytest.approx(p0)
    assert at(1.0) == pytest.approx(p1)
    assert (at(e) - at(0.0)) / (e * h_s) == pytest.approx(v0, abs=0.02 / h_s)
    assert (at(1.0) - at(1.0 - e)) / (e * h_s) == pytest.approx(v1, abs=0.02 / h_s)


def test_the_verdict_has_null_for_what_never_was() -> None:
    summary = judge([parked()]).summary()
    assert summary == {"collisions": 0, "collision_events": [], "min_clearance_m": None, "min_separation_m": None}


def _as(vehicle_id: int, s: VehicleState) -> VehicleState:
    return state(s.t_ns / SECOND_NS, np.array(s.position_enu_m), np.array(s.velocity_enu_m_s), vehicle_id)
