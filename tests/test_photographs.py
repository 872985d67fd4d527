"""Photographs that nobody flew: read, judged, mapped and placed, or left out with a reason."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from ground_station.cli import main as swarmscan
from ground_station.dji_xmp import HEADER
from ground_station.positions_file import with_positions
from missions.errors import UserError
from missions.frames import Site, enu_from_camera
from missions.mission_file import load_mission
from perception.photographs.georeference import Stations, place
from perception.photographs.metadata import read_metadata
from perception.photographs.photograph import photographs_in
from perception.photographs.quality import look_at, reasons
from tests.reconstruct_scene import CAMERA, survey

pytestmark = pytest.mark.xdist_group("photographs")

SITE = Site(46.5, -7.25, 620.0)
GIMBAL = ('<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
          '<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:AbsoluteAltitude="+633.25" '
          'drone-dji:GimbalYawDegree="+90.0" drone-dji:GimbalPitchDegree="-45.0" drone-dji:GimbalRollDegree="0" '
          'drone-dji:GpsLongtitude="-7.25"/></rdf:RDF></x:xmpmeta>')


def with_exif(jpeg: bytes, position_enu_m: np.ndarray | None, focal_35mm: int | None = None, orientation: int = 1,
              xmp: str = "") -> bytes:
    """As a phone or a drone writes it."""
    exif = Image.Exif()
    exif[271], exif[272], exif[274] = "Maker", "Model 1", orientation
    details = exif.get_ifd(0x8769)
    if focal_35mm is not None:
        details[0xA405] = focal_35mm
    if position_enu_m is not None:
        lat, lon, alt = SITE.geodetic_from_enu(position_enu_m)
        exif.get_ifd(0x8825).update({1: "N", 2: dms(lat), 3: "W", 4: dms(-lon), 5: b"\x00",
                                     6: IFDRational(round(alt * 1000), 1000)})
    segments = [exif.tobytes(), *([HEADER + xmp.encode()] if xmp else [])]
    return jpeg[:2] + b"".join(b"\xff\xe1" + (len(s) + 2).to_bytes(2, "big") + s for s in segments) + jpeg[2:]


def dms(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    micro = round(degrees * 3_600_000_000)
    return (IFDRational(micro // 3_600_000_000, 1), IFDRational(micro // 60_000_000 % 60, 1),
            IFDRational(micro % 60_000_000, 1_000_000))


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    return survey(tmp_path_factory.mktemp("pictures"))


@pytest.fixture(scope="module")
def folder(pictures: list[Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine good photographs, one of them without GPS, and what else lies in such folders."""
    folder = tmp_path_factory.mktemp("Brücke 2024")
    focal = round(CAMERA.fx_px / np.hypot(CAMERA.width_px, CAMERA.height_px) * 43.27)
    for k, p in enumerate(pictures):
        placed = None if k == 2 else p.position_enu_m + (np.array([40.0, 0.0, 0.0]) if k == 5 else 0.0)
        (folder / f"Ö {k}.JPG").write_bytes(with_exif(p.path.read_bytes(), placed, focal))
    good = cv2.imread(str(pictures[0].path))
    shutil.copy(folder / "Ö 0.JPG", folder / "Ö copy.JPG")
    cv2.imwrite(str(folder / "blurred.jpg"), cv2.blur(good, (15, 15)))
    cv2.imwrite(str(folder / "dark.png"), good // 8)
    cv2.imwrite(str(folder / "thumb.jpeg"), cv2.resize(good, (160, 90)))
    (folder / "cut.jpg").write_bytes(pictures[1].path.read_bytes()[:9000])
    (folder / "empty.jpg").write_bytes(b"")
    (folder / "raw.DNG").write_bytes(b"II*\x00")
    (folder / "notes.txt").write_text("not a picture")
    return folder


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = swarmscan(["reconstruct", *arguments])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_folder_becomes_a_run_that_says_what_became_of_every_picture(
        folder: Path, pictures: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "model"
    code, said, _ = run(capsys, str(folder), "--out", str(out), "--json")
    assert code == 0
    told = json.loads(said)
    state = {row["name"]: row["state"] for row in told["pictures"]}
    assert {name for name, text in state.items() if text.startswith("in the model")} == {f"Ö {k}.JPG" for k in range(9)}
    assert state["Ö 5.JPG"] == "in the model; its GPS position is an outlier"
    for name, why in (("Ö copy.JPG", "duplicate: the same file"), ("blurred.jpg", "blurred: "),
                      ("dark.png", "underexposed: "), ("thumb.jpeg", "smaller than"), ("cut.jpg", "cannot be read: "),
                      ("empty.jpg", "cannot be read: "), ("raw.DNG", ".DNG is not read")):
        assert state[name].startswith(f"left out: {why}"), name
    assert "notes.txt" not in state
    assert json.loads((out / "photographs.json").read_text())["pictures"] == told["pictures"]
    mission = load_mission(out / "mission.toml")
    stands = np.loadtxt(out / "views.csv", delimiter=",", skiprows=1, usecols=(4, 5, 6))
    anchor = mission.site.anchor
    true = np.array([anchor.enu_from_geodetic(*SITE.geodetic_from_enu(p.position_enu_m)) for p in pictures])
    assert np.linalg.norm(stands - true, axis=1).max() < 0.02
    assert told["model"]["points"] > 2000
    assert told["cameras"][0]["fx_px"] == pytest.approx(CAMERA.fx_px, rel=0.03)


def test_without_gps_it_stands_upright_and_says_that_its_scale_is_made_up(
        pictures: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = tmp_path / "frames", tmp_path / "model"
    folder.mkdir()
    for k, p in enumerate(pictures):
        shutil.copy(p.path, folder / f"frame{k}.jpg")
    code, said, _ = run(capsys, str(folder), "--out", str(out), "--poses-only")
    assert code == 0
    assert "scale and place of the model are made up" in said
    stands = np.loadtxt(out / "views.csv", delimiter=",", skiprows=1, usecols=(4, 5, 6))
    true = np.array([p.position_enu_m for p in pictures])
    found = pycolmap.estimate_sim3d(stands, true)
    assert found is not None
    assert found.rotation.matrix()[2, 2] > 0.98
    matrix = found.matrix()
    assert np.linalg.norm(stands @ matrix[:, :3].T + matrix[:, 3] - true, axis=1).max() < 0.05


def test_positions_from_a_file_stand_for_those_of_the_pictures(pictures: list[Any], tmp_path: Path) -> None:
    path = tmp_path / "positions.csv"
    for name in "ab":
        shutil.copy(pictures[0].path, tmp_path / f"{name}.jpg")
    path.write_text("picture,lat_deg,lon_deg,height_m,yaw_deg,pitch_deg,roll_deg\nb.jpg,46.5,7.25,620,10,-45,0\n")
    a, b = (p.metadata for p in with_positions(photographs_in(tmp_path, 1), path))
    assert a is not None
    assert b is not None
    assert not a.placed
    assert (b.latitude_deg, b.longitude_deg, b.altitude_m, b.gimbal_deg) == (46.5, 7.25, 620.0, (10.0, -45.0, 0.0))
    for text, why in (("c.jpg,1,1,1", "line 2: there is no picture c.jpg"), ("b.jpg,91,1,1", "no place on Earth"),
                      ("b.jpg,x,1,1", "write numbers there")):
        path.write_text(f"picture,lat_deg,lon_deg,height_m\n{text}\n")
        with pytest.raises(UserError, match=why):
            with_positions(photographs_in(tmp_path, 1), path)


@pytest.mark.parametrize(("make", "why"), [
    (lambda folder: None, "holds no pictures"),
    (lambda folder: (folder / "one.jpg").write_bytes(b"no"), "0 usable pictures of 1, and a model needs at least 3"),
    (lambda folder: [cv2.imwrite(str(folder / f"{k}.png"), np.random.default_rng(k).integers(
        0, 255, (300, 400, 3), np.uint8)) for k in range(4)], "no two of them overlap enough"),
])
def test_where_there_can_be_no_model_it_says_why(tmp_path: Path, make: Any, why: str,
                                                 capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "pictures"
    folder.mkdir()
    make(folder)
    code, _, said = run(capsys, str(folder))
    assert code == 2
    assert why in said


def test_what_exif_and_xmp_say(pictures: list[Any], tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(with_exif(pictures[0].path.read_bytes(), np.array([3.0, 4.0, 5.0]), 24, 6, GIMBAL))
    told = read_metadata(path)
    assert (told.upright_turn_deg, told.gimbal_deg, told.altitude_m) == (90, (90.0, -45.0, 0.0), 633.25)
    assert told.latitude_deg is not None
    assert told.longitude_deg is not None
    east_north = SITE.enu_from_geodetic(told.latitude_deg, told.longitude_deg, 0.0)[:2]
    np.testing.assert_allclose(east_north, [3, 4], atol=1e-3)
    assert told.focal_px == pytest.approx(24 / 43.27 * np.hypot(CAMERA.width_px, CAMERA.height_px), rel=1e-3)
    path.write_bytes(pictures[0].path.read_bytes())
    assert read_metadata(path) == replace(read_metadata(path), make="", focal_px=None, latitude_deg=None)


def test_of_two_that_show_the_same_the_sharper_one_stays(pictures: list[Any], tmp_path: Path) -> None:
    sharp = cv2.imread(str(pictures[0].path))
    for name, picture in (("a", cv2.blur(sharp, (3, 3))), ("b", sharp), ("c", cv2.imread(str(pictures[4].path)))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture)
    looks = [look_at(tmp_path / f"{name}.png") for name in "abc"]
    assert reasons(looks, list("abc"), list("abc")) == ["duplicate: shows the same as b", "", ""]


def test_names_tell_nothing_of_what_is_read(tmp_path: Path) -> None:
    (tmp_path / ".hidden.jpg").write_bytes(b"")
    (tmp_path / "video.MP4").write_bytes(b"")
    (found,) = photographs_in(tmp_path, 1)
    assert found.fault == ".MP4 is not read: convert it to JPEG, TIFF or PNG"


def test_positions_in_a_row_are_levelled_by_the_cameras() -> None:
    """A straight flight says nothing of the turn about its line; that cameras are held level does."""
    rotations = np.array([enu_from_camera(yaw, elevation) for yaw, elevation in
                          ((0.0, -0.2), (0.4, -0.5), (1.5, 0.1), (2.0, -0.3), (3.0, -1.0))])
    position = np.column_stack([np.arange(5.0), np.zeros(5), np.zeros(5)])
    turn = np.array([[1.0, 0, 0], [0, np.cos(1.0), -np.sin(1.0)], [0, np.sin(1.0), np.cos(1.0)]])
    found = place(Stations(turn @ rotations, 0.5 * position @ turn.T, 3.0 * position + 7.0, [None] * 5), 1.0)
    assert found.by == "GPS in a row"
    assert found.enu_from_model.scale == pytest.approx(6.0)
    np.testing.assert_allclose(found.enu_from_model.rotation.matrix() @ turn, np.eye(3), atol=1e-9)
