"""Plans in files: QGroundControl's .plan and QGC WPL 110 there and back, as others write them, and broken ones."""

import copy
import json
import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavwp
from pymavlink.dialects.v20 import common as mav

from missions.errors import ProtocolError, UserError
from missions.flight_plan import UNSET, FlightPlan, home_item, item_from_params, params_of_item
from missions.mavlink import Item, items_from_route, plan_sha256, route_from_items
from missions.qgc_plan import read_plan, write_plan
from missions.waypoint_file import read_waypoints, write_waypoints
from tests.test_mavlink import SITE, routes

LAT, LON = st.floats(-33.9, -33.5), st.floats(151.0, 151.4)
ANY_LAT, ANY_LON = st.floats(-90, 90), st.floats(-180, 180)
ALT = st.floats(-400, 8000, width=32)
FRAMES = (0, 2, 3, 10)
singles = st.floats(allow_infinity=False, width=32)
places = st.tuples(LAT, LON)


@st.composite
def items(draw) -> Item:
    frame = draw(st.sampled_from(FRAMES))
    whole = st.integers(-2**31, 2**31 - 2)
    x, y = (whole, whole) if frame == 2 else (LAT | st.none(), LON | st.none())
    params = [*(draw(singles) for _ in range(4)), draw(x), draw(y), draw(ALT | st.none())]
    return item_from_params(frame, draw(st.integers(0, 65535)), params, "drawn")


@st.composite
def fences(draw) -> list[Item]:
    out = []
    for corners in draw(st.lists(st.lists(places, min_size=3, max_size=5), max_size=3)):
        command = draw(st.sampled_from([5001, 5002]))
        out += [item_from_params(0, command, (len(corners), 0, 0, 0, *c, 0), "drawn") for c in corners]
    for place in draw(st.lists(places, max_size=2)):
        radius = draw(st.floats(0.5, 1e4))
        out.append(item_from_params(0, draw(st.sampled_from([5003, 5004])), (radius, 0, 0, 0, *place, 0), "drawn"))
    return out + [item_from_params(3, 5000, (0, 0, 0, 0, *p, draw(ALT)), "drawn")
                  for p in draw(st.lists(places, max_size=1))]


homes = st.builds(home_item, LAT, LON, ALT)
rallies = st.lists(st.builds(lambda p, z: item_from_params(3, 5100, (0, 0, 0, 0, *p, z), "drawn"), places, ALT),
                   max_size=3)
plans = st.builds(FlightPlan, home=homes, mission=st.lists(items(), max_size=12), fence=fences(), rally=rallies)


def digest(plan: FlightPlan) -> list[str]:
    return [plan_sha256(part) for part in ([plan.home], plan.mission, plan.fence, plan.rally)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("plans")


@given(plan=plans)
def test_a_plan_comes_back_from_both_formats_bit_for_bit(folder, plan):
    write_plan(folder / "a.plan", plan)
    assert digest(read_plan(folder / "a.plan")) == digest(plan)
    write_waypoints(folder / "a.waypoints", plan.home, plan.mission)
    assert digest(read_waypoints(folder / "a.waypoints")) == digest(FlightPlan(home=plan.home, mission=plan.mission))


@given(lat=ANY_LAT, lon=ANY_LON, alt=ALT, frame=st.sampled_from([0, 3, 10]))
def test_what_is_read_is_within_2e_7_degrees_and_a_millimetre_of_what_was_written(lat, lon, alt, frame):
    back = params_of_item(item_from_params(frame, 16, (0, 0, 0, 0, lat, lon, alt), "drawn"))[4:]
    assert abs(back[0] - lat) <= 2e-7
    assert abs(back[1] - lon) <= 2e-7
    assert abs(back[2] - alt) <= 1e-3


@given(route=routes)
def test_our_vehicles_fly_what_they_read(folder, route):
    plan = FlightPlan(home=home_item(SITE.lat_deg, SITE.lon_deg, SITE.alt_m), mission=items_from_route(route, SITE))
    write_plan(folder / "b.plan", plan)
    write_waypoints(folder / "b.waypoints", plan.home, plan.mission)
    direct = route_from_items(plan.mission, SITE, 1)
    assert route_from_items(read_plan(folder / "b.plan").mission, SITE, 1) == direct
    assert route_from_items(read_waypoints(folder / "b.waypoints").mission, SITE, 1) == direct


@given(plan=plans)
def test_pymavlink_loads_the_same_items(folder, plan):
    path = folder / "c.waypoints"
    write_waypoints(path, plan.home, plan.mission)
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(path)) == 1 + len(plan.mission)
    for seq, item in enumerate([plan.home, *plan.mission]):
        w = loader.wp(seq)
        assert (w.seq, w.current, w.autocontinue) == (seq, int(seq == 0), 1)
        again = item_from_params(w.frame, w.command, (w.param1, w.param2, w.param3, w.param4, w.x, w.y, w.z), "loaded")
        assert plan_sha256([again]) == plan_sha256([item])


def test_a_file_that_pymavlink_saved_is_read(folder):
    loader = mavwp.MAVWPLoader()
    for seq, (frame, command, lat, lon, alt) in enumerate(((0, 16, 47.3977419, 8.5455938, 488.0),
                                                           (3, 22, 0.0, 0.0, 10.0), (3, 16, 47.398, 8.546, 25.5))):
        item = mavwp.mavutil.mavlink.MAVLink_mission_item_message(
            1, 1, seq, frame, command, int(seq == 0), 1, 0, 0, 0, math.nan, lat, lon, alt)
        loader.add(item, comment="as saved")
    loader.save(str(folder / "saved.txt"))
    plan = read_waypoints(folder / "saved.txt")
    assert (plan.home.x, plan.home.y, plan.home.z) == (473977420, 85455940, 488.0)  # it writes six decimals
    assert [(i.frame, i.command, i.x, i.y, i.z) for i in plan.mission] == [
        (6, 22, 0, 0, 10.0), (6, 16, 473980000, 85460000, 25.5)]


BY_HAND = {
    "fileType": "Plan", "version": 1, "groundStation": "QGroundControl",
    "geoFence": {
        "version": 2,
        "circles": [{"circle": {"center": [47.3975, 8.5461], "radius": 20.5}, "inclusion": False, "version": 1}],
        "polygons": [{"inclusion": True, "version": 1,
                      "polygon": [[47.396, 8.544], [47.396, 8.548], [47.399, 8.548], [47.399, 8.544]]}]},
    "rallyPoints": {"version": 2, "points": [[47.39760401, 8.5509154, 50]]},
    "mission": {
        "version": 2, "firmwareType": 12, "vehicleType": 2, "cruiseSpeed": 15, "hoverSpeed": 5,
        "globalPlanAltitudeMode": 1, "plannedHomePosition": [47.39777, 8.54561, 487.989],
        "items": [
            {"AMSLAltAboveTerrain": None, "Altitude": 50, "AltitudeMode": 1, "autoContinue": True, "command": 22,
             "doJumpId": 1, "frame": 3, "params": [15, 0, 0, None, 47.39781011, 8.54553801, 50], "type": "SimpleItem"},
            {"autoContinue": True, "command": 2000, "doJumpId": 2, "frame": 2,
             "params": [0, 0, 1, 7, None, None, None], "type": "SimpleItem"},
            {"type": "ComplexItem", "complexItemType": "survey", "version": 5, "TransectStyleComplexItem": {
                "version": 2, "CameraShots": 1, "Items": [
                    {"autoContinue": True, "command": 16, "doJumpId": 3, "frame": 0,
                     "params": [0, 0, 0, None, 47.398, 8.546, 540], "type": "SimpleItem"}]}},
            {"autoContinue": True, "command": 20, "doJumpId": 4, "frame": 2, "params": [0, 0, 0, 0, 0, 0, 0],
             "type": "SimpleItem"}]}}


def test_a_plan_as_qgroundcontrol_writes_it(folder):
    path = folder / "hand.plan"
    path.write_text(json.dumps(BY_HAND))
    plan = read_plan(path)
    assert (plan.home.x, plan.home.y, plan.home.z) == (473977700, 85456100, pytest.approx(487.989, abs=1e-3))
    assert [(i.frame, i.command, i.x, i.y) for i in plan.mission] == [
        (6, 22, 473978101, 85455380), (2, 2000, UNSET, UNSET), (5, 16, 473980000, 85460000), (2, 20, 0, 0)]
    assert math.isnan(plan.mission[0].params[3])
    assert math.isnan(plan.mission[1].z)
    assert plan.mission[1].params == (0.0, 0.0, 1.0, 7.0)
    assert [(i.command, i.params[0]) for i in plan.fence] == [(5001, 4.0)] * 4 + [(5004, 20.5)]
    assert [(i.frame, i.x, i.y, i.z) for i in plan.rally] == [(6, 473976040, 85509154, 50.0)]


def edited(path: str, value: object) -> str:
    tree = copy.deepcopy(BY_HAND)
    *parents, leaf = [int(p) if p.isdigit() else p for p in path.split(".")]
    node = tree
    for p in parents:
        node = node[p]
    node[leaf] = value
    return json.dumps(tree)


@pytest.mark.parametrize(("content", "field", "told"), [
    ("", "", "not valid JSON"),
    (json.dumps(BY_HAND)[:900], "", "not valid JSON"),
    (json.dumps(BY_HAND).replace("null", "NaN"), "", "not valid JSON"),
    (edited("fileType", "Fence"), "fileType", "invalid enum value"),
    (edited("version", 3), "version", "invalid enum value 3"),
    (edited("mission.plannedHomePosition", [47.0, 8.0]), "mission.plannedHomePosition", "length 3"),
    (edited("mission.plannedHomePosition", [147.0, 8.0, 0]), "mission.plannedHomePosition", "latitude is 147.0"),
    (edited("mission.items.0.params", [1, 2]), "mission.items[0].params", "length"),
    (edited("mission.items.0.params.4", "47"), "mission.items[0].params[4]", "got `str`"),
    (edited("mission.items.0.params.4", 93.5), "mission.items[0]", "latitude is 93.5"),
    (edited("mission.items.0.params.5", -181), "mission.items[0]", "longitude is -181"),
    (edited("mission.items.0.params.0", 1e300), "mission.items[0]", "beyond what MAVLink can carry"),
    (edited("mission.items.0.frame", 1), "mission.items[0]", "frame 1 is not supported"),
    (edited("mission.items.0.command", 70000), "mission.items[0]", "command 70000"),
    (edited("mission.items.1.params.4", 0.5), "mission.items[1]", "whole numbers"),
    (edited("mission.items.0.autoContinue", False), "mission.items[0]", "autoContinue"),
    (edited("mission.items.0.type", "Surprise"), "mission.items[0].type", "surprise"),
    (edited("mission.items.2", {"type": "ComplexItem", "complexItemType": "StructureScan"}), "mission.items[2]",
     "StructureScan has no commands"),
    (edited("mission.items.2.TransectStyleComplexItem.Items.0.params.4", -91), "mission.items[2].T",
     "latitude is -91"),
    (edited("geoFence.polygons.0.polygon", [[1, 2], [3, 4]]), "geoFence.polygons[0].polygon", "length >= 3"),
    (edited("geoFence.circles.0.circle.radius", -1), "geoFence.circles[0].circle.radius", "> 0"),
    (edited("rallyPoints.points.0.0", 99), "rallyPoints.points[0]", "latitude is 99"),
], ids=str.split("empty truncated nan kind version home-short home-outside params-short params-text latitude longitude "
                 "overflow frame command fraction pause type structure-scan in-survey polygon radius rally"))
def test_a_broken_plan_is_refused_in_one_sentence(tmp_path, content, field, told):
    path = tmp_path / "broken.plan"
    path.write_text(content)
    with pytest.raises(UserError) as refused:
        read_plan(path)
    said = str(refused.value)
    assert said.startswith(f"{path}: {field}")
    assert told.lower() in said.lower()
    assert said.endswith(".")


@pytest.mark.parametrize(("content", "told"), [
    (edited("mission.items", [BY_HAND["mission"]["items"][3]] * 65536), "mission.items: 65536 items are more than"),
    ('{"hidden": ' + "[" * 100_000, "not valid JSON"),
], ids=["items", "depth"])
def test_a_plan_without_bounds_is_refused(tmp_path, content, told):
    path = tmp_path / "endless.plan"
    path.write_text(content)
    with pytest.raises(UserError, match=told):
        read_plan(path)


HOME_LINE = "0 1 0 16 0 0 0 0 47.0 8.0 488 1"


@pytest.mark.parametrize(("lines", "where", "told"), [
    ([], "line 1", "QGC WPL 110"),
    (["QGC WPL 100", HOME_LINE], "line 1", "QGC WPL 110"),
    (["QGC WPL 110"], "index 0", "home"),
    (["QGC WPL 110", "0 1 3 22 0 0 0 0 47 8 10 1"], "index 0", "home"),
    (["QGC WPL 110", HOME_LINE, "1 0 3 16 0 0 0 0 47 8 10"], "line 3", "11 columns"),
    (["QGC WPL 110", HOME_LINE, "2 0 3 16 0 0 0 0 47 8 10 1"], "line 3", "index is 2 where 1 is due"),
    (["QGC WPL 110", HOME_LINE, "", "# a note", "1 0 3 16 0 0 0 0 8 547 10 1"], "line 5", "longitude is 547"),
    (["QGC WPL 110", HOME_LINE, "1 0 3 16 0 0 0 0 47 8 ten 1"], "line 3", "parameter 7 is 'ten'"),
    (["QGC WPL 110", HOME_LINE, "1 0 3 16.0 0 0 0 0 47 8 10 1"], "line 3", "command is '16.0'"),
    (["QGC WPL 110", HOME_LINE, "1 0 3 16 inf 0 0 0 47 8 10 1"], "line 3", "beyond"),
    (["QGC WPL 110", HOME_LINE, "1 0 3 16 0 0 0 0 47 8 10 0"], "line 3", "autocontinue"),
    (["QGC WPL 110", "0 1 0 16 0 0 0 0 nan 8 488 1"], "line 2", "home position is not finite"),
])
def test_a_broken_waypoint_file_is_refused_in_one_sentence(tmp_path, lines, where, told):
    path = tmp_path / "broken.waypoints"
    path.write_text("\r\n".join(lines))
    with pytest.raises(UserError) as refused:
        read_waypoints(path)
    said = str(refused.value)
    assert said.startswith(f"{path}: {where}")
    assert told in said
    assert said.endswith(".")


NUMBER = re.compile(r"-?\d+(\.\d+)?")
WAYPOINTS = "\n".join(["QGC WPL 110", HOME_LINE, "1 0 3 22 15 0 0 nan 47.001 8.001 10 1",
                       "2 0 2 2000 0 0 1 7 0 0 0 1"])
odd_numbers = st.sampled_from(["NaN", "Infinity", "-1", "1e9", "1e999", "123456789012345678901", "", "null", "[]",
                               '"1"', "147.5", "0.1", "-0"])


@given(text=st.sampled_from([json.dumps(BY_HAND), WAYPOINTS]), at=st.floats(0, 1), number=odd_numbers,
       cut=st.floats(0, 1) | st.none())
def test_a_damaged_file_is_read_or_refused_in_one_sentence(folder, text, at, number, cut):
    spot = list(NUMBER.finditer(text))[round(at * (len(NUMBER.findall(text)) - 1))]
    text = text[:spot.start()] + number + text[spot.end():]
    path = folder / "damaged"
    path.write_text(text if cut is None else text[:round(cut * len(text))])
    for read in (read_plan, read_waypoints):
        try:
            said = f"{path}: {len(read(path).mission)} items."
        except UserError as refused:
            said = str(refused)
        assert said.startswith(f"{path}: ")
        assert said.endswith(".")
        assert "\n" not in said


SWAPPED_VERTEX = [[8.544, 47.396], [8.548, 47.396], [8.548, 47.399]]


@pytest.mark.parametrize(("content", "told"), [
    (edited("mission.plannedHomePosition", [8.54561, 47.39777, 488]), "mission item 0 at latitude 47.3978"),
    (edited("mission.items.0.params", [15, 0, 0, None, 8.5455, 47.3978, 50]), "mission item 0 at latitude 8.5455"),
    (edited("geoFence.polygons.0.polygon", SWAPPED_VERTEX), "fence item 0 at latitude 8.5440, longitude 47.3960 is 5"),
    (edited("rallyPoints.points.0", [8.55, 47.397, 50]), "rally item 0")])
def test_latitude_and_longitude_that_were_swapped_are_noticed(tmp_path, content, told):
    path = tmp_path / "swapped.plan"
    path.write_text(content)
    with pytest.raises(UserError, match=r" km from home; latitude comes first, so swap them or move home\.$") as e:
        read_plan(path)
    assert told in str(e.value)


def test_swapped_waypoints_are_noticed(tmp_path):
    path = tmp_path / "swapped.waypoints"
    path.write_text("\n".join(["QGC WPL 110", HOME_LINE, "1 0 3 16 0 0 0 0 8.001 47.001 10 1"]))
    with pytest.raises(UserError, match=r"mission item 0 at latitude 8\.0010"):
        read_waypoints(path)


@given(noise=st.binary(max_size=200))
def test_noise_is_refused_and_never_a_crash(folder, noise):
    path = folder / "noise"
    path.write_bytes(noise)
    for read in (read_plan, read_waypoints):
        with pytest.raises(UserError, match=str(path)):
            read(path)


@pytest.mark.parametrize("read", [read_plan, read_waypoints])
def test_a_file_too_large_to_be_a_plan_is_not_read(tmp_path, read):
    path = tmp_path / "huge"
    with path.open("wb") as f:
        f.truncate(65 * 2**20)
    with pytest.raises(UserError, match=r"65 MiB are no plan; give a file of at most 64 MiB\."):
        read(path)


VERTEX = item_from_params(0, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, (3, 0, 0, 0, 47, 8, 0), "fence")


@pytest.mark.parametrize(("fence", "rally", "told"), [
    ([VERTEX] * 2, [], "3 vertices is broken off"),
    ([home_item(47, 8, 0)], [], "command 16 is none of a geofence"),
    ([item_from_params(0, 5003, (5, 0, 0, 0, 47, 8, 0), "")] + [VERTEX] * 3, [], "another order"),
    ([], [item_from_params(0, 5100, (0, 0, 0, 0, 47, 8, 500), "")], "than a .plan holds"),
])
def test_what_the_format_cannot_say_is_not_written(tmp_path, fence, rally, told):
    with pytest.raises(ProtocolError, match=told):
        write_plan(tmp_path / "a.plan", FlightPlan(home=home_item(47, 8, 488), mission=[], fence=fence, rally=rally))
    assert not (tmp_path / "a.plan").exists()
