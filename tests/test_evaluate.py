"""Laws of the measures: identity, shifts, monotony, and the thesis's equations against plain arithmetic."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from ground_station import stages
from ground_station.cloud_evaluation import Request, evaluate_cloud, read_any_cloud
from ground_station.report.renderings import PRESENT_COLOUR
from missions.errors import UserError
from perception.evaluate import accuracy
from perception.evaluate.alignment import by_icp, by_markers
from perception.evaluate.completeness import completeness, distances_to_cloud
from perception.evaluate.reference import read_reference
from perception.reconstruct.cloud import Cloud, write_cloud

SQUARE = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
CLOUDCOMPARE_DISTANCE = 6
"""Its column in an exported cloud: x, y, z, red, green, blue, distance, normal."""


def grid(z: float = 0.0) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(0.2, 3.8, 40), np.linspace(0.2, 3.8, 40))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1).astype(np.float32)


def test_identical_cloud_is_perfect() -> None:
    distances = distances_to_cloud(grid().astype(np.float64), grid())
    assert distances.max() == 0.0
    assert set(completeness(distances).values()) == {1.0}
    plain = accuracy.exact(accuracy.distances_to_mesh(grid(), SQUARE, FACES)[0])
    assert plain.mean_m == pytest.approx(0.0, abs=1e-6)
    assert plain.within_2cm == 1.0


@given(st.floats(-0.3, 0.3))
def test_shifted_plane_has_its_shift_as_error(shift: float) -> None:
    signed, _ = accuracy.distances_to_mesh(grid(shift), SQUARE, FACES)
    np.testing.assert_allclose(signed, shift, atol=1e-6)
    overall = accuracy.binned(*accuracy.histogram(signed))
    assert overall.mean_m == pytest.approx(abs(shift), abs=0.6 * accuracy.BIN_M)
    assert overall.rms_m == pytest.approx(abs(shift), abs=0.6 * accuracy.BIN_M)


@given(st.floats(0.02, 0.5), st.floats(5.0, 60.0), st.integers(0, 1000))
@settings(deadline=None, max_examples=30)
def test_long_thin_triangles_are_measured_to_a_tenth_of_a_millimetre(width: float, length: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    flat = np.array([[0.0, 0, 0], [length, 0, 0], [length, width, 0], [0, width, 0]]) - [length / 2, 0, 0]
    points = np.column_stack([rng.uniform(-length / 2, length / 2, 500), rng.uniform(-0.05, width + 0.05, 500),
                              rng.uniform(-0.03, 0.03, 500)])
    beside = np.maximum(np.maximum(-points[:, 1], points[:, 1] - width), 0.0)
    distance, triangle = accuracy.distances_to_mesh((points @ turn.T + 20.0).astype(np.float32), flat @ turn.T + 20.0,
                                                    FACES)
    np.testing.assert_allclose(np.abs(distance), np.hypot(beside, points[:, 2]), atol=1e-4)
    assert set(triangle.tolist()) <= {0, 1}


@given(st.lists(st.floats(0, 2), min_size=1, max_size=200))
def test_completeness_rises_with_the_threshold(distances: list[float]) -> None:
    shares = list(completeness(np.array(distances), (0.1, 0.2, 0.25, 0.5, 2.0)).values())
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@given(st.lists(st.floats(-3, 3), min_size=1, max_size=300))
def test_bins_agree_with_exact_values_to_half_a_bin(distances: list[float]) -> None:
    d = np.array(distances)
    counts, centres = accuracy.histogram(d)
    overall, plain = accuracy.binned(counts, centres), accuracy.exact(d)
    assert counts.sum() == overall.points == plain.points == len(d)
    assert overall.mean_m == pytest.approx(plain.mean_m, abs=0.501 * accuracy.BIN_M)
    assert overall.rms_m == pytest.approx(plain.rms_m, abs=0.501 * accuracy.BIN_M)
    assert overall.rms_m >= overall.mean_m - 1e-12


def test_equations_on_a_hand_made_histogram() -> None:
    counts, centres = np.array([1, 3, 4, 2]), np.array([-0.03, -0.01, 0.01, 0.05])
    overall = accuracy.binned(counts, centres)
    assert overall.within_2cm == pytest.approx(7 / 10)
    assert overall.mean_m == pytest.approx((0.03 + 0.03 + 0.04 + 0.10) / 10)
    assert overall.rms_m == pytest.approx(np.sqrt((0.0009 + 0.0003 + 0.0004 + 0.005) / 10))


def test_edges_of_bins_lie_at_two_centimetres() -> None:
    overall = accuracy.binned(*accuracy.histogram(np.array([0.0199, -0.0199, 0.0201, -0.0201])))
    assert overall.within_2cm == 0.5


def test_sign_is_the_side_of_the_surface() -> None:
    signed, _ = accuracy.distances_to_mesh(np.array([[1, 1, 0.1], [1, 1, -0.1]], np.float32), SQUARE, FACES)
    np.testing.assert_allclose(signed, [0.1, -0.1], atol=1e-6)


def test_trimming_forgets_gross_errors() -> None:
    assert accuracy.trimmed(np.array([0.01, -0.04, 3.0])).tolist() == [0.01, -0.04]


def test_nothing_measured_is_unknown_not_zero() -> None:
    assert completeness(np.zeros(0)) == {"0.05": None, "0.10": None, "0.20": None, "0.25": None, "0.50": None}
    assert accuracy.binned(*accuracy.histogram(np.zeros(0))) == accuracy.Accuracy(None, None, None, 0)
    assert accuracy.exact(np.zeros(0)).mean_m is None
    assert np.all(np.isinf(distances_to_cloud(np.zeros((3, 3)), np.zeros((0, 3), np.float32))))


def box_cloud(rng: np.random.Generator, noise_m: float = 0.004) -> tuple[trimesh.Trimesh, Cloud]:
    """A box and noisy points on it; a side is missing."""
    box = trimesh.creation.box((4.0, 3.0, 2.0))
    points, rows = trimesh.sample.sample_surface(box, 40_000, seed=1)
    normals = box.face_normals[rows]
    kept = normals[:, 0] < 0.5
    noisy = points[kept] + noise_m * rng.normal(size=(kept.sum(), 1)) * normals[kept]
    n = len(noisy)
    return box, Cloud(noisy.astype(np.float32), np.zeros((n, 3), np.uint8), normals[kept].astype(np.float32),
                      np.full(n, 4, np.uint8))


def written(folder: Path) -> tuple[Path, Path]:
    box, cloud = box_cloud(np.random.default_rng(0))
    box.export(folder / "box.ply")
    write_cloud(cloud, folder / "cloud.ply")
    return folder / "cloud.ply", folder / "box.ply"


def test_a_missing_side_is_missing_and_the_rest_as_noisy_as_it_was_made(tmp_path: Path) -> None:
    cloud, mesh = written(tmp_path)
    found = evaluate_cloud(Request(cloud, mesh))
    side = 3 * 2 / (2 * (4 * 3 + 4 * 2 + 3 * 2))
    assert 0.6 * side < found["c2c"]["missing"] < side
    assert found["c2m"]["as_it_is"]["rms_m"] == pytest.approx(0.004, rel=0.05)
    assert found["c2m"]["as_it_is"]["mean_m"] == pytest.approx(0.004 * np.sqrt(2 / np.pi), rel=0.05)
    assert found["c2m"]["within_2cm"] == 1.0
    assert found["c2m"]["as_it_is"]["binned"]["rms_m"] == pytest.approx(found["c2m"]["as_it_is"]["rms_m"], abs=5e-4)
    recall = found["c2c"]["completeness"]["0.10"]
    assert found["c2m"]["f_score"]["0.10"] == pytest.approx(2 * recall / (1 + recall))


def test_pictures_and_the_map_of_what_is_missing(tmp_path: Path) -> None:
    cloud, mesh = written(tmp_path)
    found = evaluate_cloud(Request(cloud, mesh, pictures=tmp_path / "shown"))
    assert {p.name for p in (tmp_path / "shown").glob("*.png")} == {
        f"{name}_{side}.png" for name in ("colour", "confidence", "error", "missing") for side in (1, 2, 3)}
    told = o3d.t.io.read_point_cloud(str(tmp_path / "shown" / "missing.ply"))
    far = told.point["distance_m"].numpy()[:, 0] > 0.25
    assert far.mean() == pytest.approx(found["c2c"]["missing"])
    np.testing.assert_array_equal(far, (told.point["colors"].numpy() != PRESENT_COLOUR).any(axis=1))
    assert told.point["positions"].numpy()[far, 0].min() > 1.7


@given(st.floats(-0.05, 0.05), st.floats(-0.15, 0.15))
@settings(max_examples=10, deadline=None)
def test_icp_takes_a_small_displacement_back(angle_rad: float, shift_m: float) -> None:
    box, cloud = box_cloud(np.random.default_rng(0))
    samples, rows = trimesh.sample.sample_surface(box, 20_000, seed=2)
    moved = trimesh.transformations.rotation_matrix(angle_rad, [0.3, 0.2, 1.0])
    moved[:3, 3] = shift_m
    displaced = cloud.points_enu_m[::4] @ moved[:3, :3].T + moved[:3, 3]
    back = by_icp(displaced, samples, box.face_normals[rows]).reference_from_cloud @ moved
    np.testing.assert_allclose(back, np.eye(4), atol=3e-3)


@given(st.floats(0.2, 5.0), st.floats(-3, 3))
def test_markers_give_back_the_similarity_that_moved_them(scale: float, angle_rad: float) -> None:
    places = np.array([[0.0, 0, 0], [4, 1, 0], [0, 3, 1], [2, 2, 5]])
    moved = trimesh.transformations.rotation_matrix(angle_rad, [1.0, -0.4, 0.3])[:3, :3]
    cloud = (places - [1.0, 2.0, 3.0]) @ moved / scale
    found = by_markers(cloud, places, scale=True)
    np.testing.assert_allclose(found.apply(cloud), places, atol=1e-9)
    assert found.rms_m == pytest.approx(0.0, abs=1e-9)


def test_parts_are_measured_apart_and_ground_can_be_left_out(tmp_path: Path) -> None:
    scene = trimesh.Scene({"wall": trimesh.creation.box((4.0, 0.2, 3.0)),
                           "slab": trimesh.creation.box((9.0, 9.0, 0.2)).apply_translation((0, 0, -1.8))})
    scene.export(tmp_path / "two.glb")
    points, _ = trimesh.sample.sample_surface(scene.geometry["wall"], 20_000, seed=3)
    trimesh.PointCloud(points).export(tmp_path / "wall.ply")
    found = evaluate_cloud(Request(tmp_path / "wall.ply", tmp_path / "two.glb"))
    parts = {p["part"]: p for p in found["parts"]}
    assert parts["wall"]["completeness"] == 1.0
    assert parts["slab"]["completeness"] < 0.1
    without = evaluate_cloud(Request(tmp_path / "wall.ply", tmp_path / "two.glb", ground_up_m=-1.7))
    assert without["c2c"]["completeness"]["0.25"] == 1.0


def test_uneven_ground_is_no_error_of_the_object_and_what_floats_is(tmp_path: Path) -> None:
    box = trimesh.creation.box((4.0, 3.0, 2.0)).apply_translation((0, 0, 1.0))
    box.export(tmp_path / "box.ply")
    wall, ground, floating = [-2.0, 0.3, 0.15], [5.0, 0.0, 0.2], [5.0, 0.0, 0.3]
    for name, points in {"ground": [wall, ground], "floating": [wall, floating]}.items():
        trimesh.PointCloud(points).export(tmp_path / f"{name}.ply")
    found = {name: evaluate_cloud(Request(tmp_path / f"{name}.ply", tmp_path / "box.ply", ground_up_m=0.0))["c2m"]
             for name in ("ground", "floating")}
    assert found["ground"]["points"] == 1
    assert found["ground"]["exact"]["mean_m"] == pytest.approx(0.0, abs=1e-6)
    assert found["floating"]["exact"]["mean_m"] == pytest.approx(1.5)


@pytest.mark.parametrize(("arguments", "named"), [
    (["none.ply", "--reference", "box.ply"], "none.ply"),
    (["cloud.ply"], "--reference"),
    (["cloud.ply", "--reference", "none.obj"], "none.obj"),
    (["cloud.ply", "--reference", "cloud.ply"], "must be a mesh"),
    (["cloud.ply", "--reference", "box.ply", "--align", "markers"], "--markers"),
    (["cloud.ply", "--reference", "box.ply", "--align", "markers", "--markers", "m.csv"], "up_m"),
    (["cloud.ply", "--reference", "box.ply", "--scale"], "--scale"),
    (["far.ply", "--reference", "box.ply"], "far.ply: .* km from the origin"),
    (["cloud.ply", "--reference", "far_box.ply"], "far_box.ply: .* km from the origin"),
    (["cloud.ply", "--reference", "box.ply", "--min-confidence", "9"], "--min-confidence"),
])
def test_bad_input_is_told_in_a_sentence(arguments: list[str], named: str, tmp_path: Path,
                                         monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path)
    trimesh.PointCloud([[465_000.0, 5_790_000.0, 3.0]]).export("far.ply")
    trimesh.creation.box().apply_translation((465_000.0, 5_790_000.0, 3.0)).export("far_box.ply")
    Path("m.csv").write_text("name,cloud_x_m,cloud_y_m,cloud_z_m,east_m,north_m\nA,0,0,0,0,0\n")
    with pytest.raises(UserError, match=named):
        stages.main_evaluate(arguments)


@pytest.mark.skipif(shutil.which("CloudCompare") is None, reason="CloudCompare (Debian package) is not installed")
def test_distances_are_those_of_cloudcompare(tmp_path: Path) -> None:
    cloud, mesh = written(tmp_path)
    command = ["CloudCompare", "-SILENT", "-AUTO_SAVE", "OFF", "-O", str(cloud), "-O", str(mesh), "-C2M_DIST",
               "-C_EXPORT_FMT", "ASC", "-SEP", "SPACE", "-SAVE_CLOUDS", "FILE", str(tmp_path / "cc.asc")]
    subprocess.run(command, env={**os.environ, "QT_QPA_PLATFORM": "offscreen"}, check=True, capture_output=True)
    theirs = np.loadtxt(tmp_path / "cc.asc")
    reference = read_reference(mesh)
    ours, _ = accuracy.distances_to_mesh(read_any_cloud(cloud).points_enu_m, reference.vertices_enu_m,
                                         reference.triangles)
    np.testing.assert_allclose(read_any_cloud(cloud).points_enu_m, theirs[:, :3], atol=1e-5)
    np.testing.assert_allclose(ours, theirs[:, CLOUDCOMPARE_DISTANCE], atol=1e-5)
