"""MAVSDK, a client that we did not write, reads our plan files to the items that we would upload."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.plugins.mission_raw.mission_raw import MissionItem, MissionRaw
from pymavlink.dialects.v20 import common as mav

from missions.flight_plan import FILE_FRAMES, FlightPlan, home_item, item_from_params
from missions.mavlink import Endpoint, Item, Route, Waypoint, items_from_route, plan_sha256
from missions.qgc_plan import write_plan
from missions.waypoint_file import write_waypoints
from tests.test_mavlink import SITE

pytestmark = pytest.mark.xdist_group("mavsdk")

ROUTE = Route(plan_id=1, phase="survey", home_after=True, waypoints=[
    Waypoint(position_enu_m=(1.0, -17.0, 3.0), yaw_enu_rad=0.5, stop=False, pass_m=0.25),
    Waypoint(position_enu_m=(-120.5, 33.25, 61.125), yaw_enu_rad=-2.5, gimbal_elevation_rad=-0.7, view_id=10001,
             settle_s=0.5),
    Waypoint(position_enu_m=(12.0, 80.0, 9.0), yaw_enu_rad=3.0, gimbal_elevation_rad=0.4, view_id=10002, stop=False,
             pass_m=0.25, speed_m_s=1.25)])
OUTLINE = ((52.22, 6.885), (52.22, 6.888), (52.222, 6.888), (52.222, 6.885))
FENCE = [item_from_params(0, 5001, (4, 0, 0, 0, *corner, 0), "outline") for corner in OUTLINE]
CIRCLE = item_from_params(0, 5004, (7.5, 0, 0, 0, 52.221, 6.886, 0), "circle")
RALLY = item_from_params(3, 5100, (0, 0, 0, 0, 52.2203, 6.8859, 12), "rally")
PLAN = FlightPlan(home=home_item(SITE.lat_deg, SITE.lon_deg, SITE.alt_m), mission=items_from_route(ROUTE, SITE),
                  fence=[*FENCE, CIRCLE], rally=[RALLY])


@pytest.fixture(scope="module")
def mission_raw() -> Iterator[MissionRaw]:
    """MAVSDK with a vehicle that says no more than one heartbeat, passed by hand: no port is opened."""
    with Mavsdk(Configuration.create_manual(255, 190, False)) as client:
        client.add_any_connection("raw://")
        client.pass_received_raw_bytes(Endpoint(1, 1).pack(mav.MAVLink_heartbeat_message(
            mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PX4, 0, 0, mav.MAV_STATE_STANDBY, 3)))
        system = client.first_autopilot(120.0)
        assert system is not None
        yield MissionRaw(system)


def as_items(received: list[MissionItem]) -> list[Item]:
    wire = {file: frame for frame, file in FILE_FRAMES.items()}
    return [Item(wire[r.frame], r.command, (r.param1, r.param2, r.param3, r.param4), r.x, r.y, r.z) for r in received]


def test_mavsdk_imports_the_items_of_a_plan(mission_raw: MissionRaw, tmp_path: Path) -> None:
    write_plan(tmp_path / "a.plan", PLAN)
    read = mission_raw.import_qgroundcontrol_mission(str(tmp_path / "a.plan"))
    assert plan_sha256(as_items(read.mission_items)) == plan_sha256(PLAN.mission)
    assert [m.mission_type for m in read.geofence_items] == [mav.MAV_MISSION_TYPE_FENCE] * 5
    assert plan_sha256(as_items(read.geofence_items)) == plan_sha256(PLAN.fence)
    assert plan_sha256(as_items(read.rally_items)) == plan_sha256(PLAN.rally)


def test_mavsdk_imports_the_items_of_a_waypoint_file(mission_raw: MissionRaw, tmp_path: Path) -> None:
    write_waypoints(tmp_path / "a.waypoints", PLAN.home, PLAN.mission)
    read = mission_raw.import_mission_planner_mission(str(tmp_path / "a.waypoints"))
    assert plan_sha256(as_items(read.mission_items)) == plan_sha256([PLAN.home, *PLAN.mission])
