"""The path benchmarks run on given files and tell planners apart."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import trimesh

from ground_station.bench.path_worlds import PASSAGES
from ground_station.bench.paths import main
from missions.errors import UserError
from vehicle.replan_bench import main as replan


@pytest.fixture
def portal(tmp_path: Path) -> Path:
    """Two posts and a beam."""
    parts = [((-6.0, -0.5, 0.0), (-5.0, 0.5, 8.0)), ((5.0, -0.5, 0.0), (6.0, 0.5, 8.0)),
             ((-6.0, -0.5, 8.0), (6.0, 0.5, 9.0))]
    trimesh.util.concatenate([trimesh.creation.box(bounds=p) for p in parts]).export(tmp_path / "portal.glb")
    return tmp_path / "portal.glb"


def test_our_planner_passes_what_was_made_up_and_a_given_structure(portal: Path,
                                                                   capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(portal), "--queries", "1", "--planners", "lattice", "thesis", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {r["world"] for r in rows} == {*PASSAGES, "portal"}
    ours = [r for r in rows if r["planner"] == "lattice"]
    assert all(r["found"] == r["kept"] for r in ours)
    assert all(r["kept"] == 1.0 for r in ours if r["knowledge"] == "mesh")
    assert {r["knowledge"] for r in rows if r["planner"] == "thesis"} == {"mesh"}


def test_a_planner_that_does_not_exist_is_refused() -> None:
    with pytest.raises(UserError, match="PRM"):
        main(["--planners", "PRM"])


def test_replans_are_measured_with_voxels_and_with_the_mesh(portal: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert replan([str(portal), "--replans", "5", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(r["structure"], r["knowledge"]) for r in rows] == [("portal", "map"), ("portal", "mesh")]
    assert all(r["found"] == 1.0 for r in rows)
