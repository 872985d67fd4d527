"""A vehicle whose process is killed and started again: the aircraft is where it was, and so is its card."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from missions import topics
from missions.mavlink import Item
from missions.messages import FenceOrder, vector
from missions.mission import SiteSpec
from missions.pads import fence_limit
from tests.door_world import DoorWorld, flight_plan, take_off
from tests.test_vehicle_flight import mission, open_map, route
from tests.vehicle_world import SITE, World
from vehicle.aircraft_file import AircraftFile, AircraftState
from vehicle.on_board import OnBoardFile, recall, set_in_flight
from vehicle.simulator import NS
from vehicle.vehicle import Vehicle

POINTS = [(0.0, -10.0, 5.0), (6.0, -10.0, 5.0), (12.0, -10.0, 5.0)]


def restart(world: World, folder: Path, dead_s: float) -> Vehicle:
    """Vehicle 1 dies here, and is started again so much later."""
    kept = AircraftFile(folder / "aircraft.bin", "hash")
    kept.write(world.vehicles[1].aircraft)
    kept.close()
    OnBoardFile(folder / "on_board.bin", "hash").keep(world.vehicles[1], world.t_ns)
    world.t_ns += round(dead_s * NS)
    world.inbox[1].clear()
    found = AircraftFile(folder / "aircraft.bin", "hash")
    successor = Vehicle(world.mission, SITE, 1, folder / "1")
    successor.camera.remember()
    known = OnBoardFile(folder / "on_board.bin", "hash").found
    assert found.found is not None
    assert known is not None
    recall(successor, known)
    successor.find(found.found, world.t_ns)
    found.close()
    world.vehicles[1] = successor
    return successor


def test_it_holds_where_it_was_and_flies_a_new_plan_home(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route(POINTS), 1)
    assert world.run(60, lambda: world.views() == [100] and world.states[1][-1].position_enu_m[0] > 3.0)
    before, level = world.path(1)[-1], world.vehicles[1].battery.level_percent
    vehicle = restart(world, tmp_path, dead_s=30.0)
    assert vehicle.battery.level_percent == pytest.approx(
        level - vehicle.battery.energy.rest_percent((world.t_ns - world.states[1][-1].t_ns) / NS))
    assert vehicle.executor.armed
    world.run(10)
    assert np.allclose(world.path(1)[-50:], before)
    assert world.states[1][-1].mode == "hold"
    assert world.views() == [100]
    world.share_map(open_map(world.mission))
    world.upload(route(POINTS[1:], plan_id=2, first_view=101, home_after=True), 1)
    assert world.run(120, lambda: world.landed() and len(world.views()) == 3)
    assert world.views() == [100, 101, 102]
    jumps = np.linalg.norm(np.diff(world.path(1), axis=0), axis=1)
    assert jumps.max() <= world.mission.fleet.speed_m_s * 0.1 + 1e-6


def test_it_is_not_armed_again_nor_told_to_take_off(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route(POINTS[:1]), 1)
    assert world.run(60, lambda: world.views() == [100])
    restart(world, tmp_path, dead_s=1.0)
    seen = len(world.mavlink[1])
    world.run(5)
    beats = [m for m in world.mavlink[1][seen:] if m.get_type() == "HEARTBEAT" and m.autopilot != 8]
    assert beats
    assert all(m.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED for m in beats)


def test_its_card_is_delivered_and_nothing_is_taken_twice(tmp_path: Path) -> None:
    world = World(mission(), tmp_path, acknowledge=False)
    world.share_map(open_map(world.mission))
    world.upload(route(POINTS[:2]), 1)
    assert world.run(60, lambda: len(world.views()) == 2 and world.vehicles[1].camera.owed == 2)
    vehicle = restart(world, tmp_path, dead_s=2.0)
    assert vehicle.camera.owed == 2
    world.chunks.clear()
    world.acknowledge = True
    world.run(3)
    assert {c.meta.view_id for c in world.chunks} == {100, 101}
    assert vehicle.camera.owed == 0
    world.upload(route(POINTS[:2], plan_id=3), 1)
    world.run(10)
    assert world.views() == [100, 101]
    assert restart(world, tmp_path, dead_s=1.0).camera.owed == 0


def test_on_its_way_home_it_comes_home(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route(POINTS[:1], home_after=True), 1)
    assert world.run(60, lambda: world.vehicles[1].executor.mode == "return" and bool(world.views()))
    restart(world, tmp_path, dead_s=1.0)
    world.share_map(open_map(world.mission))
    assert world.run(60, world.landed)


def test_what_was_set_uploaded_and_seen_in_flight_is_not_forgotten(tmp_path: Path) -> None:
    world = DoorWorld(tmp_path, site=SiteSpec(geofence_room_m=6.0))
    client, (least, most) = world.client(), fence_limit(world.mission, SITE)
    assert client.upload(flight_plan(world)) == mav.MAV_MISSION_ACCEPTED
    take_off(client)
    before = world.vehicles[1]
    east, north, up = before.pilot.position(world.t_ns)
    world.obstacles.append(((east + 5.0, north - 9.0, 0.0), (east + 5.5, north + 9.0, 12.0)))
    for name, kind, value in (("MPC_XY_CRUISE", mav.MAV_PARAM_TYPE_REAL32, 1.0), (
            "COM_LOW_BAT_ACT", mav.MAV_PARAM_TYPE_INT32, struct.unpack("<f", struct.pack("<i", 2))[0])):
        client.tell(mav.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
        assert client.wait(lambda m: m.get_type() in ("PARAM_VALUE", "PARAM_ERROR")).get_type() == "PARAM_VALUE"
    world.send(1, topics.FENCE_ORDER, FenceOrder(order_id=1, lower_enu_m=vector(least), upper_enu_m=vector(most)))
    corners = [(east - 9.0, north - 9.0), (east + 4.0, north - 9.0), (east + 4.0, north + 9.0), (east - 9.0, north + 9)]
    places = [world.site.geodetic_from_enu(np.array([x, y, 0.0])) for x, y in corners]
    fence = [Item(mav.MAV_FRAME_GLOBAL_INT, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, (4.0, 0.0, 0.0, 0.0),
                  round(lat * 1e7), round(lon * 1e7), 0.0) for lat, lon, _ in places]
    assert client.upload(fence, mav.MAV_MISSION_TYPE_FENCE) == mav.MAV_MISSION_ACCEPTED
    world.run(1.0)
    told, sensed = set_in_flight(before), before.memory.sensed
    after = restart(world, tmp_path, dead_s=5.0)
    assert set_in_flight(after) == told
    assert after.memory.sensed == sensed
    assert after.failsafe.settings == before.failsafe.settings
    assert after.pilot.limits.speed_m_s == 1.0
    assert np.allclose(after.lookout.fence.upper_enu_m, most)
    inside = after.lookout.fence.room_m(np.array([[east + 3.9, north, up], [east + 4.1, north, up]])) >= 0.0
    assert inside.tolist() == [True, False]
    assert not after.memory.hits_clear(np.array([[east, north, up], [east + 5.0, north, up]]), 0.5)
    assert [(m.x, m.y) for m in client.download(mav.MAV_MISSION_TYPE_FENCE)] == [(i.x, i.y) for i in fence]


@given(st.integers(0, 200), st.binary(max_size=3))
def test_a_torn_file_is_no_aircraft(tmp_path_factory: pytest.TempPathFactory, cut: int, junk: bytes) -> None:
    path = tmp_path_factory.mktemp("torn") / "aircraft.bin"
    state = AircraftState(5, (1.0, 2.0, 3.0), 0.1, 0.2, 50.0, None, "hold", (255, 230), False, [(0.0, 0.0, 1.0)] * 3)
    file = AircraftFile(path, "hash")
    assert file.found is None
    file.write(state)
    file.close()
    whole = path.read_bytes()
    path.write_bytes(whole[:cut] + junk)
    again = AircraftFile(path, "hash")
    assert again.found in (None, state)
    assert (again.found == state) == ((whole[:cut] + junk)[:len(whole)] == whole)
    again.close()
    path.write_bytes(whole)
    other = AircraftFile(path, "another mission")
    assert other.found is None
    other.close()
