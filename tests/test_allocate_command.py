"""`swarmscan allocate`: files of every kind in, tours out; what is wrong with a file is said in one sentence."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from ground_station.allocate import bench
from ground_station.allocate.command import main
from ground_station.allocate.places import read_places
from ground_station.cli import main as swarmscan
from missions.errors import UserError
from missions.frames import Site

SQUARE = [(0.0, 0.0), (0.0, 30.0), (40.0, 30.0), (40.0, 0.0)]
PLAN_HOME = (41.1, -8.6, 100.0)


def tsplib(folder: Path, points: list[tuple[float, float]], kind: str = "EUC_2D") -> Path:
    rows = [f"{i} {x} {y}" for i, (x, y) in enumerate(points, start=1)]
    path = folder / "square.tsp"
    path.write_text("\n".join(["NAME : square", f"DIMENSION : {len(points)}", f"EDGE_WEIGHT_TYPE : {kind}",
                               "NODE_COORD_SECTION", *rows, "EOF", ""]), encoding="utf-8")
    return path


def plan(folder: Path) -> Path:
    """Two waypoints, one of them inside a survey, and a command that is none."""
    site = Site(PLAN_HOME[0], PLAN_HOME[1], 0.0)

    def item(enu: tuple[float, float, float], command: int = 16, frame: int = 3) -> dict[str, object]:
        lat, lon, up = site.geodetic_from_enu(np.array(enu))
        up += PLAN_HOME[2] if frame == 0 else 0.0
        return {"type": "SimpleItem", "command": command, "frame": frame, "params": [0, 0, 0, None, lat, lon, up]}
    survey = {"type": "ComplexItem", "TransectStyleComplexItem": {"Items": [item((10.0, 20.0, 30.0), frame=0)]}}
    path = folder / "mission.plan"
    path.write_text(json.dumps({"fileType": "Plan", "mission": {
        "plannedHomePosition": PLAN_HOME,
        "items": [item((0.0, 0.0, 5.0), command=22), item((1.0, 2.0, 3.0)), survey]}}), encoding="utf-8")
    return path


def allocated(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, object]:
    assert main([*arguments, "--json"]) == 0
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.parametrize("method", ["swarmscan", "thesis"])
def test_a_closed_tour_from_node_1_of_a_tsplib_file(tmp_path: Path, capsys: pytest.CaptureFixture[str],
                                                    method: str) -> None:
    path = tsplib(tmp_path, SQUARE)
    found = allocated(capsys, str(path), "--vehicles", "1", "--depot", "1", "--closed", "--method", method)
    assert found["makespan"] == pytest.approx(140.0)
    assert found["tours"] in ([[2, 3, 4]], [[4, 3, 2]])
    assert found["lengths"] == [found["makespan"]]
    assert (found["method"], found["unit"], found["left_over"]) == (method, "m", [])


def test_open_tours_end_at_their_last_view_and_free_ones_are_loops(tmp_path: Path,
                                                                   capsys: pytest.CaptureFixture[str]) -> None:
    path = str(tsplib(tmp_path, SQUARE))
    assert allocated(capsys, path, "--vehicles", "1", "--depot", "1")["makespan"] == pytest.approx(100.0)
    assert allocated(capsys, path, "--vehicles", "1")["makespan"] == pytest.approx(140.0)
    assert allocated(capsys, path, "--vehicles", "2")["makespan"] == pytest.approx(60.0)


def test_speeds_and_times_at_views_make_the_makespan_a_time(tmp_path: Path,
                                                            capsys: pytest.CaptureFixture[str]) -> None:
    path = str(tsplib(tmp_path, SQUARE))
    found = allocated(capsys, path, "--vehicles", "1", "--depot", "1", "--closed", "--speed", "2", "--service", "1")
    assert found["makespan"] == pytest.approx(70.0 + 3.0)
    assert found["lengths"] == [pytest.approx(140.0)]
    assert found["unit"] == "s"


def test_lengths_are_exact_unless_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(tsplib(tmp_path, [(0.0, 0.0), (1.0, 1.0)]))
    arguments = (path, "--vehicles", "1", "--depot", "1", "--closed")
    assert allocated(capsys, *arguments)["makespan"] == pytest.approx(2.0 * 2.0**0.5)
    assert allocated(capsys, *arguments, "--rounded")["makespan"] == 2.0


def test_the_cost_with_height_is_equation_4_4(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "views.npz"
    np.savez(path, positions=np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 6.0]]))
    found = allocated(capsys, str(path), "--vehicles", "1", "--cost", "distance_elevation", "--beta", "0.25")
    assert found["makespan"] == pytest.approx(2.0 * (5.0 + 0.25 * 6.0))


def test_a_table_of_waypoints_keeps_its_ids_and_drops_what_was_inserted(tmp_path: Path) -> None:
    path = tmp_path / "trajectories.npz"
    np.savez(path, view_id=np.array([7, -1, 3]), position_enu_m=np.arange(9.0).reshape(3, 3),
             origin_vehicle=np.ones(3, dtype=np.int64), sequence=np.arange(3))
    places = read_places(path)
    assert places.ids == [7, 3]
    assert places.positions_m.tolist() == [[0.0, 1.0, 2.0], [6.0, 7.0, 8.0]]


def test_one_of_several_trajectories_with_y_up_is_chosen_by_key(tmp_path: Path) -> None:
    path = tmp_path / "trajectories.npz"
    np.savez(path, bridge_0=np.zeros((4, 5)), bridge_1=np.array([[1.0, 2.0, 3.0, -30.0, 90.0]]))
    assert read_places(path, "bridge_1").positions_m.tolist() == [[1.0, -3.0, 2.0]]
    with pytest.raises(UserError, match=r"has 2 arrays of positions \(bridge_0, bridge_1\); choose one with --key"):
        read_places(path)
    with pytest.raises(UserError, match="has no array of positions 'tower'"):
        read_places(path, "tower")


def test_waypoints_of_a_qgroundcontrol_plan_stand_relative_to_its_home(tmp_path: Path) -> None:
    places = read_places(plan(tmp_path))
    assert places.ids == [1, 2]
    assert np.allclose(places.positions_m, [[1.0, 2.0, 3.0], [10.0, 20.0, 30.0]], atol=0.011)  # degE7


def test_views_from_csv_keep_their_ids(tmp_path: Path) -> None:
    path = tmp_path / "views.csv"
    path.write_text("view_id,east_m,north_m,up_m,yaw_deg,elevation_deg\n12,1,2,3,0,0\n11,4,5,6,90,-45\n")
    places = read_places(path)
    assert (places.ids, places.positions_m.tolist()) == ([12, 11], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])


@pytest.mark.parametrize(("name", "content", "told"), [
    ("a.tsp", "NAME: a\nEDGE_WEIGHT_TYPE: GEO\nNODE_COORD_SECTION\n1 2 3\nEOF\n", "EDGE_WEIGHT_TYPE is GEO"),
    ("a.tsp", "EDGE_WEIGHT_TYPE: EUC_2D\nNODE_COORD_SECTION\n1 two 3\nEOF\n", "not a well-formed .tsp file"),
    ("a.tsp", "EDGE_WEIGHT_TYPE: EUC_2D\nNODE_COORD_SECTION\n1 2 3\n1 4 5\nEOF\n", "an id occurs twice"),
    ("a.tsp", "EDGE_WEIGHT_TYPE: EUC_2D\nNODE_COORD_SECTION\n1 nan 3\nEOF\n", "not finite"),
    ("a.plan", "{}", "missing required field `fileType`"),
    ("a.npz", "nonsense", "cannot be read"),
    ("a.txt", "", "of no known kind"),
    ("none.csv", None, "cannot be read"),
])
def test_a_bad_file_is_refused_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str,
                                               content: str | None, told: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    assert swarmscan(["allocate", str(path), "--vehicles", "2"]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert str(path) in said


@pytest.mark.parametrize("wrong", [["--depot", "9"], ["--closed"], ["--speed", "1", "2", "3"], ["--speed", "0"],
                                   ["--time-limit", "0"], ["--service", "2"]])
def test_wrong_options_are_refused(tmp_path: Path, wrong: list[str]) -> None:
    with pytest.raises(UserError, match=wrong[0]):
        main([str(tsplib(tmp_path, SQUARE)), "--vehicles", "2", *wrong])


def test_the_benchmark_sets_methods_beside_the_best_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = [(float(x), float(y)) for x, y in itertools.product((0, 10, 20), (0, 10, 20))]
    arguments = [str(tsplib(tmp_path, points)), "--time-limit", "0.05", "--best-known", "square:2=60", "--json"]
    assert bench.main(arguments) == 0
    thesis, ours = json.loads(capsys.readouterr().out)
    assert (thesis["method"], ours["method"], ours["vehicles"], ours["places"]) == ("thesis", "swarmscan", 2, 8)
    assert ours["makespan"] <= thesis["makespan"]
    assert ours["gap_percent"] == pytest.approx(100.0 * (ours["makespan"] / 60.0 - 1.0))
    assert bench.main(arguments[:-1]) == 0
    assert "swarmscan" in capsys.readouterr().out


def test_the_benchmark_measures_every_array_of_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "trajectories.npz"
    rng = np.random.default_rng(1)
    np.savez(path, a=rng.uniform(size=(9, 3)), b=rng.uniform(size=(8, 5)), label=np.arange(3))
    assert bench.main([str(path), "--vehicles", "2", "3", "--time-limit", "0.02", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {(r["name"], r["vehicles"], r["method"]) for r in rows} == set(
        itertools.product("ab", (2, 3), ("thesis", "swarmscan")))


def test_the_benchmark_wants_something_to_measure() -> None:
    with pytest.raises(UserError, match="nothing to measure"):
        bench.main([])
    with pytest.raises(UserError, match="write NAME:M=MAKESPAN"):
        bench.main(["--growth", "--best-known", "eil51=3"])
