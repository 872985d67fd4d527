"""What watchers are told, what the page makes of it, and what operators' marks do to maps and views."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ground_station.live import panel
from ground_station.live.framing import MARGIN, stand_back
from ground_station.live.model import LiveModel
from ground_station.live.sightings import Sightings
from ground_station.live.surface import STEPS, open_faces
from ground_station.live.synthetic import SyntheticMission
from ground_station.live.trail import CORNER_M, MOST_CORNERS, Trail
from ground_station.regions import Regions
from missions import live
from missions.camera import Camera, Pose
from missions.grid import FREE, OCCUPIED, UNKNOWN, VoxelGrid
from missions.live import LivePicture, LiveUpdate, MarkRegion, OperatorCommand
from missions.messages import SiteBrief, vector
from missions.mission import Mission, SiteSpec
from missions.pads import fence_limit, geofence
from planning.nbv.interest import Interest

SITE = SiteBrief(object_min_enu_m=(-4.0, -3.0, 0.0), object_max_enu_m=(4.0, 3.0, 7.0), ground_up_m=0.0)
MISSION = Mission(title="t")
ACTIONS: list[live.AnyAction] = [
    live.Start(), live.Pause(), live.Resume(vehicle_id=2), live.Home(), live.Land(vehicle_id=1),
    live.Drop(vehicle_id=1), live.Add(vehicle_id=1), live.Abort(), live.ClearRegion(region_id=4),
    live.MoveFence(lower_enu_m=(0.0, 0.0, 0.0), upper_enu_m=(1.0, 1.0, 1.0)), live.SetGoal(coverage=0.9),
    live.SetSpeed(speed=8.0),
    live.MarkRegion(kind="important", lower_enu_m=(0.0, 0.0, 0.0), upper_enu_m=(1.0, 1.0, 1.0))]
OPERATING = Path(__file__).parents[1] / "docs" / "operating.md"
Cells = st.sets(st.tuples(*3 * [st.integers(0, 5)]), min_size=1, max_size=40)


@pytest.mark.parametrize("action", ACTIONS, ids=lambda a: type(a).__name__)
def test_commands_are_plain_json_that_says_what_to_do(action: live.AnyAction) -> None:
    text = msgspec.json.encode(OperatorCommand(command_id="x", action=action))
    assert msgspec.json.decode(text, type=OperatorCommand).action == action
    assert msgspec.json.decode(text)["action"]["do"] == type(action).__struct_config__.tag


def updates(mission: SyntheticMission) -> LiveModel:
    with mission.reading() as model:
        return model


def test_differences_add_up_to_the_whole(tmp_path: Path) -> None:
    mission = SyntheticMission(3, tmp_path)
    for _ in range(200):
        mission.step()
    model = updates(mission)
    assert model.state is not None
    assert model.state.t_s == pytest.approx(mission.t_s, abs=0.3)
    assert len(model.solid) > 1000
    assert len(model.pictures) == model.state.pictures + 3
    for k, trail in model.trails.items():
        last = next(v for v in model.state.vehicles if v.vehicle_id == k)
        assert trail.points[-1] == last.position_enu_m
        assert len(trail.corners) < 60


def test_a_gap_is_noticed_and_a_whole_update_mends_it(tmp_path: Path) -> None:
    mission = SyntheticMission(1, tmp_path)
    known = updates(mission)
    assert known.site is not None
    assert known.state is not None
    late = LiveUpdate(seq=known.seq + 2, whole=False, site=known.site, state=known.state)
    assert not known.apply(late)
    assert known.apply(msgspec.structs.replace(late, whole=True))
    assert (known.seq, known.pictures, known.solid) == (late.seq, [], set())


Steps = st.lists(st.tuples(*3 * [st.sampled_from([0.0, 0.4, 1.0])]), min_size=1, max_size=60)


@given(Steps)
def test_a_trail_passes_wherever_the_vehicle_was(steps: list[tuple[float, float, float]]) -> None:
    flown = np.cumsum(steps, axis=0)
    trail = Trail()
    for place in flown:
        trail.extend([vector(place)])
    line = np.array(trail.points if len(trail) > 1 else trail.points * 2)
    starts, along = line[:-1], np.diff(line, axis=0)
    offset = flown[:, None] - starts
    share = np.clip((offset * along).sum(axis=2) / np.maximum((along * along).sum(axis=1), 1e-12), 0.0, 1.0)
    beside = np.linalg.norm(offset - share[:, :, None] * along, axis=2).min(axis=1)
    assert beside.max() <= CORNER_M + 1e-6
    assert trail.points[-1] == vector(flown[-1])


def test_a_long_trail_does_not_grow_and_keeps_its_sharpest_corners() -> None:
    trail, sharp = Trail(), (0.0, 50.0, 0.0)
    trail.extend([(0.0, 0.0, 0.0), sharp])
    for n in range(40 * MOST_CORNERS):
        trail.extend([(float(n % 2), 0.0, float(n))])
        assert len(trail.corners) <= MOST_CORNERS
    assert trail.corners[0] == (0.0, 0.0, 0.0)
    assert sharp in trail.corners
    assert [z for _, _, z in trail.corners[2:]] == sorted(z for _, _, z in trail.corners[2:])


@given(Cells)
def test_the_surface_is_what_lies_open(cells: set[tuple[int, int, int]]) -> None:
    index = np.array(sorted(cells))
    faces = open_faces(index, np.zeros((len(index), 3), dtype=np.uint8), 0.5, 10_000)
    drawn = {(*index[c].tolist(), int(f)) for c, f in zip(faces.cube, faces.facing, strict=True)}
    open_ = {(*cell, f) for cell in cells for f, step in enumerate(STEPS.tolist())
             if tuple(np.add(cell, step).tolist()) not in cells}
    assert drawn == open_
    total = sum(len(triangles) for _, _, triangles, _ in faces.blocks(np.zeros(3)))
    assert total == 2 * len(open_)


@given(Cells, st.integers(6, 60))
def test_the_surface_is_thinned_to_what_is_allowed_and_still_covers_everything(cells: set[tuple[int, int, int]],
                                                                               most: int) -> None:
    index = np.array(sorted(cells))
    faces = open_faces(index, np.full((len(index), 3), 90, dtype=np.uint8), 0.5, most)
    assert len(faces.cube) <= most
    factor = round(faces.voxel_m / 0.5)
    assert {tuple(c) for c in (index // factor).tolist()} == {tuple(c) for c in faces.index.tolist()}
    assert (faces.colour == 90).all()


def wall(x: int) -> NDArray[np.int64]:
    return np.array([(x, j, k) for j in range(12) for k in range(12)])


def picture(view_id: int, phase: str, x_m: float, yaw_rad: float) -> LivePicture:
    return LivePicture(vehicle_id=1, view_id=view_id, phase=phase, t_s=0.0, file="",
                       pose=Pose((x_m, 3.0, 3.0), yaw_rad, 0.0), camera=Camera.from_diagonal_fov(456, 256, 84.0))


def test_pictures_count_where_nothing_stands_before() -> None:
    index = np.concatenate([wall(10), wall(20)])
    centers = 0.5 * (index + 0.5)
    pictures = [picture(1, "explore", 0.0, 0.0), picture(2, "survey", 0.0, 0.0), picture(3, "survey", 15.0, np.pi)]
    sightings = Sightings()
    sightings.take(index, centers, pictures[:1], 0.5, {"explore": 25.0, "survey": 25.0})
    sightings.take(index, centers, pictures, 0.5, {"explore": 25.0, "survey": 25.0})
    front, back = sightings.count[:144], sightings.count[144:]
    middle = (np.abs(wall(10)[:, 1:] - 5.5) < 3).all(axis=1)
    assert (front[middle] == (2, 1)).all()
    assert (back[middle] == (1, 1)).all()
    assert [p.view_id for p in sightings.seen_by(np.array([5.0, 3.0, 3.0]))] == [1, 2]
    assert [p.view_id for p in sightings.seen_by(np.array([10.4, 3.0, 3.0]))] == [3]


def test_voxels_that_come_later_are_counted_in_earlier_pictures() -> None:
    first, both = wall(10)[:60], wall(10)
    pictures, ranges = [picture(1, "explore", 0.0, 0.0)], {"explore": 25.0}
    late, early = Sightings(), Sightings()
    late.take(first, 0.5 * (first + 0.5), pictures, 0.5, ranges)
    late.take(both, 0.5 * (both + 0.5), pictures, 0.5, ranges)
    early.take(both, 0.5 * (both + 0.5), pictures, 0.5, ranges)
    assert np.array_equal(late.count, early.count)


def test_the_page_says_what_it_must(tmp_path: Path) -> None:
    model = updates(SyntheticMission(2, tmp_path))
    assert model.site is not None
    assert model.state is not None
    head = panel.mission_html(model.site, model.state, model.curve)
    assert "Exploring" in head
    assert "Waiting for Start" in panel.mission_html(
        model.site, msgspec.structs.replace(model.state, started=False), [])
    cards = panel.vehicles_html(model.site, model.state.vehicles)
    assert 'data-vehicle="2">flying' in cards
    held = msgspec.structs.replace(model.state.vehicles[0], held=True)
    assert 'data-vehicle="1">paused' in panel.vehicles_html(model.site, [held])
    alarm = live.LiveAlarm(name="says", severity="warning", text="Vehicle 1 says: <b>.", vehicle_id=1)
    assert "&lt;b&gt;" in panel.alarms_html([alarm])
    assert "All is well" in panel.alarms_html([])


def test_the_operators_page_explains_every_alarm() -> None:
    rows = [line.split("|") for line in OPERATING.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    explained = {cells[1].strip().strip("`"): cells[3:5] for cells in rows}
    assert set(get_args(live.AlarmName)) <= set(explained)
    assert all(len(cell.strip()) > 10 for name in get_args(live.AlarmName) for cell in explained[name])


# --- what operators mark --------------------------------------------------------------------------------------------


def grid() -> VoxelGrid:
    space = VoxelGrid.unknown(*geofence(MISSION, SITE), 0.5)
    space.state[:] = FREE
    space.state[30:40, 30:40, :10] = OCCUPIED
    return space


def mark(regions: Regions, kind: str, lower: tuple[float, float, float], upper: tuple[float, float, float],
         **vehicles: tuple[float, float, float]) -> str:
    at = {int(k[1:]): np.array(p) for k, p in vehicles.items()}
    return regions.mark(MarkRegion(kind=kind, lower_enu_m=lower, upper_enu_m=upper), at)  # type: ignore[arg-type]


def test_without_marks_a_map_stays_the_very_same() -> None:
    space, regions = grid(), Regions(MISSION, SITE)
    assert regions.applied(space) is space
    assert mark(regions, "important", (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)) == ""
    assert regions.applied(space) is space


@settings(max_examples=15, deadline=None)
@given(st.tuples(*3 * [st.floats(-8.0, 8.0)]), st.tuples(*3 * [st.floats(0.3, 6.0)]))
def test_nothing_free_is_left_in_what_is_forbidden_and_nothing_else_changes(low: tuple[float, float, float],
                                                                            size: tuple[float, float, float]) -> None:
    space, regions = grid(), Regions(MISSION, SITE)
    lower = np.array(low) + np.array([0.0, 5.0, 8.0])
    upper = lower + size
    assert mark(regions, "forbidden", tuple(lower.tolist()), tuple(upper.tolist())) == ""
    after = regions.applied(space)
    centers = space.centers(np.argwhere(space.state >= 0)).reshape(*space.state.shape, 3)
    touched = ((centers + 0.25 - 1e-6 > lower) & (centers - 0.25 + 1e-6 < upper)).all(axis=3)
    beside = ((centers + 0.25 + 1e-6 < lower) | (centers - 0.25 - 1e-6 > upper)).any(axis=3)
    assert (after.state[touched] != FREE).all()
    assert (after.state[beside] == space.state[beside]).all()
    assert ((after.state == OCCUPIED) == (space.state == OCCUPIED)).all()
    assert regions.clear(1) == ""
    assert regions.applied(space) is space


def test_what_would_trap_a_vehicle_is_refused() -> None:
    regions = Regions(MISSION, SITE)
    x, y, z = (float(c) for c in Regions(MISSION, SITE)._columns[1][0] + 0.5)
    assert "vehicle 2 takes off and lands there" in mark(regions, "forbidden", (x, y, z), (x + 1.0, y + 1.0, z + 1.0))
    box = (0.0, 5.0, 8.0), (4.0, 9.0, 12.0)
    assert "vehicle 1 is there" in mark(regions, "forbidden", *box, v1=(2.0, 7.0, 10.0))
    assert "below its upper one" in mark(regions, "important", box[1], box[0])
    assert regions.clear(9) == "there is no region 9"
    assert regions.marked == []


def test_the_fence_is_drawn_in_and_out_again() -> None:
    space, regions = grid(), Regions(MISSION, SITE)
    lower, upper = geofence(MISSION, SITE)
    low, high, out = vector(lower), vector(upper), vector(upper + 1.0)
    inner = vector(upper - [0.0, 3.0, 5.0])
    assert "the mission allows no more" in regions.against_fence(low, out, {})
    assert "vehicle 1 would be outside" in regions.against_fence(low, inner, {1: upper - 1.0})
    assert "pads" in regions.against_fence(vector(lower + 8.0), high, {})
    assert regions.against_fence(low, inner, {}) == ""
    regions.move_fence(low, inner)
    after = regions.applied(space)
    centers = space.centers(np.argwhere(after.state == FREE))
    assert (centers + 0.25 <= np.array(inner) + 1e-6).all()
    assert (after.state[:, :, -4:] == UNKNOWN).all()
    regions.move_fence(low, high)
    assert regions.applied(space) is space


def test_where_the_mission_leaves_room_what_lies_beyond_its_fence_stays_closed_until_the_fence_is_there() -> None:
    mission = Mission(title="t", site=SiteSpec(geofence_room_m=4.0))
    regions, (least, most) = Regions(mission, SITE), fence_limit(mission, SITE)
    lower, upper = geofence(mission, SITE)
    space = VoxelGrid.unknown(least, most, 0.5)
    space.state[:] = FREE
    centers = space.centers(np.argwhere(regions.applied(space).state == FREE))
    assert (centers > lower).all()
    assert (centers < upper).all()
    wide = vector(least), vector(most)
    assert regions.against_fence(*wide, {}) == ""
    assert regions.beyond_board(*wide)
    regions.accept(*wide)
    regions.move_fence(*wide)
    assert not regions.beyond_board(*wide)
    assert regions.applied(space) is space


def test_what_is_important_counts_more() -> None:
    interest = Interest(np.array([[0.0, 0.0, 0.0]]), np.array([[1.0, 1.0, 1.0]]))
    assert interest.weights_at(np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]])).tolist() == [interest.weight, 1.0]


@given(st.lists(st.tuples(*[st.floats(-60.0, 60.0)] * 3), min_size=1, max_size=5), st.floats(0.4, 2.5))
def test_a_camera_that_steps_back_has_everything_in_its_picture_and_looks_where_it_looked(
        places: list[tuple[float, float, float]], aspect: float) -> None:
    position, look_at, up, fov_rad = np.array([29.0, -56.0, 39.0]), np.array([0.0, -4.0, 8.0]), np.eye(3)[2], 1.3
    there = stand_back(position, look_at, up, fov_rad, aspect, np.array(places))
    away, before = there - look_at, position - look_at
    assert np.linalg.norm(away) >= np.linalg.norm(before) - 1e-9
    assert np.allclose(np.cross(away, before), 0.0, atol=1e-6 * np.linalg.norm(away) * np.linalg.norm(before))
    ahead = -away / np.linalg.norm(away)
    right = np.cross(ahead, up) / np.linalg.norm(np.cross(ahead, up))
    seen = (np.array(places) - there) @ np.stack([right, np.cross(right, ahead), ahead], axis=1)
    half = np.tan(0.5 * fov_rad) * MARGIN * (1.0 + 1e-6) * seen[:, 2]
    assert (np.abs(seen[:, 0]) <= half * aspect + 1e-6).all()
    assert (np.abs(seen[:, 1]) <= half + 1e-6).all()
