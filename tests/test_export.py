"""What a run leaves for other programs, read back by them or by an independent way."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pycolmap
import pyexiv2
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS, Transformer
from scipy.spatial.transform import Rotation

from ground_station.cli import main
from missions.camera import Pose
from missions.frames import Site, enu_from_camera
from missions.mission import CameraSpec, Mission, SiteSpec
from missions.mission_file import write_mission
from missions.run_folder import RunFolder, write_views
from perception.products.model_files import write_model
from perception.reconstruct.aligned_poses import AlignedPose, read_poses, write_alignment
from perception.reconstruct.bundle import Adjusted
from perception.reconstruct.camera_reference import yaw_pitch_roll_deg
from perception.reconstruct.cloud import Cloud, write_cloud
from perception.reconstruct.optics import Optics
from perception.reconstruct.pictures import SurveyPicture
from perception.reconstruct.projection import projection, utm_epsg
from perception.reconstruct.realitycapture_xmp import write_realitycapture
from tests.reconstruct_scene import CAMERA
from tests.test_products import flat_roof

SITE = Site(52.2205, 6.8861, 40.0)
UTM_32N = 32632
PICTURES = [
    SurveyPicture(view_id, Path(f"UAV_1_{view_id}.jpg"), CAMERA, enu_from_camera(*angles), np.array(position_enu_m))
    for view_id, angles, position_enu_m in ((10001, (0.3, -0.6, 0.05), (-8.0, -9.0, 12.5)),
                                            (10002, (2.4, 0.0), (11.0, -7.5, 4.25)),
                                            (10003, (-1.7, 0.4), (6.5, 10.0, 1.75)))
]


def cloud() -> Cloud:
    """Of a site of 80 m, over which our anchor and a true ENU frame agree to a millimetre."""
    rng = np.random.default_rng(3)
    normals = rng.standard_normal((500, 3))
    return Cloud(rng.uniform(-40.0, 40.0, (500, 3)).astype(np.float32),
                 rng.integers(0, 256, (500, 3), np.uint8),
                 (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32),
                 rng.integers(3, 40, 500).astype(np.uint8))


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """A finished run with exact poses: mission, survey views, cloud."""
    run = RunFolder(tmp_path / "run")
    run.root.mkdir()
    write_mission(Mission(title="Export", camera=CameraSpec(survey_px=(640, 360))), run.mission)
    write_views(run.views_csv, [[p.view_id, 1, "survey", 1.0, *p.position_enu_m, *_quaternion(p), 0.0,
                                 f"pictures/{p.path.name}"] for p in PICTURES])
    write_cloud(cloud(), run.cloud)
    return run


def _quaternion(picture: SurveyPicture) -> list[float]:
    return list(Rotation.from_matrix(picture.enu_from_camera).as_quat(scalar_first=True))


def exported(run: RunFolder, capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    assert main(["export", str(run.root), "--json", *arguments]) == 0
    return json.loads(capsys.readouterr().out)


def refusal(run: RunFolder, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["export", str(run.root), *arguments]) == 2
    return capsys.readouterr().err


def true_geodetic(position_enu_m: np.ndarray) -> np.ndarray:
    """(n, 3) longitude, latitude, height by way of the earth's centre, without our anchor."""
    to_enu = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lon_0={SITE.lon_deg} +lat_0={SITE.lat_deg} +h_0={SITE.alt_m}")
    return np.column_stack(to_enu.transform(*position_enu_m.T.astype(float), direction="INVERSE"))


@pytest.mark.parametrize("name", ["las", "laz"])
def test_the_cloud_lies_where_it_was_in_utm(run: RunFolder, capsys: pytest.CaptureFixture[str], name: str) -> None:
    document = exported(run, capsys, "--format", name)
    assert document["crs"] == "EPSG:32632"
    assert document["heights"] == "metres above the WGS 84 ellipsoid"
    assert document["files"] == [str(run.root / "export" / f"cloud.{name}")]
    points, told = laspy.read(document["files"][0]), cloud()
    assert (str(points.header.version), points.header.point_format.id) == ("1.4", 7)
    assert points.header.are_points_compressed == (name == "laz")
    lon, lat, height = true_geodetic(told.points_enu_m).T
    east, north = Transformer.from_crs(4326, UTM_32N, always_xy=True).transform(lon, lat)
    away = points.xyz - np.column_stack([east, north, height])
    assert np.abs(away).max() < 1e-3
    np.testing.assert_array_equal(np.column_stack([points.red, points.green, points.blue]) // 257, told.colours)
    np.testing.assert_array_equal(points["confidence"], told.confidence)


def test_its_crs_says_utm_with_ellipsoidal_heights(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    header = laspy.read(exported(run, capsys, "--format", "laz")["files"][0]).header
    assert header.global_encoding.wkt
    crs = header.parse_crs()
    assert crs.equals(CRS.from_epsg(UTM_32N).to_3d())
    assert crs.axis_info[2].name == "Ellipsoidal height"


def test_normals_turn_with_the_grid(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    """A step along the normal in ENU is a step along the exported normal on the grid."""
    points, told = laspy.read(exported(run, capsys, "--format", "laz")["files"][0]), cloud()
    normals = np.column_stack([points[k] for k in ("NormalX", "NormalY", "NormalZ")])
    grid = projection(SITE)
    steps = grid.grid_from_enu(told.points_enu_m + told.normals.astype(float)) - grid.grid_from_enu(told.points_enu_m)
    assert np.abs(normals - steps / np.linalg.norm(steps, axis=1, keepdims=True)).max() < 5e-4
    assert np.abs(normals - told.normals).max() > 0.02


def test_another_crs_and_folder(run: RunFolder, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """ETRS89 and WGS 84 differ by less than PROJ knows: the same numbers under another name."""
    document = exported(run, capsys, "--format", "las", "--crs", "EPSG:25832", "--out", str(tmp_path / "other"))
    assert (document["crs"], document["crs_accuracy_m"]) == ("EPSG:25832", 1.0)
    assert document["heights"] == "metres above the GRS 1980 ellipsoid"
    points = laspy.read(tmp_path / "other" / "cloud.las")
    assert points.header.parse_crs().equals(CRS.from_epsg(25832).to_3d())
    assert np.abs(points.xyz - projection(SITE).grid_from_enu(cloud().points_enu_m)).max() < 1e-3


def assert_model_holds(folder: Path, pictures: list[SurveyPicture]) -> None:
    """Poses to 1e-9, and a point that a picture looks at lands where the pinhole says."""
    model = pycolmap.Reconstruction(folder)
    assert model.num_images() == len(pictures)
    for p in pictures:
        image = model.find_image_with_name(p.path.name)
        np.testing.assert_allclose(image.projection_center(), p.position_enu_m, atol=1e-9, rtol=0)
        np.testing.assert_allclose(image.cam_from_world().rotation.matrix().T, p.enu_from_camera, atol=1e-9, rtol=0)
        point = p.position_enu_m + p.enu_from_camera @ np.array([1.0, -0.5, 8.0])
        expected = [CAMERA.cx_px + CAMERA.fx_px / 8.0, CAMERA.cy_px - 0.5 * CAMERA.fy_px / 8.0]
        np.testing.assert_allclose(image.project_point(point), expected, atol=1e-6)


def test_colmap_reads_measured_poses(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    document = exported(run, capsys, "--format", "colmap")
    assert (document["pictures"], document["poses"]) == (3, "measured")
    folder = run.root / "export" / "colmap"
    assert_model_holds(folder, PICTURES)
    origin = json.loads((folder / "origin.json").read_text())
    assert (origin["origin_lat_deg"], origin["origin_lon_deg"], origin["origin_height_m"]) == (52.2205, 6.8861, 40.0)
    assert origin["heights"] == "metres above the WGS 84 ellipsoid"


def align_all(run: RunFolder) -> list[SurveyPicture]:
    """Alignment as reconstruct leaves it, 3 cm beside the measured poses, with one point that all see."""
    moved = [replace(p, position_enu_m=p.position_enu_m + np.array([0.01, -0.02, 0.02])) for p in PICTURES]
    point = np.array([[0.5, 0.25, 5.0]])
    rotations, positions = np.array([p.enu_from_camera for p in moved]), np.array([p.position_enu_m for p in moved])
    found = Adjusted(rotations, positions, point, np.arange(3), np.zeros(3, np.int64), np.zeros(3, np.int64),
                     np.full((3, 2), 100.0),
                     Optics(PICTURES[0].camera))
    poses = [AlignedPose.of(p, "aligned", 0, 1, 0.03, 0.0) for p in moved]
    write_alignment(run.alignment, "key", PICTURES, poses, found)
    return [p.applied(q) for p, q in zip(read_poses(run.alignment), PICTURES, strict=True)]


def test_aligned_poses_go_out_where_there_are_some(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    aligned = align_all(run)
    document = exported(run, capsys, "--format", "colmap", "metashape")
    assert document["poses"] == "aligned"
    assert_model_holds(run.root / "export" / "colmap", aligned)
    model = pycolmap.Reconstruction(run.root / "export" / "colmap")
    assert [p.track.length() for p in model.points3D.values()] == [3]
    rows = metashape_rows(run.root / "export" / "metashape.csv")
    for picture, row in zip(aligned, rows, strict=True):
        assert_reference(picture, row[1:7])


def metashape_rows(path: Path) -> list[list[str]]:
    with path.open(newline="", encoding="utf-8") as f:
        return [row for row in csv.reader(f) if not row[0].startswith("#")]


def from_yaw_pitch_roll(degrees: list[float]) -> np.ndarray:
    """(3, 3) enu_from_camera: NED from the body by scipy; the body's axes are the picture's top, right and axis."""
    ned_from_body = Rotation.from_euler("ZYX", degrees, degrees=True).as_matrix()
    top, right, axis = ned_from_body[[1, 0, 2]].T * [1.0, 1.0, -1.0]
    return np.column_stack([right, -top, axis])


def assert_reference(picture: SurveyPicture, row: list[str]) -> None:
    lon, lat, height, *angles = (float(v) for v in row)
    assert np.abs(SITE.enu_from_geodetic(lat, lon, height) - picture.position_enu_m).max() < 1e-4
    assert np.abs(np.array([lon, lat, height]) - true_geodetic(picture.position_enu_m[None])[0])[:2].max() < 1e-8
    np.testing.assert_allclose(from_yaw_pitch_roll(angles), picture.enu_from_camera, atol=2e-8)


def test_realitycapture_sees_a_point_where_it_was(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    document = exported(run, capsys, "--format", "realitycapture")
    assert [Path(f).name for f in document["files"]] == ["UAV_1_10001.xmp", "UAV_1_10002.xmp", "UAV_1_10003.xmp"]
    for picture, file in zip(PICTURES, document["files"], strict=True):
        read = pyexiv2_read(file)
        rotation = np.array(read["Rotation"].split(), float).reshape(3, 3)
        position = np.array(read["Position"].split(), float)
        point = picture.position_enu_m + picture.enu_from_camera @ np.array([1.0, -0.5, 8.0])
        u, v, _ = (rotation @ (point - position)) / 8.0 * float(read["FocalLength35mm"]) / 36.0 * CAMERA.width_px
        centre = np.array([float(read["PrincipalPointU"]), float(read["PrincipalPointV"])]) * CAMERA.width_px
        pixel = centre + np.array([u + CAMERA.width_px / 2, v * float(read["AspectRatio"]) + CAMERA.height_px / 2])
        expected = [CAMERA.cx_px + CAMERA.fx_px / 8.0, CAMERA.cy_px - 0.5 * CAMERA.fy_px / 8.0]
        np.testing.assert_allclose(pixel, expected, atol=1e-5)
        assert (read["PosePrior"], read["Coordinates"]) == ("initial", "absolute")


def test_realitycapture_has_the_lens_with_tangential_terms_in_its_own_order(tmp_path: Path) -> None:
    (file,) = write_realitycapture(PICTURES[:1], Optics(CAMERA, (-0.09, 0.03, 0.0008, -0.0006)), tmp_path)
    read = pyexiv2_read(str(file))
    assert read["DistortionModel"] == "brown3t2"
    assert [float(v) for v in read["DistortionCoeficients"].split()] == [-0.09, 0.03, 0.0, 0.0, -0.0006, 0.0008]


def pyexiv2_read(file: str) -> dict[str, str]:
    """Fields of RealityCapture's own name space, by Exiv2's XMP toolkit."""
    with pyexiv2.Image(file) as sidecar:
        return {key.rpartition(".")[2]: value for key, value in sidecar.read_xmp().items()}


def test_metashape_reference(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    path = Path(exported(run, capsys, "--format", "metashape")["files"][0])
    first, second, third = path.read_text().splitlines()[:3]
    assert CRS.from_wkt(first.removeprefix("# CoordinateSystem: ")).to_epsg() == 4326
    assert second == "# heights: metres above the WGS 84 ellipsoid"
    assert third.startswith("#Label,Longitude,Latitude,Altitude,Yaw,Pitch,Roll,")
    rows = metashape_rows(path)
    assert [row[0] for row in rows] == [p.path.name for p in PICTURES]
    for picture, row in zip(PICTURES, rows, strict=True):
        assert_reference(picture, row[1:7])
        assert len(row) == len(third.split(","))
        assert [float(v) for v in row[7:]] == [0.01, 0.01, 0.01, 0.1, 0.1, 0.1]


def test_geo_txt(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    path = Path(exported(run, capsys, "--format", "geo")["files"][0])
    lines = path.read_text().splitlines()
    assert lines[:2] == ["EPSG:4326", "# heights: metres above the WGS 84 ellipsoid"]
    for picture, line in zip(PICTURES, lines[2:], strict=True):
        name, *numbers = line.split()
        assert name == picture.path.name
        assert_reference(picture, numbers[:6])
        assert [float(v) for v in numbers[6:]] == [0.01, 0.01]


@pytest.mark.parametrize(("pose", "expected"), [
    (Pose((0.0, 0.0, 0.0), np.pi / 2, -np.pi / 2), (0.0, 0.0, 0.0)),
    (Pose((0.0, 0.0, 0.0), 0.0, -np.pi / 2), (90.0, 0.0, 0.0)),
    (Pose((0.0, 0.0, 0.0), np.pi / 2, 0.0), (0.0, 90.0, 0.0)),
    (Pose((0.0, 0.0, 0.0), np.pi, 0.0), (270.0, 90.0, 0.0)),
    (Pose((0.0, 0.0, 0.0), np.pi / 2 - np.radians(30.0), np.radians(1.0)), (30.0, 91.0, 0.0)),
])
def test_angles_of_cameras_that_everybody_can_imagine(pose: Pose, expected: tuple[float, float, float]) -> None:
    """Straight down with the top to North or East, level to North or West, and a degree above the horizon."""
    found = np.array(yaw_pitch_roll_deg(pose.enu_from_camera)) - expected
    assert np.abs((found + 180.0) % 360.0 - 180.0).max() < 1e-6


@given(st.floats(-3.1, 3.1), st.just(0.0) | st.floats(-1.57, 1.57), st.just(0.0) | st.floats(-3.1, 3.1))
def test_angles_give_the_rotation_again(yaw: float, elevation: float, roll: float) -> None:
    rotation = enu_from_camera(yaw, elevation, roll)
    angles = yaw_pitch_roll_deg(rotation)
    assert 0.0 <= angles[0] <= 360.0
    assert abs(angles[2]) <= 90.0
    # yaw and roll are told apart no better than this where they turn about one axis
    np.testing.assert_allclose(from_yaw_pitch_roll(list(angles)), rotation, atol=3e-6)


@pytest.mark.parametrize(("lat", "lon", "epsg"), [(52.2, 6.9, 32632), (-33.9, 151.2, 32756), (0.0, -180.0, 32601),
                                                  (10.0, 180.0, 32601), (60.0, 5.99, 32631), (60.0, 6.0, 32632)])
def test_utm_zones(lat: float, lon: float, epsg: int) -> None:
    assert utm_epsg(Site(lat, lon, 0.0)) == epsg
    assert projection(Site(lat, lon, 0.0)).scale == pytest.approx(1.0, abs=1.1e-3)


@pytest.mark.parametrize(("crs", "words"), [
    ("999999", "no such EPSG code"), ("4326", "not a projected CRS in metres"),
    ("2263", "not a projected CRS in metres"), ("32633", "does not reach the site at 52.2205, 6.8861"),
    ("3857", "makes 1.63 m out of a metre"),
])
def test_a_crs_that_does_not_suit_is_refused(run: RunFolder, capsys: pytest.CaptureFixture[str], crs: str,
                                             words: str) -> None:
    told = refusal(run, capsys, "--format", "laz", "--crs", crs)
    assert f"--crs {crs}" in told
    assert words in told
    assert "leave --crs out for UTM (32632)" in told
    assert not (run.root / "export").exists()


def test_near_the_poles_utm_ends(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    write_mission(Mission(title="North", site=SiteSpec(origin_lat_deg=86.0)), run.mission)
    assert "site.origin_lat_deg 86.0: UTM ends at" in refusal(run, capsys)
    assert exported(run, capsys, "--format", "laz", "--crs", "5041")["crs"] == "EPSG:5041"


def test_a_run_without_what_is_asked_for_is_refused(run: RunFolder, capsys: pytest.CaptureFixture[str],
                                                    tmp_path: Path) -> None:
    align_all(run)
    write_views(run.views_csv, [[9, 1, "survey", 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, "pictures/UAV_1_9.jpg"]])
    assert "made from other pictures than those in views.csv" in refusal(run, capsys, "--format", "geo")
    run.views_csv.unlink()
    assert "no survey pictures" in refusal(run, capsys, "--format", "colmap")
    run.cloud.unlink()
    told = refusal(run, capsys, "--format", "las", "geo")
    assert "cloud.ply: no cloud" in told
    assert "run 'swarmscan reconstruct'" in told
    assert not (run.root / "export").exists()
    assert "no such run folder" in refusal(RunFolder(tmp_path / "nowhere"), capsys)


def test_a_folder_that_cannot_be_written(run: RunFolder, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "choose another folder with --out" in refusal(run, capsys, "--out", str(tmp_path / "file"))


def test_rasters_lie_beside_the_cloud(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    write_model(flat_roof(), run.model)
    document = exported(run, capsys, "--format", "orthophoto", "dsm", "--gsd", "0.1")
    assert document["crs"] == "EPSG:32632"
    assert document["gsd_m"] == 0.1
    with tifffile.TiffFile(run.root / "export" / "dsm.tif") as file:
        told, height = file.pages[0].geotiff_tags, file.pages[0].asarray()
    assert document["cells"] == [height.shape[1], height.shape[0]]
    middle = Transformer.from_crs(4326, UTM_32N, always_xy=True).transform(SITE.lon_deg, SITE.lat_deg)
    column, row = int((middle[0] - told["ModelTiepoint"][3]) / 0.1), int((told["ModelTiepoint"][4] - middle[1]) / 0.1)
    assert height[row, column] == pytest.approx(43.0, abs=1e-3), "40 m of the site and a roof 3 m up"
    assert "cells of 0.1 m in EPSG:32632" in _told(run, capsys, "--format", "dsm", "--gsd", "0.1")


def _told(run: RunFolder, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["export", str(run.root), *arguments]) == 0
    return capsys.readouterr().out


def test_rasters_need_a_model(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no textured model; run 'swarmscan reconstruct'" in refusal(run, capsys, "--format", "dsm")
