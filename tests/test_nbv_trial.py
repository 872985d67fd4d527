"""Trials of next-best-view methods: what is covered, what collides, and that oracles bound what methods reach."""

from __future__ import annotations

import io
import json
from functools import cache
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.camera import Pose
from missions.errors import ProtocolError, UserError
from missions.frames import Array
from missions.nbv_trial import Answer, Ask, Choice, Failure, Frame, read_from_method, read_to_method, write_message
from missions.pose_lattice import AXIS_STEPS, STEPS, UNREACHED, Index5, PoseLattice, fewest_steps, way_back
from sim_bridge.coverage import TOLERANCE_M, in_frame
from sim_bridge.nbv.arena import Arena
from sim_bridge.nbv.bench import main
from sim_bridge.nbv.campaign import Campaign, Row, Run, play_in
from sim_bridge.nbv.clearance import segments_clear
from sim_bridge.nbv.oracles import ORACLES, Oracle
from sim_bridge.nbv.player import Player
from sim_bridge.nbv.rules import sensing_range_m
from sim_bridge.nbv.score import Score
from sim_bridge.nbv.trial import Record, Trial
from tests.nbv_scene import HALF_M, RULES, cube_arena

Shape = tuple[int, int, int, int, int]
SHAPES = st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 4), st.integers(1, 3), st.integers(4, 6))
CAMPAIGN = Campaign(RULES, {}, 1, 600.0)
TRUE_BOX = np.array([[-HALF_M, -HALF_M, 0.0], [HALF_M, HALF_M, 2.0 * HALF_M]])


@cache
def arena() -> Arena:
    return cube_arena()


def lattice_of(shape: Shape) -> PoseLattice:
    return PoseLattice((0.0, 0.0, 0.0), (8.0, 6.0, 4.0), shape[:3], (-30.0, 0.0, 30.0)[:shape[3]], shape[4])


@settings(max_examples=25, deadline=None)
@given(SHAPES)
def test_steps_change_one_axis_and_at_most_one_angle_and_can_be_taken_back(shape: Shape) -> None:
    lattice = lattice_of(shape)
    flat, k = np.nonzero(lattice.steps != UNREACHED)
    to = lattice.steps[flat, k]
    change = np.stack(np.unravel_index(to, shape), axis=-1) - np.stack(np.unravel_index(flat, shape), axis=-1)
    assert (np.abs(change[:, :3]).sum(axis=1) == 1).all()
    assert (change[:, :4] == STEPS[k, :4]).all()
    assert ((change[:, 4] - STEPS[k, 4]) % shape[4] == 0).all()
    assert (lattice.steps[to] == flat[:, None]).any(axis=1).all()


@settings(max_examples=25, deadline=None)
@given(SHAPES)
def test_legs_end_at_the_position_beside_or_nowhere(shape: Shape) -> None:
    lattice = lattice_of(shape)
    at, k = np.nonzero(lattice.leg_ends != UNREACHED)
    change = np.stack(np.unravel_index(lattice.leg_ends[at, k], shape[:3]), axis=-1)
    change -= np.stack(np.unravel_index(at, shape[:3]), axis=-1)
    assert (change == np.array(AXIS_STEPS)[k]).all()
    assert len(at) == 2 * sum(len(lattice.legs(axis)[0]) for axis in range(3))


@settings(max_examples=25, deadline=None)
@given(SHAPES, st.integers(0, 10**6), st.integers(0, 10**6))
def test_a_way_has_as_many_steps_as_were_counted(shape: Shape, a: int, b: int) -> None:
    lattice = lattice_of(shape)
    start, goal = a % len(lattice), b % len(lattice)
    distance = fewest_steps(lattice.steps, start)
    if distance[goal] <= 0:
        return
    way = [start, *way_back(lattice.steps, distance, goal)]
    assert len(way) == distance[goal] + 1
    assert way[-1] == goal
    assert all(lattice.index(there) in lattice.neighbours(lattice.index(here)) for here, there in pairwise(way))


def test_a_pose_stands_in_the_middle_of_its_cell_and_looks_where_its_angles_say() -> None:
    lattice = PoseLattice((0.0, 10.0, 2.0), (8.0, 16.0, 4.0), (4, 3, 1), (-60.0, 0.0), 8)
    pose = lattice.pose((3, 1, 0, 0, 2))
    assert pose.position_enu_m == pytest.approx((7.0, 13.0, 3.0))
    assert (pose.yaw_enu_rad, pose.elevation_rad) == pytest.approx((np.pi / 2.0, -np.pi / 3.0))
    flat = lattice.flat((3, 1, 0, 0, 2))
    assert lattice.positions_enu_m[flat // lattice.orientations] == pytest.approx(pose.position_enu_m)
    assert lattice.yaw_elevation_rad[flat % lattice.orientations] == pytest.approx((np.pi / 2.0, -np.pi / 3.0))


def test_messages_arrive_as_they_were_sent() -> None:
    rgb = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    pose = Pose((1.0, 2.0, 3.0), 0.5, -0.5)
    brief = arena().brief("random", 0, 2, {"a": "b"})
    stream = io.BytesIO()
    for message in (brief, Frame(vehicle=1, pose=pose, index=(1, 2, 3, 4, 5), rgb=rgb),
                    Ask(vehicle=2, candidates=[(0, 0, 0, 0, 1)])):
        write_message(stream, message)
    stream.seek(0)
    assert read_to_method(stream) == brief
    frame = read_to_method(stream)
    assert isinstance(frame, Frame)
    assert (frame.pose, frame.index) == (pose, (1, 2, 3, 4, 5))
    assert (frame.rgb == rgb).all()
    assert read_to_method(stream) == Ask(vehicle=2, candidates=[(0, 0, 0, 0, 1)])
    assert read_to_method(stream) is None


def test_what_is_no_message_is_refused() -> None:
    stream = io.BytesIO()
    write_message(stream, Failure(reason="no"))
    stream.seek(0)
    with pytest.raises(ProtocolError):
        read_to_method(stream)
    with pytest.raises(ProtocolError, match="announced"):
        read_from_method(io.BytesIO(b"\xff\xff\xff\xff"))


def test_every_view_sees_exactly_the_points_of_the_cube_that_face_it() -> None:
    a = arena()
    points, middle = a.points_enu_m, np.array([0.0, 0.0, HALF_M])
    on_face = (np.abs(points - middle) < HALF_M - 1.5 * TOLERANCE_M).sum(axis=1) == 2
    normal = np.where(np.abs(points - middle) > HALF_M - 1e-6, np.sign(points - middle), 0.0)
    seen = np.unpackbits(a.seen.view(np.uint8), axis=1)[:, :len(points)].astype(bool)
    for flat in range(0, len(a.lattice), 7):
        pose = a.lattice.pose(a.lattice.index(flat))
        away = points - np.array(pose.position_enu_m)
        expected = (in_frame(away @ pose.enu_from_camera, a.camera) & (np.einsum("ij,ij->i", away, normal) < 0)
                    & (np.linalg.norm(away, axis=1) <= sensing_range_m(a.scene)))
        expected &= a.standable[flat // a.lattice.orientations]
        assert (seen[flat] == expected)[on_face].all()
    assert seen.any()


def test_nobody_stands_within_the_clearance_and_free_legs_join_all_who_stand() -> None:
    a = arena()
    beyond = np.maximum(np.abs(a.lattice.positions_enu_m - TRUE_BOX.mean(axis=0)) - HALF_M, 0.0)
    room = np.minimum(np.linalg.norm(beyond, axis=1), a.lattice.positions_enu_m[:, 2])
    assert (a.standable == (room >= RULES.fleet.clearance_m)).all()
    assert a.standable.sum() >= RULES.positions
    start = a.lattice.flat(a.starts(0, 1)[0])
    reached = (fewest_steps(a.steps, start) != UNREACHED).reshape(-1, a.lattice.orientations).any(axis=1)
    assert (reached == a.standable).all()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-8.0, 8.0)] * 6), min_size=1, max_size=8), st.floats(0.05, 1.5))
def test_a_leg_is_clear_when_it_keeps_its_radius_from_the_cube_and_the_ground(legs: list[Array], radius: float) -> None:
    ends = np.array(legs).reshape(-1, 2, 3) + np.array([0.0, 0.0, 9.0])
    along = ends[:, :1] + np.linspace(0.0, 1.0, 801)[:, None] * (ends[:, 1:] - ends[:, :1])
    inwards = np.abs(along - TRUE_BOX.mean(axis=0)) - HALF_M
    to_cube = np.where((inwards < 0).all(axis=-1), -inwards.max(axis=-1),
                       np.linalg.norm(np.maximum(inwards, 0.0), axis=-1))
    room = np.minimum(to_cube, along[..., 2]).min(axis=1)
    clear = segments_clear(arena().truth, ends[:, 0], ends[:, 1], radius)
    sure = np.abs(room - radius) > 0.03
    assert (clear == (room >= radius))[sure].all()


class _Fixed:
    """Flies a given way."""

    wants_pictures = False

    def __init__(self, way: list[Index5]) -> None:
        self.way = way

    def see(self, frame: Frame) -> None:
        raise AssertionError("no pictures were asked for")

    def choose(self, ask: Ask) -> Answer:
        return Answer(choice=Choice(vehicle=ask.vehicle, index=self.way.pop(0)), seconds_seeing=0.0,
                      seconds_choosing=0.0, peak_memory_mib=0.0)


def flown(start: Index5, way: list[Index5]) -> Score:
    a = arena()
    brief = msgspec.structs.replace(a.brief("fixed", 0, 1, {}), starts=[start], poses=len(way) + 1)
    score = Score(a)
    Trial(brief, score, _Fixed(list(way)), None).run([start])
    return score


def test_flight_through_the_cube_is_counted_and_shows_nothing_from_within() -> None:
    nx, ny, _ = arena().lattice.shape
    row = [(x, ny // 2, 0, 2, 0) for x in range(nx)]
    score = flown(row[0], row[1:])
    walls = [arena().lattice.pose(index).position_enu_m[0] for index in row]
    through_a_wall = sum((abs(a) < HALF_M) != (abs(b) < HALF_M) for a, b in pairwise(walls))
    assert score.collisions == through_a_wall > 0
    inside = sum(abs(x) < HALF_M + RULES.fleet.clearance_m for x in walls)
    assert score.unsafe_views == inside > 0
    assert score.curve[1:1 + inside] == [score.curve[0]] * inside
    assert score.metres[-1] == pytest.approx(walls[-1] - walls[0])


def test_a_pilot_that_leaves_the_lattice_is_refused() -> None:
    with pytest.raises(ProtocolError, match="not a candidate"):
        flown((0, 0, 0, 0, 0), [(2, 0, 0, 0, 0)])


def oracle(name: str, vehicles: int = 1, start: int = 0) -> tuple[Record, Trial]:
    a = arena()
    brief, score = a.brief(name, start, vehicles, {}), Score(a)
    trial = Trial(brief, score, Oracle(a, score, brief.starts, ORACLES[name]), None)
    return trial.run([a.step_before(s, start) for s in brief.starts]), trial


@pytest.mark.parametrize("vehicles", [1, 4])
@pytest.mark.parametrize("name", list(ORACLES))
def test_oracles_never_collide_and_coverage_only_grows_up_to_the_ceiling(name: str, vehicles: int) -> None:
    score = oracle(name, vehicles)[0].score
    assert len(score.curve) == len(score.seconds) == RULES.poses
    assert (np.diff(score.curve) >= 0.0).all()
    assert (np.diff(score.seconds) >= 0.0).all()
    assert score.curve[-1] <= arena().ceiling
    assert (score.collisions, score.unsafe_views) == (0, 0)
    assert score.curve[-1] > score.curve[vehicles - 1]


def test_looking_ahead_is_never_far_behind_and_four_vehicles_are_faster() -> None:
    finals = {name: oracle(name)[0].score.curve[-1] for name in ORACLES}
    assert finals["beam_oracle"] > 0.95 * finals["greedy_oracle"]
    assert oracle("greedy_oracle", 4)[0].score.seconds[-1] < 0.5 * oracle("greedy_oracle")[0].score.seconds[-1]


class _Watched(Oracle):
    """An oracle that looks at what it is asked; `patience` of its first answers are to wait."""

    def __init__(self, score: Score, starts: list[Index5], patience: int = 0) -> None:
        super().__init__(arena(), score, starts, ORACLES["greedy_oracle"])
        self.places, self.patience, self.asked = dict(enumerate(starts, 1)), patience, 0
        self.arrived: list[int] = []
        """Key poses flown when each question came."""

    def choose(self, ask: Ask) -> Answer:
        self.asked += 1
        self.arrived.append(len(self._score.curve))
        others = {index[:3] for vehicle, index in self.places.items() if vehicle != ask.vehicle}
        assert not others & {index[:3] for index in ask.candidates}
        if self.asked <= self.patience:
            stay = Choice(vehicle=ask.vehicle, index=self.places[ask.vehicle])
            return Answer(choice=stay, seconds_seeing=0.0, seconds_choosing=0.0, peak_memory_mib=0.0)
        answer = super().choose(ask)
        self.places[ask.vehicle] = answer.choice.index
        return answer


def watched(vehicles: int, patience: int) -> tuple[Score, _Watched]:
    record, pilot = watched_record(vehicles, patience, RULES.poses)
    return record.score, pilot


def watched_record(vehicles: int, patience: int, poses: int) -> tuple[Record, _Watched]:
    brief, score = msgspec.structs.replace(arena().brief("watched", 0, vehicles, {}), poses=poses), Score(arena())
    pilot = _Watched(score, brief.starts, patience)
    return Trial(brief, score, pilot, None).run(brief.starts), pilot


def test_in_step_every_decision_is_one_for_the_whole_fleet() -> None:
    a = cube_arena(msgspec.structs.replace(RULES, in_step=True, poses=16))
    brief, score = a.brief("greedy_oracle", 0, 4, {}), Score(a)
    record = Trial(brief, score, Oracle(a, score, brief.starts, ORACLES["greedy_oracle"]), None).run(brief.starts)
    assert [n for n in record.rounds if n] == [4, 4, 4]
    assert len(set(score.seconds)) == 4


def test_who_arrive_together_are_all_seen_before_any_is_sent_on() -> None:
    record, pilot = watched_record(4, 0, 60)
    seconds, rounds = np.array(record.score.seconds), [n for n in record.rounds if n]
    assert sum(rounds) == len(record.answers)
    assert max(rounds[1:]) > 1
    for arrived in pilot.arrived:
        assert arrived == len(seconds) or seconds[arrived] > seconds[arrived - 1]


def test_no_vehicle_is_offered_a_place_that_another_holds_or_flies_to() -> None:
    score, pilot = watched(4, 0)
    assert (len(score.curve), pilot.asked) == (RULES.poses, RULES.poses - 4)


def test_who_waits_is_asked_again_when_somebody_has_arrived() -> None:
    score, pilot = watched(2, 1)
    assert len(score.curve) == RULES.poses
    assert pilot.asked == RULES.poses - 2 + 1
    alone, _ = watched(1, 1)
    assert len(alone.curve) == 1


def test_starts_are_distinct_and_the_first_vehicle_s_does_not_depend_on_the_fleet() -> None:
    starts = [arena().starts(n, 4) for n in range(6)]
    assert len({s[0] for s in starts}) == 6
    assert all(len({index[:3] for index in s}) == 4 for s in starts)
    assert [arena().starts(n, 1) for n in range(6)] == [s[:1] for s in starts]
    assert [cube_arena().starts(n, 4) for n in range(6)] == starts


@cache
def played(method: str) -> Row:
    return play_in(arena(), Run("cube", method, 0, 1), CAMPAIGN)


@pytest.mark.parametrize("method", ["random", "frontier", "volumetric"])
def test_a_method_in_its_own_process_stays_below_oracle_and_ceiling(method: str) -> None:
    row, best = played(method), max(oracle(name)[0].score.curve[-1] for name in ORACLES)
    assert len(row.curve) == len(row.visited) == RULES.poses
    assert (np.diff(row.curve) >= 0.0).all()
    assert 0.0 < row.curve[0] <= row.final <= best <= row.ceiling
    assert row.auc == pytest.approx(np.mean(row.curve), abs=1e-4)
    assert row.seconds_per_decision > 0.0
    assert 50.0 < row.peak_memory_mib < 500.0
    assert all(0.0 <= e <= 1.0 for e in row.estimates)


def test_the_same_run_flies_the_same_way_again() -> None:
    again = play_in(arena(), Run("cube", "random", 0, 1), CAMPAIGN)
    assert (again.visited, again.curve) == (played("random").visited, played("random").curve)


def test_a_method_that_is_unknown_or_dies_says_so() -> None:
    with pytest.raises(UserError, match=r"there is no method 'best'.*frontier"), \
            Player(arena().brief("best", 0, 1, {}), 1, 600.0) as player:
        player.choose(Ask(vehicle=1, candidates=[(0, 0, 0, 0, 0)]))
    brief = msgspec.structs.replace(arena().brief("random", 0, 1, {}), sensing_range_m=0.0)
    with pytest.raises(ProtocolError, match=r"(?s)ended with code 1.*ZeroDivisionError"), \
            Player(brief, 1, 600.0) as player:
        player.choose(Ask(vehicle=1, candidates=[(0, 0, 0, 0, 0)]))


def test_a_method_that_hangs_is_ended_and_the_sentence_says_so() -> None:
    with pytest.raises(ProtocolError, match=r"random gave no answer within 0\.01 s.*--patience"), \
            Player(arena().brief("random", 0, 1, {}), 1, 0.01) as player:
        player.choose(Ask(vehicle=1, candidates=[(0, 0, 0, 0, 0)]))


def test_the_benchmark_runs_on_a_file_and_leaves_rows_and_a_page(tmp_path: Path,
                                                                capsys: pytest.CaptureFixture[str]) -> None:
    trimesh.creation.box(bounds=TRUE_BOX).export(tmp_path / "cube.stl")
    assert main(["--scenes", str(tmp_path / "cube.stl"), "--methods", *ORACLES, "--starts", "2", "--poses", "6",
                 "--positions", "30", "--vehicles", "1", "2", "--jobs", "1", "--html", str(tmp_path / "page.html"),
                 "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [(r["vehicles"], r["method"], r["start"]) for r in rows] == [
        (v, m, s) for v in (1, 2) for m in ORACLES for s in (0, 1)]
    wanted = {"scene", "method", "start", "vehicles", "auc", "final", "ceiling", "collisions", "metres",
              "seconds_per_decision", "peak_memory_mib", "curve"}
    assert all(wanted <= set(r) and r["scene"] == "cube" for r in rows)
    page = (tmp_path / "page.html").read_text()
    assert page.count("Plotly.newPlot") == 6
    assert "greedy_oracle" in page


@pytest.mark.parametrize(("words", "told"), [
    (["--scenes", "nowhere"], "nowhere"), (["--scenes", "nowhere.glb"], "no such file"),
    (["--scenes", "family:none:1"], "family"), (["--starts", "0"], "--starts"), (["--vehicles", "0"], "--vehicles"),
    (["--option", "fast"], "NAME=VALUE"), (["--diagonal-fov-deg", "5"], "--diagonal-fov-deg"),
    (["--patience", "0"], "--patience")])
def test_wrong_input_is_refused_in_a_sentence(words: list[str], told: str) -> None:
    with pytest.raises(UserError, match=told):
        main(["--methods", "greedy_oracle", *words])


def test_a_campaign_that_was_broken_off_repeats_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows, words = tmp_path / "rows.jsonl", ["--methods", "greedy_oracle", "--poses", "4", "--jobs", "1", "--json"]
    trimesh.creation.box(bounds=TRUE_BOX).export(tmp_path / "cube.stl")
    scene = ["--scenes", str(tmp_path / "cube.stl"), "--positions", "30", "--rows", str(rows)]
    main([*scene, *words, "--starts", "1"])
    first = json.loads(capsys.readouterr().out)["rows"]
    written = rows.read_bytes()
    main([*scene, *words, "--starts", "2"])
    both = json.loads(capsys.readouterr().out)["rows"]
    assert both[0] == first[0]
    assert rows.read_bytes().startswith(written)
    assert len(rows.read_bytes().splitlines()) == len(both) == 2
    rows.write_text("{}\n")
    with pytest.raises(UserError, match="not rows"):
        main([*scene, *words])


def test_a_scene_without_room_for_the_lattice_or_the_starts_is_refused() -> None:
    with pytest.raises(UserError, match="no 5000 positions are free"):
        cube_arena(msgspec.structs.replace(RULES, positions=5000))
    with pytest.raises(UserError, match="not enough views"):
        arena().starts(10**6, 1)
    with pytest.raises(UserError, match="not enough views"):
        arena().starts(0, 1000)
