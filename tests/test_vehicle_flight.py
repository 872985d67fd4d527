"""A vehicle in a world of one process: routes, obstacles that appear, teammates, failsafes, pictures, MAVLink."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from missions import topics
from missions.messages import PictureAck
from missions.mission import Mission
from missions.pads import takeoff_points
from tests.vehicle_world import NS, SITE, TICK_NS, World, box_distance, open_map, route
from vehicle.teammates import LOST_TEAMMATE

BOX = ((-10.0, -2.0, 0.0), (10.0, 2.0, 10.0))


def mission(vehicles: int = 1, **sections: object) -> Mission:
    return msgspec.convert({"title": "test", "fleet": {"vehicles": vehicles}, **sections}, Mission)


def flown(world: World) -> bool:
    return world.t_ns > 5 * NS and world.landed()


def test_route_is_flown_photographed_and_ends_on_the_pad(tmp_path: Path) -> None:
    world = World(mission(), tmp_path, obstacles=[BOX])
    world.share_map(open_map(world.mission, [BOX]))
    world.upload(route([(0, -8, 4), (8, -8, 4), (8, -8, 8), (0, 8, 8)], home_after=True), 1)
    assert world.run(120, lambda: flown(world))
    assert world.views() == [100, 101, 102, 103]
    assert not world.reports
    for shutter, wanted in zip(world.shutters, route([(0, -8, 4), (8, -8, 4), (8, -8, 8), (0, 8, 8)]).waypoints,
                               strict=True):
        assert np.linalg.norm(np.subtract(shutter.pose.position_enu_m, wanted.position_enu_m)) < 0.02
        assert shutter.pose.yaw_enu_rad == pytest.approx(wanted.yaw_enu_rad, abs=1e-5)
        assert shutter.pose.elevation_rad == pytest.approx(wanted.gimbal_elevation_rad, abs=1e-5)
        assert shutter.speed_m_s == 0.0
    path = world.path(1)
    assert box_distance(path, BOX).min() >= world.mission.fleet.clearance_m
    assert np.linalg.norm(path[-1] - takeoff_points(world.mission, SITE)[0]) < 0.01
    speed = max(float(np.linalg.norm(s.velocity_enu_m_s)) for s in world.states[1])
    assert 2.0 < speed <= world.mission.fleet.speed_m_s + 1e-6


def test_battery_falls_by_the_rate_per_metre(tmp_path: Path) -> None:
    world = World(mission(battery={"model": "distance"}), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(0, -10, 5), (10, -10, 5)], home_after=True), 1)
    assert world.run(120, lambda: flown(world))
    length = np.linalg.norm(np.diff(world.path(1), axis=0), axis=1).sum()
    used = 100.0 - world.vehicles[1].battery.level_percent
    assert used == pytest.approx(world.mission.battery.percent_per_m * length, rel=0.01)


def test_pictures_in_passing_are_taken_at_speed_at_the_very_instant(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    world.share_map(open_map(world.mission))
    plan = route([(-8, -9, 5), (-3, -9, 5), (2, -9, 5), (8, -9, 5)], stop=False)
    world.upload(plan, 1)
    assert world.run(60, lambda: len(world.shutters) == 4)
    assert [s.speed_m_s > 1.0 for s in world.shutters] == [False, True, True, False]
    for shutter, wanted in zip(world.shutters, plan.waypoints, strict=True):
        assert np.linalg.norm(np.subtract(shutter.pose.position_enu_m, wanted.position_enu_m)) < 0.05
        assert abs(shutter.pose.yaw_enu_rad - wanted.yaw_enu_rad) < 0.02
    assert any(s.t_capture_ns % TICK_NS for s in world.shutters)


@pytest.mark.parametrize("beam", [((-1.0, -10.15, 0.0), (-0.7, -9.85, 9.0)), ((-1.0, -14.0, 4.9), (-0.7, -6.0, 5.2)),
                                  ((-1.0, -13.0, 4.7), (-0.9, -7.0, 4.8))], ids=["upright", "across", "thin"])
def test_flies_around_a_beam_that_appears_across_its_leg(tmp_path: Path, beam: object) -> None:
    world = World(mission(), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(-10, -10, 5), (9, -10, 5)]), 1)
    assert world.run(60, lambda: world.views() == [100])
    assert world.run(30, lambda: world.states[1][-1].position_enu_m[0] > -9.0)
    world.obstacles.append(beam)  # type: ignore[arg-type]
    assert world.run(60, lambda: world.views() == [100, 101]), world.reports
    start = next(n for n, s in enumerate(world.states[1]) if s.position_enu_m[0] > -9.0)
    assert box_distance(world.path(1)[start:], beam).min() >= world.mission.fleet.clearance_m  # type: ignore[arg-type]
    assert world.vehicles[1].avoidance.replans >= 1
    assert not world.reports


def test_a_view_behind_a_wall_is_reported_blocked_and_the_next_one_is_flown(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    shell = [((4.0, -14.0, 0.0), (16.0, -13.5, 9.0)), ((4.0, -8.5, 0.0), (16.0, -8.0, 9.0)),
             ((4.0, -14.0, 0.0), (4.5, -8.0, 9.0)), ((15.5, -14.0, 0.0), (16.0, -8.0, 9.0)),
             ((4.0, -14.0, 8.5), (16.0, -8.0, 9.0))]
    world.share_map(open_map(world.mission, shell))
    world.upload(route([(10, -11, 4), (-8, -11, 4)], home_after=True), 1)
    assert world.run(200, lambda: flown(world))
    assert world.views() == [101]
    assert [(r.view_id, r.outcome) for r in world.reports] == [(100, "blocked")]


def test_unknown_space_is_not_flown_through(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    world.upload(route([(0, -10, 20)]), 1)
    world.run(3)
    assert [v.accepted for v in world.verdicts] == [False]
    assert world.verdicts[0].reason.startswith("clearance")
    assert not world.vehicles[1].executor.flying


def test_two_vehicles_on_crossing_legs_keep_their_separation(tmp_path: Path) -> None:
    world = World(mission(2), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(-9, -10, 5), (9, -10, 5), (-9, -10, 5)], home_after=True), 1)
    world.upload(route([(9, -10, 5), (-9, -10, 5), (9, -10, 6)], first_view=200, home_after=True), 2)
    assert world.run(300, lambda: flown(world))
    assert sorted(world.views()) == [100, 101, 102, 200, 201, 202], world.reports
    assert separation(world) >= world.mission.fleet.separation_m


def test_a_hovering_teammate_makes_room(tmp_path: Path) -> None:
    world = World(mission(2), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(0, -9, 6)]), 2)
    assert world.run(60, lambda: world.views() == [100])
    world.upload(route([(0, -9, 6)], first_view=300, plan_id=2), 1)
    assert world.run(60, lambda: world.views() == [100, 300]), world.reports
    assert separation(world) >= world.mission.fleet.separation_m


def test_eight_vehicles_share_a_small_place(tmp_path: Path) -> None:
    world = World(mission(8), tmp_path)
    world.share_map(open_map(world.mission))
    for k in range(1, 9):
        a, b = -14.0 + 3.5 * k, 17.0 - 3.5 * k
        world.upload(route([(a, -9, 4), (b, -7, 8)], first_view=100 * k, home_after=True), k)
    assert world.run(400, lambda: flown(world))
    assert separation(world) >= world.mission.fleet.separation_m
    assert len(world.views()) + len(world.reports) == 16
    assert len(world.views()) >= 15, world.reports


def separation(world: World) -> float:
    """Least distance between two vehicles in flight, over all ticks."""
    tracks = [{s.t_ns: np.array(s.position_enu_m) for s in states if s.flying} for states in world.states.values()]
    gaps = [np.linalg.norm(a[t] - b[t]) for n, a in enumerate(tracks) for b in tracks[:n] for t in a.keys() & b.keys()]
    return float(min(gaps))


@pytest.mark.parametrize("beside_m", [2.4, 2.55, 2.65, 2.79, 3.0])
def test_beside_a_dead_teammate_a_place_is_refused_or_flown_to(tmp_path: Path, beside_m: float) -> None:
    world = World(mission(vehicles=2), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(-4, -10, 5)], plan_id=1), 1)
    assert world.run(60, lambda: world.views() == [100])
    del world.vehicles[1]
    world.upload(route([(-4 + beside_m, -10, 5), (-4, -10 + beside_m, 5), (-9, -10, 5)], plan_id=2, first_view=200,
                       home_after=True), 2)
    assert world.run(2, lambda: world.verdicts[-1].plan_id == 2)
    if not world.verdicts[-1].accepted:
        assert beside_m < world.mission.fleet.separation_m
        assert world.verdicts[-1].reason.endswith(LOST_TEAMMATE)
        return
    assert world.run(90, lambda: flown(world))
    given_back = [r.view_id for r in world.reports if r.detail.endswith(LOST_TEAMMATE)]
    assert given_back == [] or beside_m < world.mission.fleet.separation_m + 0.1
    assert sorted([*given_back, *world.views()]) == [100, 200, 201, 202]
    apart = np.linalg.norm(world.path(2) - world.path(1)[-1], axis=1)
    assert apart.min() >= world.mission.fleet.separation_m


def test_a_view_behind_a_dead_teammate_is_given_back_with_its_name(tmp_path: Path) -> None:
    walls = [((-11.0, 7.0, 0.0), (6.0, 8.0, 8.0)), ((-11.0, 12.0, 0.0), (6.0, 13.0, 8.0)),
             ((-11.0, 7.0, 0.0), (-10.0, 13.0, 8.0)), ((-11.0, 7.0, 7.0), (6.0, 13.0, 8.0))]
    world = World(mission(vehicles=2), tmp_path, obstacles=walls)
    world.share_map(open_map(world.mission, walls))
    world.upload(route([(-2, 10, 3.5)], plan_id=1), 1)
    assert world.run(60, lambda: world.views() == [100])
    del world.vehicles[1]
    world.upload(route([(-7, 10, 3.5), (9, 10, 3.5)], plan_id=2, first_view=200, home_after=True), 2)
    assert world.run(120, lambda: world.t_ns > 30 * NS and world.landed())
    assert world.views() == [100, 201]
    assert [(r.view_id, r.outcome) for r in world.reports] == [(200, "blocked")]
    assert world.reports[0].detail.endswith(LOST_TEAMMATE)


def test_at_the_threshold_remaining_views_are_given_back(tmp_path: Path) -> None:
    world = World(mission(battery={"start_percent": [22.0], "threshold_percent": 20.0}), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(x, -10, 5) for x in (-10, 10, -10, 10, -9, 9)]), 1)
    assert world.run(200, lambda: flown(world))
    given_back = [r.view_id for r in world.reports if r.outcome == "energy"]
    assert world.views() + given_back == [100, 101, 102, 103, 104, 105]
    assert len(given_back) >= 1
    assert world.vehicles[1].battery.level_percent > 15.0


def test_an_empty_battery_lands_at_once(tmp_path: Path) -> None:
    world = World(mission(battery={"start_percent": [30.0], "threshold_percent": 0.0}), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(-10, -10, 5), (10, -10, 5)]), 1)
    assert world.run(60, lambda: bool(world.views()))
    world.vehicles[1].battery.level_percent = 1.5
    assert world.run(30, lambda: world.landed())
    assert [r.outcome for r in world.reports] == ["energy"]


def test_without_a_ground_station_the_plan_is_finished_and_the_vehicle_comes_home(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(-10, -10, 5), (10, -10, 5)]), 1)
    assert world.run(60, lambda: bool(world.views()))
    world.ground_alive = False
    assert world.run(120, lambda: world.landed())
    assert world.views() == [100, 101]
    assert len(list((tmp_path / "1").glob("*.jpg"))) == 2


def test_a_pair_of_flights_is_bit_equal(tmp_path: Path) -> None:
    def fly(folder: Path) -> bytes:
        folder.mkdir()
        world = World(mission(2), folder, obstacles=[((-1.0, -14.0, 4.0), (-0.5, -5.0, 6.0))])
        world.share_map(open_map(world.mission))
        world.upload(route([(-9, -10, 5), (9, -10, 5)], home_after=True), 1)
        world.upload(route([(9, -8, 5), (-9, -8, 5)], first_view=200, home_after=True), 2)
        assert world.run(300, lambda: flown(world))
        return msgspec.msgpack.encode([world.states[1], world.states[2], world.shutters])

    assert fly(tmp_path / "a") == fly(tmp_path / "b")


def test_pictures_are_kept_and_sent_again_until_acknowledged(tmp_path: Path) -> None:
    world = World(mission(), tmp_path, acknowledge=False)
    world.share_map(open_map(world.mission))
    world.upload(route([(0, -10, 5)]), 1)
    assert world.run(60, lambda: len(world.chunks) >= 2)
    meta = world.chunks[0].meta
    assert (tmp_path / "1" / "explore_100.jpg").read_bytes() == b"".join(c.data for c in world.chunks[:2])
    world.send(1, topics.PICTURE_ACK, PictureAck(view_id=100, sha256=meta.sha256, missing=[1]))
    world.run(1)
    assert [c.index for c in world.chunks] == [0, 1, 1]
    world.run(6)
    assert [c.index for c in world.chunks] == [0, 1, 1, 0, 1]
    world.send(1, topics.PICTURE_ACK, PictureAck(view_id=100, sha256="wrong"))
    world.run(1)
    assert world.vehicles[1].camera.owed == 1
    world.send(1, topics.PICTURE_ACK, PictureAck(view_id=100, sha256=meta.sha256))
    world.run(12)
    assert world.vehicles[1].camera.owed == 0
    assert len(world.chunks) == 5


def test_mavlink_telemetry_tells_where_and_how(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(0, -10, 5), (5, -10, 5)], home_after=True), 1)
    world.command(1, mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_HOME_POSITION)
    assert world.run(120, lambda: flown(world))
    kinds = [m.get_type() for m in world.mavlink[1]]
    seconds = world.t_ns / NS
    assert seconds - 2 <= kinds.count("HEARTBEAT") <= seconds + 12, "once a second, and when the mode has changed"
    assert kinds.count("GLOBAL_POSITION_INT") == pytest.approx(5 * seconds, rel=0.05)
    assert kinds.count("HOME_POSITION") == 1
    assert kinds.count("CAMERA_IMAGE_CAPTURED") == 2
    reached = [m.seq for m in world.mavlink[1] if m.get_type() == "MISSION_ITEM_REACHED"]
    assert reached == sorted(set(reached)) == list(range(1, 9))
    beats = [m for m in world.mavlink[1] if m.get_type() == "HEARTBEAT"]
    armed = [bool(m.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED) for m in beats]
    assert armed[0] is False
    assert any(armed)
    position = [m for m in world.mavlink[1] if m.get_type() == "LOCAL_POSITION_NED"][-1]
    assert (position.y, position.x, -position.z) == pytest.approx(takeoff_points(world.mission, SITE)[0], abs=0.01)


def test_pause_and_continue_return_and_refused_disarm(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(-9, -10, 5), (9, -10, 5), (0, -8, 7)]), 1)
    assert world.run(60, lambda: bool(world.views()))
    world.run(1)
    world.command(1, mav.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)
    world.run(5)
    assert world.states[1][-1].mode == "hold"
    assert np.linalg.norm(world.states[1][-1].velocity_enu_m_s) < 1e-9
    world.command(1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0)
    world.command(1, mav.MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
    assert world.run(60, lambda: world.views() == [100, 101])
    acks = {m.command: m.result for m in world.mavlink[1] if m.get_type() == "COMMAND_ACK"}
    assert acks[mav.MAV_CMD_COMPONENT_ARM_DISARM] == mav.MAV_RESULT_DENIED
    world.command(1, mav.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    assert world.run(60, lambda: world.landed())
    assert [r.view_id for r in world.reports] == [102]


def test_a_new_plan_in_flight_takes_over_after_the_present_leg(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(-9, -10, 5), (9, -10, 5), (9, -8, 8)]), 1)
    assert world.run(60, lambda: world.views() == [100])
    world.upload(route([(0, -8, 7)], plan_id=2, first_view=400), 1)
    assert world.run(60, lambda: len(world.views()) == 3)
    assert world.views() == [100, 101, 400]


@pytest.mark.parametrize(("points", "kind"), [([(0.0, -60.0, 5.0)], "fence"), ([(0.0, -2.5, 5.0)], "clearance"),
                                              ([(0.0, 9.0 * (-1) ** n, 5.0) for n in range(120)], "energy")])
def test_a_plan_is_refused_whole(tmp_path: Path, points: list[tuple[float, float, float]], kind: str) -> None:
    world = World(mission(battery={"start_percent": [50.0]}), tmp_path)
    world.share_map(open_map(world.mission, [BOX]))
    world.upload(route(points), 1)
    world.run(5)
    assert [v.accepted for v in world.verdicts] == [False]
    assert world.verdicts[0].reason.startswith(kind)
    assert not world.vehicles[1].executor.flying
    assert not world.vehicles[1].faces.craft.plan.items


def test_a_plan_with_another_hash_is_refused(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(0, -10, 5)]), 1, sha256="0" * 64)
    world.run(3)
    assert not world.verdicts[0].accepted
    assert world.verdicts[0].reason.startswith("hash")


def test_set_current_skips_waypoints(tmp_path: Path) -> None:
    world = World(mission(), tmp_path)
    world.share_map(open_map(world.mission))
    world.upload(route([(-9, -10, 5), (9, -10, 5), (0, -8, 7), (4, -9, 5)]), 1)
    assert world.run(60, lambda: world.views() == [100])
    world.tell(1, mav.MAVLink_mission_set_current_message(1, 1, 13))
    assert world.run(60, lambda: len(world.views()) == 3)
    assert world.views() == [100, 101, 103]


def test_a_view_without_a_picture_is_given_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(mission(), tmp_path)
    monkeypatch.setattr(world, "_expose", lambda k, request: world.shutters.append(request))
    world.share_map(open_map(world.mission))
    world.upload(route([(0, -10, 5)]), 1)
    assert world.run(60, lambda: bool(world.reports))
    assert [(r.plan_id, r.view_id, r.outcome) for r in world.reports] == [(1, 100, "unreachable")]


def test_a_ground_station_that_was_away_is_told_again_what_belongs_to_the_plan(tmp_path: Path) -> None:
    """The pictures that it has not acknowledged at once, reports and reached items of the plan under way."""
    world = World(mission(), tmp_path, obstacles=[((4.0, -11.0, 0.0), (6.0, -9.0, 20.0))], acknowledge=False)
    world.share_map(open_map(world.mission))
    world.upload(route([(-10, -10, 5), (5, -10, 5), (10, -10, 5)]), 1)
    assert world.run(120, lambda: bool(world.reports))
    told, reached = list(world.reports), [m.seq for m in world.mavlink[1] if m.get_type() == "MISSION_ITEM_REACHED"]
    world.ground_alive = False
    world.run(3.0)
    world.ground_alive = True
    for heard in (world.reports, world.chunks, world.mavlink[1]):
        heard.clear()
    world.tick()
    world.tick()
    assert world.reports[:len(told)] == told
    assert {c.meta.view_id for c in world.chunks} >= set(world.views()[:1])
    again = [m.seq for m in world.mavlink[1] if m.get_type() == "MISSION_ITEM_REACHED"]
    assert again[:len(reached)] == reached
    assert reached
