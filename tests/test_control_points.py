"""Ground control holds an alignment, check points say how good it is."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ground_station.cli import main as swarmscan
from ground_station.control_file import copy_control, read_control
from missions.errors import UserError
from missions.frames import Array, Site
from perception.reconstruct.alignment import align
from perception.reconstruct.pictures import SurveyPicture
from tests.reconstruct_scene import survey
from tests.test_alignment import ACCURACY, DISTANCE_M, disturbed, errors

pytestmark = pytest.mark.xdist_group("alignment")

SITE = Site(46.5, 7.5, 620.0)
PLACES = {"A": (-1.8, 0.0, 1.2), "B": (1.9, 0.0, 1.1), "C": (-1.7, 0.0, 3.4), "D": (0.5, -1.0, 2.6),
          "E": (1.6, 0.0, 3.2)}
CHECKS = ("E",)


@pytest.fixture(scope="module")
def true(tmp_path_factory: pytest.TempPathFactory) -> list[SurveyPicture]:
    return survey(tmp_path_factory.mktemp("pictures"))


def write_control(path: Path, pictures: list[SurveyPicture], columns: tuple[str, str, str],
                  places: dict[str, Array]) -> None:
    """Marks where exact cameras see the places."""
    with path.open("w", newline="") as f:
        writer = csv.writer(f)
        writer.writerow(("name", "role", *columns, "picture", "x_px", "y_px"))
        for name, place in PLACES.items():
            for p in pictures:
                x, y, z = p.camera.matrix @ p.enu_from_camera.T @ (np.array(place) - p.position_enu_m)
                if 0 < x / z < p.camera.width_px and 0 < y / z < p.camera.height_px:
                    role = "check" if name in CHECKS else "control"
                    writer.writerow((name, role, *places[name], p.path.name, x / z, y / z))


@pytest.mark.parametrize("off_m", [0.0, 3.0])
def test_control_points_take_the_common_error_out(off_m: float, true: list[SurveyPicture], tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    write_control(path, true, ("east_m", "north_m", "up_m"), {k: np.array(v) for k, v in PLACES.items()})
    points = [p.placed(SITE, {q.path.name: i for i, q in enumerate(true)}) for p in read_control(path)]
    off = [replace(p, position_enu_m=p.position_enu_m + off_m) for p in disturbed(true)]
    found = align(off, ACCURACY, DISTANCE_M, tmp_path / "alignment", control=points)
    assert errors(found.pictures, true)[0].mean() < 0.005
    assert found.numbers["registered"] == len(true)
    rows = {row["name"]: row for row in found.numbers["control_points"]}
    assert {name for name, row in rows.items() if row["role"] == "check"} == set(CHECKS)
    assert rows.keys() == PLACES.keys()
    assert all(row["error_m"] < 0.006 and row["error_px"] < 1.0 for row in rows.values())


def test_photographs_without_gps_are_placed_by_control_points(true: list[SurveyPicture], tmp_path: Path,
                                                              capsys: pytest.CaptureFixture[str]) -> None:
    folder, path = tmp_path / "pictures", tmp_path / "points.csv"
    folder.mkdir()
    for p in true:
        shutil.copy(p.path, folder)
    geodetic = {k: np.array(SITE.geodetic_from_enu(np.array(v))) for k, v in PLACES.items()}
    write_control(path, true, ("lat_deg", "lon_deg", "height_m"), geodetic)
    assert swarmscan(["reconstruct", str(folder), "--control", str(path), "--poses-only", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["components"][0]["placed_by"] == "control points"
    (check,) = (row for row in told["control_points"] if row["role"] == "check")
    assert check["error_m"] < 0.02
    origin = Site(*(told["origin"][k] for k in ("lat_deg", "lon_deg", "alt_m")))
    stands = np.loadtxt(tmp_path / "pictures-model" / "views.csv", delimiter=",", skiprows=1, usecols=(4, 5, 6))
    wanted = [origin.enu_from_geodetic(*SITE.geodetic_from_enu(p.position_enu_m)) for p in true]
    assert np.linalg.norm(stands - wanted, axis=1).max() < 0.05


def test_a_projected_crs_is_carried_to_enu_and_copies_read_back(tmp_path: Path) -> None:
    path, copy = tmp_path / "utm.csv", tmp_path / "copy.csv"
    path.write_text("name,picture,x_px,y_px,x,y,z\nA,a.jpg,1.5,2.5,384810.10,5150920.20,620.0\n")
    (point,) = read_control(path, 32632)
    east, north, up = point.placed(SITE, {}).place_enu_m
    assert abs(east) < 1000
    assert abs(north) < 1000
    assert up == pytest.approx(0.0, abs=1e-6)
    copy_control([point], SITE, copy)
    (again,) = read_control(copy)
    np.testing.assert_allclose(again.placed(SITE, {}).place_enu_m, [east, north, up], atol=1e-9)
    assert again.marks.keys() == {"a.jpg"}


@pytest.mark.parametrize(("text", "why"), [
    ("name,picture,x_px\n", "columns y_px are missing"),
    ("name,picture,x_px,y_px,x,y,z\n", "name it with --control-crs"),
    ("name,picture,x_px,y_px,east_m,north_m,up_m\nA,a.jpg,1,b,0,0,0\n", "line 2: .* write numbers there"),
    ("name,picture,x_px,y_px,east_m,north_m,up_m\nA,a.jpg,1,1,0,0,0\nA,b.jpg,1,1,0,0,9\n", "line 3: A has another"),
    ("name,role,picture,x_px,y_px,east_m,north_m,up_m\nA,tie,a.jpg,1,1,0,0,0\n", "role be control or check"),
])
def test_a_file_that_cannot_be_used_is_refused(text: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(text)
    with pytest.raises(UserError, match=why):
        read_control(tmp_path / "points.csv")
